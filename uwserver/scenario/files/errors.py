"""Problems of a scenario, which are all reported at once with their places in files, and the words for types and values in their texts."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import msgspec.inspect as mi
from msgspec import Struct

from uwserver.logs import place_of

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
        # One that concerns a whole file, such as that it is missing, says all in its line.
        alone = len(self.problems) == 1 and not (self.problems[0].line or self.problems[0].path)
        super().__init__("\n".join(lines if alone else [*lines, f"{errors} error{'' if errors == 1 else 's'}"]))

    def __reduce__(self) -> tuple[type[ScenarioError], tuple[tuple[Problem, ...]]]:
        return type(self), (self.problems,)


def label_of(path: Path) -> str:
    """Return the path as a user would type it: relative if it lies below the working folder."""
    try:
        # abspath does not follow links as resolve() does: one may lead in a circle.
        absolute, here = Path(os.path.abspath(path)), Path.cwd()  # noqa: PTH100
    except ValueError:  # a NUL in the name
        return str(path)
    return str(absolute.relative_to(here)) if absolute.is_relative_to(here) else str(absolute)


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


# -- types and values in words ----------------------------------------------------------------------------------------------------------


def expected(type_: Any) -> str:
    """Describe what a value of this type looks like in a file, limits included: ``a number greater than 0``."""
    return _expected(mi.type_info(type_))


def found(raw: object) -> str:
    """Describe the value that the file has instead: ``the string "abc"``."""
    if isinstance(raw, bool):
        return f"the boolean {str(raw).lower()}"
    if isinstance(raw, str):
        return f'the string "{raw if len(raw) <= 40 else raw[:37] + "..."}"'
    if isinstance(raw, (list, tuple)):
        return f"an array of {len(raw)}"
    if isinstance(raw, dict):
        return "a table"
    return number(raw) if isinstance(raw, (int, float)) else f"a {type(raw).__name__}"


def number(raw: float) -> str:
    """Write a number; of a very long integer only its length."""
    if isinstance(raw, int):
        return str(raw) if abs(raw) < 10**20 else f"an integer of {raw.bit_length()} bits"
    return repr(raw)


def not_built(table: Struct, error: Exception) -> str:
    """Say why an extension's code could not build what a table declares, with the file and line of the failure."""
    file, line = place_of(error)
    where, kind = f"{label_of(Path(file))}:{line}", table.__struct_config__.tag
    return f'a component of kind "{kind}" cannot be built ({where}): {type(error).__name__}: {error}'


def _expected(node: mi.Type) -> str:
    if isinstance(node, mi.Metadata):
        return _expected(node.type)
    if isinstance(node, mi.FloatType):
        return "a number" + _limits(node)
    if isinstance(node, mi.IntType):
        return "a whole number" + _limits(node)
    if isinstance(node, mi.BoolType):
        return "true or false"
    if isinstance(node, mi.StrType):
        return "a string that is not empty" if node.min_length else "a string"
    if isinstance(node, mi.LiteralType):
        values = [f'"{value}"' if isinstance(value, str) else str(value) for value in node.values]
        return values[0] if len(values) == 1 else "one of " + ", ".join(values)
    if isinstance(node, mi.TupleType):
        return f"an array of {len(node.item_types)} ({_expected(node.item_types[0])} each)"
    if isinstance(node, (mi.VarTupleType, mi.ListType)):
        least = f" of at least {node.min_length}" if node.min_length else ""
        return f"an array{least} ({_expected(node.item_type)} each)"
    if isinstance(node, mi.UnionType):
        return " or ".join(_expected(member) for member in node.types if not isinstance(member, mi.NoneType))
    return "a table"


def _limits(node: mi.FloatType | mi.IntType) -> str:
    if node.ge is not None and node.le is not None:
        return f" from {node.ge:g} to {node.le:g}"
    words = {"gt": "greater than", "ge": "of at least", "lt": "less than", "le": "of at most"}
    limits = [f"{text} {limit:g}" for key, text in words.items() if (limit := getattr(node, key)) is not None]
    return " " + " and ".join(limits) if limits else ""
