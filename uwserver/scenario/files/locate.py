"""Finds the line and column of every key in a TOML text that the parser has already accepted."""

from __future__ import annotations

import re
import sys
from bisect import bisect_right
from collections.abc import Iterator

from uwserver.scenario.files.errors import KeyPath

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_TRIVIA = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SEPARATOR = re.compile(r"(?:[ \t\r\n,]|#[^\n]*)*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:\\.|[^"\\])*"|'[^']*'""")
_STRING = re.compile(r'''"""(?:\\[\s\S]|[^\\])*?"{3,5}|\'\'\'[\s\S]*?'{3,5}|"(?:\\.|[^"\\])*"|'[^']*\'''')
_BARE_VALUE = re.compile(r"[^,\]}#\r\n]+")  # numbers, booleans, and dates, which may hold a space

MOST_PARTS = 32
"""Most parts of a dotted key or of a header."""
_TOKEN = re.compile(rf"{_STRING.pattern}|#[^\n]*|[A-Za-z0-9_+-]+|[ \t]+|[\s\S]")

Locations = dict[KeyPath, tuple[int, int]]


def locate(text: str) -> Locations:
    """Return line and column (from 1, in characters) of every key and array element.

    A table that exists only through dotted keys or headers is placed where its name first occurs. An array element is placed where its value
    begins, and an element of an array of tables at its header.

    Args:
        text: valid TOML; for other texts the places mean nothing.
    """
    scanner = _Scanner(text)
    scanner.document()
    line_starts = [0, *(match.end() for match in re.finditer("\n", text))]
    places: Locations = {}
    for path, offset in scanner.found.items():
        line = bisect_right(line_starts, offset)
        places[path] = (line, offset - line_starts[line - 1] + 1)
    return places


def longest_key(text: str) -> tuple[int, int]:
    """Return the number of parts of the longest dotted key, and its offset.

    It works on any text, valid or not, in a time that is linear in its length.
    """
    most, longest, parts, start, joined = 0, 0, 0, 0, False
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token.isspace() and token != "\n":
            continue
        if token == ".":
            joined = True
            continue
        if not (token[0].isalnum() or token[0] in "_-+\"'"):
            parts = 0
        elif joined and parts:
            parts += 1
        else:
            parts, start = 1, match.start()
        joined = False
        if parts > most:
            most, longest = parts, start
    return most, longest


class _Scanner:
    """A recursive-descent scanner over a TOML text. `found` holds the offset of each key."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._tables: dict[KeyPath, int] = {}  # number of elements so far of each array of tables
        self.found: dict[KeyPath, int] = {}

    def document(self) -> None:
        table: KeyPath = ()
        self._take(_TRIVIA)
        while self._at < len(self._text):
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._take(_TRIVIA)

    def _take(self, pattern: re.Pattern[str]) -> str:
        """Step over what the pattern matches here, and return it."""
        match = pattern.match(self._text, self._at)
        if match is None:
            raise ValueError(f"no TOML at offset {self._at}")
        self._at = match.end()
        return match.group()

    def _header(self) -> KeyPath:
        double = self._text.startswith("[[", self._at)
        self._at += 2 if double else 1
        keys = self._keys()
        self._at += 2 if double else 1
        path: KeyPath = ()
        for k, (key, offset) in enumerate(keys):
            path = (*path, key)
            self.found.setdefault(path, offset)
            if double and k == len(keys) - 1:
                self._tables[path] = self._tables.get(path, 0) + 1
            if path in self._tables:
                path = (*path, self._tables[path] - 1)
                self.found.setdefault(path, offset)
        return path

    def _keys(self) -> list[tuple[str, int]]:
        """Read a dotted key and the blanks behind it; return each part with its offset."""
        keys: list[tuple[str, int]] = []
        while True:
            self._take(_TRIVIA)
            start, raw = self._at, self._take(_KEY)
            # The parser itself undoes quotes and escapes.
            keys.append((next(iter(tomllib.loads(f"{raw} = 0"))) if raw[0] in "\"'" else raw, start))
            self._take(_TRIVIA)
            if not self._text.startswith(".", self._at):
                return keys
            self._at += 1

    def _pair(self, table: KeyPath) -> None:
        path = table
        for key, offset in self._keys():
            path = (*path, key)
            self.found.setdefault(path, offset)
        self._at += 1  # the equals sign
        self._take(_TRIVIA)
        self._value(path)

    def _value(self, path: KeyPath) -> None:
        start = self._text[self._at]
        if start == "[":
            for index, _ in enumerate(self._entries("]")):
                element = (*path, index)
                self.found[element] = self._at
                self._value(element)
        elif start == "{":
            for _ in self._entries("}"):
                self._pair(path)
        else:
            self._take(_STRING if start in "\"'" else _BARE_VALUE)

    def _entries(self, end: str) -> Iterator[None]:
        """Step to each entry of an array or inline table, whose content the caller reads, and then over its end."""
        self._at += 1
        self._take(_SEPARATOR)
        while self._text[self._at] != end:
            yield
            self._take(_SEPARATOR)
        self._at += 1
