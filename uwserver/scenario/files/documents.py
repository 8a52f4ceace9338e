"""Files on their way in: found, read and parsed, with the places of their keys."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, Severity, did_you_mean, dotted
from uwserver.scenario.files.locate import MOST_PARTS, Locations, locate, longest_key
from uwserver.scenario.files.opening import NOT_PLAIN, is_plain, read_whole

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


MOST_BYTES = 1 << 20
"""Of a TOML file: a scenario of a thousand vehicles has 150 kB."""


@dataclass(frozen=True)
class Document:
    """One parsed file, or the like of one built in Python.

    Attributes:
        label: the file as problems name it.
        raw: its top table.
        locations: line and column of every key; (0, 0) without a file.
        path: None without a file.
    """

    label: str
    raw: dict[str, Any]
    locations: Locations
    path: Path | None

    def problem(self, path: KeyPath, text: str, at: KeyPath | None = None, severity: Severity = "error") -> Problem:
        """A problem of the value at `path`, placed at the key `at` (default: `path`) or the nearest table around it."""
        place = path if at is None else at
        while place and place not in self.locations:
            place = place[:-1]
        line, column = self.locations.get(place, (0, 0) if self.path is None else (1, 1))
        return Problem(self.label, line, column, dotted(path), text, severity)


def read(path: Path) -> Document:
    """The parsed file.

    Raises:
        ScenarioError: it cannot be read, or is no TOML; the problem has the position.
    """
    label = label_of(path)
    try:
        text = read_whole(path, MOST_BYTES).decode("utf-8-sig")
        return parse(text, label, path.resolve())
    except OSError as error:
        raise ScenarioError([Problem(label, 0, 0, "", f"cannot read it: {error.strerror}")]) from error
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode("utf-8", "replace")
        text = f"byte 0x{error.object[error.start]:02x} is no UTF-8: save the file as UTF-8"
        raise ScenarioError([Problem(label, *_end(before), "", text)]) from error


_MOST_KEPT = 1 << 16
"""Characters of a text whose tables are kept: the largest shipped file has half of them."""


def parse(text: str, label: str, path: Path) -> Document:
    """The parsed text; ScenarioError as `read`."""
    try:
        raw, locations = _kept(text) if len(text) <= _MOST_KEPT else _parsed(text)
        return Document(label, _copied(raw), locations, path)
    except _TooManyParts as error:
        what = f"no valid scenario: a key of {error.parts} parts; at most {MOST_PARTS}"
        raise ScenarioError([Problem(label, *_end(text[: error.offset]), "", what)]) from None
    except RecursionError:
        problem = Problem(label, 1, 1, "", "no valid TOML: nested too deeply")
    except ValueError as error:
        message = str(error)
        match = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
        line, column = (int(match[2]), int(match[3])) if match else _end(text)
        reason = match[1] if match else message.removesuffix(" (at end of document)")
        problem = Problem(label, line, column, "", f"no valid TOML: {reason[:1].lower()}{reason[1:]}")
    raise ScenarioError([problem])


class _TooManyParts(Exception):
    def __init__(self, parts: int, offset: int) -> None:
        super().__init__()
        self.parts, self.offset = parts, offset


def _parsed(text: str) -> tuple[dict[str, Any], Locations]:
    parts, offset = longest_key(text)
    if parts > MOST_PARTS:  # the parser's time grows with the cube of them
        raise _TooManyParts(parts, offset)
    return tomllib.loads(text), locate(text)


_kept = lru_cache(maxsize=128)(_parsed)
"""A process that builds many worlds reads the same vehicles and devices again and again."""


def _copied(value: Any) -> Any:
    """Tables and arrays of a parsed text, as if it were parsed once more."""
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def from_tables(raw: dict[str, Any], label: str) -> Document:
    """A document that was built in Python: its keys have no positions."""
    locations: Locations = {}

    def visit(value: object, path: KeyPath) -> None:
        locations[path] = (0, 0)
        if isinstance(value, (list, tuple)):
            value = dict(enumerate(value))
        for key, item in value.items() if isinstance(value, dict) else ():
            visit(item, (*path, key))

    visit(raw, ())
    return Document(label, raw, locations, None)


def shipped(folder: str = "") -> dict[str, Path]:
    """Files of the package `uwserver_scenarios` by name: scenarios, or those of the folder "vehicles" or "devices"."""
    return {path.stem: path for path in sorted(_shipped(folder).glob("*.toml"))}


def find(reference: str, folder: str, beside: Path, fail: Callable[[str], None]) -> Path | None:
    """The file that a reference means: the name of a shipped one, or (with ``.toml`` or a slash) a path.

    Args:
        reference: as the user wrote it.
        folder: "", "vehicles" or "devices" of the shipped files.
        beside: folder that a relative path starts from.
        fail: told in words why there is none.
    """
    noun = {"": "scenario", "vehicles": "vehicle", "devices": "device"}[folder]
    if reference.endswith(".toml") or "/" in reference or "\\" in reference:
        path = beside / reference
        if is_plain(path):
            return path
        fail(f'there is no {noun} file "{label_of(path)}"{why_not(path)}')
        return None
    path = _shipped(folder) / f"{reference}.toml"
    if is_plain(path):
        return path
    names = list(shipped(folder))
    hint, there = did_you_mean(reference, names), ", ".join(names) or "none"
    fail(f'unknown {noun} "{reference}"{hint}; shipped: {there}; a file of your own needs its ".toml"')
    return None


def _shipped(folder: str) -> Path:
    return Path(str(resources.files("uwserver_scenarios"))) / folder


def label_of(path: Path) -> str:
    """The path as a user would type it: relative where it lies below the working folder."""
    try:
        # Links are left as they are: one may lead in a circle.
        absolute, here = Path(os.path.abspath(path)), Path.cwd()  # noqa: PTH100
    except ValueError:  # a NUL in the name
        return str(path)
    return str(absolute.relative_to(here)) if absolute.is_relative_to(here) else str(absolute)


def why_not(path: Path) -> str:
    """What to put behind the word that there is no such file; "" where nothing at all is there."""
    try:
        path.stat()
    except FileNotFoundError:
        return ": it is a link to nothing" if path.is_symlink() else ""
    except OSError as error:
        return f": {error.strerror}"
    except ValueError as error:
        return f": no file can have this name: {error}"
    return f": {NOT_PLAIN}"


def _end(text: str) -> tuple[int, int]:
    """Line and column behind the last character."""
    return text.count("\n") + 1, len(text) - text.rfind("\n")
