"""Problems of a scenario: all of them are reported at once, each with its place in a file."""

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
"""Longer words, in characters, are not compared: they are hardly misspelt keys, and comparing them takes long."""
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Problem:
    """One fault or warning.

    Attributes:
        file: path of the file as a user would type it, or the title of a scenario that was built in Python.
        line, column: position of the key or table, counted from 1; 0 where there is no file text.
        path: key path in dotted form; "" if the problem concerns the whole file.
        text: what is wrong and what to do about it.
        severity: a scenario with warnings runs, one with errors does not.
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
    """Raised for a scenario that cannot run.

    Attributes:
        problems: all errors, then all warnings, in the order in which the files were read.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        errors = sum(problem.severity == "error" for problem in self.problems)
        lines = [str(problem) for problem in self.problems]
        super().__init__("\n".join([*lines, f"{errors} error{'' if errors == 1 else 's'}"]))


def dotted(path: KeyPath) -> str:
    """Return the path as TOML writes it, with array indices in brackets: ``vehicles.rov.position_ned_m[2]``."""
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
    """Return the allowed word that is most like a given one; None if none is similar."""
    if len(word) > _LONGEST_WORD:
        return None
    close = get_close_matches(word, allowed, 1) or [name for name in allowed if name.lower() == word.lower()]
    close = close or [name for name in allowed if word.lower() in name.lower().split("_")]
    return close[0] if close else None


def did_you_mean(word: str, allowed: Sequence[str]) -> str:
    """Return a hint such as `` (did you mean "box"?)`` for a word that is not allowed; "" if no allowed word is similar."""
    close = closest(word, allowed)
    return "" if close is None else f' (did you mean "{close}"?)'


def suggestion(word: str, allowed: Sequence[str], lead: str = "; allowed: ") -> str:
    """Return the hint of `did_you_mean`, or a list of all allowed words if none is similar."""
    return did_you_mean(word, allowed) or f"{lead}{', '.join(allowed) or 'none'}"
