"""What is wrong with a scenario: all of it at once, each fault at its place."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

KeyPath = tuple[str | int, ...]
"""Keys and array indices (0-based) from the top of a file."""
Severity = Literal["error", "warning"]

_LONGEST_WORD = 100
"""What is longer is no misspelt key, and costs much to compare."""
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Problem:
    """One fault or warning.

    Attributes:
        file: the file as the user knows it; the name of the scenario for one built in Python.
        line, column: where the key or the table stands, from 1; 0 where there is no file text.
        path: key path in dotted form; "" for the file as a whole.
        text: what is wrong and what to do.
        severity: a warning does not stop a scenario.
    """

    file: str
    line: int
    column: int
    path: str
    text: str
    severity: Severity = "error"

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        label = "warning: " if self.severity == "warning" else ""
        return f"{place}: {self.path}: {label}{self.text}" if self.path else f"{place}: {label}{self.text}"


class ScenarioError(Exception):
    """A scenario that cannot run.

    Attributes:
        problems: all faults, then all warnings, in the order of the files.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        errors = sum(problem.severity == "error" for problem in self.problems)
        lines = [str(problem) for problem in self.problems]
        super().__init__("\n".join([*lines, f"{errors} error{'' if errors == 1 else 's'}"]))


def dotted(path: KeyPath) -> str:
    """The path as TOML writes it, array indices in brackets: ``vehicles.rov.position_ned_m[2]``."""
    text = ""
    for key in path:
        if isinstance(key, int):
            text += f"[{key}]"
            continue
        if not _BARE_KEY.fullmatch(key):
            escaped = key.replace("\\", "\\\\").replace('"', '\\"')
            key = f'"{escaped}"'
        text += f".{key}" if text else key
    return text


def closest(word: str, allowed: Sequence[str]) -> str | None:
    """What was probably meant by a word that is not allowed; None where nothing is like it."""
    if len(word) > _LONGEST_WORD:
        return None
    close = get_close_matches(word, allowed, 1) or [name for name in allowed if name.lower() == word.lower()]
    close = close or [name for name in allowed if word.lower() in name.lower().split("_")]
    return close[0] if close else None


def did_you_mean(word: str, allowed: Sequence[str]) -> str:
    """A hint to put behind a word that is not allowed; "" where nothing is like it."""
    close = closest(word, allowed)
    return "" if close is None else f' (did you mean "{close}"?)'


def suggestion(word: str, allowed: Sequence[str], lead: str = "; allowed: ") -> str:
    """As `did_you_mean`; where nothing is like the word, all that is allowed."""
    return did_you_mean(word, allowed) or f"{lead}{', '.join(allowed) or 'none'}"
