"""Where keys stand in a TOML text that the parser has already accepted."""

from __future__ import annotations

import re
import sys
from bisect import bisect_right

from uwserver.scenario.files.errors import KeyPath

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_TRIVIA = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:\\.|[^"\\])*"|'[^']*'""")
_STRING = re.compile(r'''"""(?:\\[\s\S]|[^\\])*?"{3,5}|\'\'\'[\s\S]*?'{3,5}|"(?:\\.|[^"\\])*"|'[^']*\'''')
_BARE_VALUE = re.compile(r"[^,\]}#\r\n]+")  # numbers, booleans, and dates, which may hold a space

MOST_PARTS = 32
"""Of a dotted key or of a header."""
_PART_OR_NOT = re.compile(rf"{_STRING.pattern}|#[^\n]*|[A-Za-z0-9_+-]+|[ \t]+|[\s\S]")

Locations = dict[KeyPath, tuple[int, int]]


def locate(text: str) -> Locations:
    """Line and column (from 1, in characters) of every key and array element.

    A table that is only implied by dotted keys or headers stands where its name is first mentioned; an array element stands where its value
    begins, an element of an array of tables at its header.

    Args:
        text: valid TOML; anything else gives places without meaning.
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
    """Parts of the dotted key with most of them, and its offset; in any text, valid or not, in a time that grows as its length."""
    most, longest, parts, start, joined = 0, 0, 0, 0, False
    for match in _PART_OR_NOT.finditer(text):
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
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._tables: dict[KeyPath, int] = {}  # elements so far of each array of tables
        self.found: dict[KeyPath, int] = {}

    def document(self) -> None:
        table: KeyPath = ()
        self._skip()
        while self._at < len(self._text):
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._skip()

    def _skip(self) -> None:
        self._at = self._match(_TRIVIA)[1]

    def _match(self, pattern: re.Pattern[str]) -> tuple[str, int]:
        match = pattern.match(self._text, self._at)
        if match is None:
            raise ValueError(f"no TOML at offset {self._at}")
        return match.group(), match.end()

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
        """A dotted key, each part with its offset; leaves the position behind it and its blanks."""
        keys: list[tuple[str, int]] = []
        while True:
            self._skip()
            raw, end = self._match(_KEY)
            # The parser's own rules undo quotes and escapes.
            key = next(iter(tomllib.loads(f"{raw} = 0"))) if raw[0] in "\"'" else raw
            keys.append((key, self._at))
            self._at = end
            self._skip()
            if not self._text.startswith(".", self._at):
                return keys
            self._at += 1

    def _pair(self, table: KeyPath) -> None:
        path = table
        for key, offset in self._keys():
            path = (*path, key)
            self.found.setdefault(path, offset)
        self._at += 1  # the equals sign
        self._skip()
        self._value(path)

    def _value(self, path: KeyPath) -> None:
        start = self._text[self._at]
        if start == "[":
            self._array(path)
        elif start == "{":
            self._inline_table(path)
        else:
            self._at = self._match(_STRING if start in "\"'" else _BARE_VALUE)[1]

    def _array(self, path: KeyPath) -> None:
        self._at += 1
        index = 0
        while self._more("]"):
            element = (*path, index)
            self.found[element] = self._at
            self._value(element)
            index += 1

    def _inline_table(self, path: KeyPath) -> None:
        self._at += 1
        while self._more("}"):
            self._pair(path)

    def _more(self, end: str) -> bool:
        """Step to the next entry of an array or inline table; False behind its end."""
        self._skip()
        if self._text[self._at] == ",":
            self._at += 1
            self._skip()
        if self._text[self._at] == end:
            self._at += 1
            return False
        return True
