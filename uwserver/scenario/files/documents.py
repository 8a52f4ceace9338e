"""Finds, reads, parses and merges scenario, vehicle and device files, and keeps the place of every key.

Files from outside are opened safely: only regular files, and only up to a given size.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import IO, Any

from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, Severity, did_you_mean, dotted, label_of
from uwserver.scenario.files.formats import Kind, format_of, told
from uwserver.scenario.files.locate import MOST_PARTS, Locations, locate, longest_key
from uwserver.scenario.files.words import translation

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


MOST_BYTES = 1 << 20
"""Largest TOML file, bytes: a scenario of a thousand vehicles has 150 kB."""
SHIPPED: Mapping[str, Kind] = {"": "scenario", "vehicles": "vehicle", "devices": "device"}
"""The kind of the shipped files in each folder."""
NOT_PLAIN = "it is not a regular file (but a folder, a pipe or a device)"


@dataclass(frozen=True)
class Document:
    """A parsed file, or tables that were built in Python.

    Attributes:
        label: what problems call it: the path of the file, or the title of the scenario.
        raw: its top table.
        locations: line and column of every key; (0, 0) if there is no file.
        path: path of the file; None if there is none.
    """

    label: str
    raw: dict[str, Any]
    locations: Locations
    path: Path | None

    @property
    def folder(self) -> Path:
        """Folder where relative file names of the document start: its own, or the working folder if it has no file."""
        return Path.cwd() if self.path is None else self.path.parent

    def problem(self, path: KeyPath, text: str, at: KeyPath | None = None, severity: Severity = "error") -> Problem:
        """Return a problem of the value at `path`. Its place is that of the key `at` (default: `path`), or of the nearest table around it."""
        place = path if at is None else at
        while place and place not in self.locations:
            place = place[:-1]
        line, column = self.locations.get(place, (0, 0) if self.path is None else (1, 1))
        return Problem(self.label, line, column, dotted(path), text, severity)


def read(path: Path) -> Document:
    """Read and parse a file.

    Raises:
        ScenarioError: it cannot be read, or is not TOML; the problem has the position, or says what kind of file it is.
    """
    label = label_of(path)
    kind = None if path.suffix.lower() == ".toml" else format_of(path)
    if kind not in (None, "folder"):
        raise ScenarioError([Problem(label, 0, 0, "", told(label, kind))])
    try:
        text = read_whole(path, MOST_BYTES).decode("utf-8-sig")
        return parse(text, label, path.resolve())
    except OSError as error:
        raise ScenarioError([Problem(label, 0, 0, "", f"cannot read it: {error.strerror}")]) from error
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode("utf-8", "replace")
        text = f"byte 0x{error.object[error.start]:02x} is not valid UTF-8: save the file as UTF-8"
        raise ScenarioError([Problem(label, *_end(before), "", text)]) from error


_MOST_KEPT = 1 << 16
"""Longest text, in characters, whose tables are cached: the largest shipped file has half of that."""


def parse(text: str, label: str, path: Path) -> Document:
    """Parse a text; ScenarioError as `read`."""
    try:
        raw, locations = _cached(text) if len(text) <= _MOST_KEPT else _parsed(text)
        return Document(label, _copied(raw), locations, path)
    except RecursionError:
        line, column, reason = 1, 1, "nested too deeply"
    except ValueError as error:
        message = str(error)
        match = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
        line, column = (int(match[2]), int(match[3])) if match else _end(text)
        reason = match[1] if match else message.removesuffix(" (at end of document)")
    raise ScenarioError([Problem(label, line, column, "", f"not valid TOML: {reason[:1].lower()}{reason[1:]}")])


def _parsed(text: str) -> tuple[dict[str, Any], Locations]:
    parts, offset = longest_key(text)
    if parts > MOST_PARTS:  # the parser's time grows with the cube of their number
        line, column = _end(text[:offset])
        raise ValueError(f"a key has {parts} parts, at most {MOST_PARTS} are allowed (at line {line}, column {column})")
    return tomllib.loads(text), locate(text)


# A process that builds many worlds reads the same vehicle and device files again and again.
_cached = lru_cache(maxsize=128)(_parsed)


def _copied(value: Any) -> Any:
    """Return a copy of parsed tables and arrays, so that callers cannot change the cached ones; quicker than `copy.deepcopy`."""
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def from_tables(raw: dict[str, Any], label: str) -> Document:
    """Return a document for tables that were built in Python: its keys have no positions."""
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
    """Return the shipped files by name: scenarios, or those of the folder "vehicles" or "devices"."""
    return {path.stem: path for path in sorted(_shipped(folder).glob("*.toml"))}


def find(reference: str, folder: str, beside: Path, fail: Callable[[str], None]) -> Path | None:
    """Return the file that a reference means: the name of a shipped file, or a path (it has ``.toml`` or a slash).

    Args:
        reference: what the user wrote. A file of that name counts, also without ``.toml`` or a slash, if nothing of that name is shipped.
        folder: folder of the shipped files: "", "vehicles" or "devices".
        beside: folder where a relative path starts.
        fail: called with the reason if there is no such file.
    """
    noun = SHIPPED[folder]
    if reference.endswith(".toml") or "/" in reference or "\\" in reference:
        path = beside / reference
        if is_plain(path):
            return path
        fail(f'there is no {noun} file "{label_of(path)}"{why_not(path)}')
        return None
    path = _shipped(folder) / f"{reference}.toml"
    if is_plain(path):
        return path
    if is_plain(beside / reference):
        return beside / reference
    names = list(shipped(folder))
    if is_plain(beside / f"{reference}.toml"):
        fail(f'unknown {noun} "{reference}" (did you mean the file "{reference}.toml"?)')
        return None
    hint = translation(reference, names) or did_you_mean(reference, names)
    others = [kind for other, kind in SHIPPED.items() if other != folder and reference in shipped(other)]
    if others:
        fail(f'"{reference}" is not a {noun}: {told(reference, others[0])}')
        return None
    fail(
        f'unknown {noun} "{reference}"{hint}; shipped: {", ".join(names) or "none"}; for a file of your own write its path with ".toml"'
    )
    return None


def _shipped(folder: str) -> Path:
    return Path(str(resources.files("uwserver_scenarios"))) / folder


def why_not(path: Path) -> str:
    """Return why there is no such file, to be put behind that statement; "" if nothing at all is there."""
    try:
        path.stat()
    except FileNotFoundError:
        return ": it is a link to a file that does not exist" if path.is_symlink() else ""
    except OSError as error:
        return f": {error.strerror}"
    except ValueError as error:
        return f": a file cannot have this name: {error}"
    return f": {NOT_PLAIN}"


def _end(text: str) -> tuple[int, int]:
    """Return line and column (from 1) just behind the last character."""
    return text.count("\n") + 1, len(text) - text.rfind("\n")


# -- merging raw tables -----------------------------------------------------------------------------------------------------------------


def named(raw: Mapping[str, Any], table: str) -> dict[str, Any]:
    """Return the table of this name; an empty one if it is missing or not a table."""
    found = raw.get(table)
    return found if isinstance(found, dict) else {}


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of `base` in which the keys of `override` replace its own; tables on both sides are merged in the same way."""
    whole = dict(base)
    for key, value in override.items():
        below = whole.get(key)
        whole[key] = merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return whole


# -- opening files ----------------------------------------------------------------------------------------------------------------------


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open a file for reading. The call does not wait for the writer of a pipe, and does not read a device.

    Raises:
        OSError: it cannot be opened, or is not a regular file; `strerror` says why in words.
    """
    try:
        # Without O_NONBLOCK the call would wait until somebody writes to a pipe.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:  # the name has a NUL or half a surrogate pair
        raise OSError(errno.EINVAL, f"a file cannot have this name: {error}") from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, NOT_PLAIN)
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            yield file
    finally:
        os.close(descriptor)


def read_whole(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a file. It is read once, so what was checked stays true even if the file changes later.

    Raises:
        OSError: as `opened`; or the file has more than `most_bytes`, or grows while it is read.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most_bytes:
            raise OSError(errno.EFBIG, f"it has {size} bytes; at most {most_bytes} are allowed")
        data = file.read(size + 1)
    if len(data) > size:
        raise OSError(errno.EAGAIN, "it grew while it was read: try again once it is complete")
    return data


def is_plain(path: Path) -> bool:
    """Return whether this is a regular file; False also if the folder may not be read or the name is impossible."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
