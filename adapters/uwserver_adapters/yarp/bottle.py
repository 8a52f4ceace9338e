"""YARP's bottles as text and in binary: lists of numbers, texts, vocabularies, blobs and lists. Items and depth are bounded.

Tags and quoting as in robotology/yarp (`BottleImpl`, `Storable`), read in its source and tried with its tools.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from uwserver.ports import Refused

ITEMS = 1024
"""Most items of a bottle that is read, including those of its lists: reading them takes a millisecond."""
TEXTS = 1 << 16
"""Most bytes in all texts of a bottle that is read: a megabyte that is no UTF-8 takes seven milliseconds."""
DEPTH = 32
"""Deepest list within lists."""
TEXT_BLOB = 4096
"""Longest blob that is written as text, bytes, as each byte becomes a number. A longer one is written as an empty blob."""

LIST, DICT = 256, 512
INT8, INT16, INT32, INT64 = 32, 64, 1, 17
FLOAT32, FLOAT64 = 10, 20
STRING, BLOB, VOCAB32, VOCAB64 = 4, 12, 9, 18


class Vocab(str):
    """A vocabulary: a short word that YARP keeps in an integer, ``[ok]``."""

    __slots__ = ()


Value: TypeAlias = "int | float | str | bytes | Sequence[Value]"

_I32 = struct.Struct("<i")
_NUMBERS: Mapping[int, struct.Struct] = {
    INT8: struct.Struct("<b"), INT16: struct.Struct("<h"), INT32: _I32, INT64: struct.Struct("<q"),
    FLOAT32: struct.Struct("<f"), FLOAT64: struct.Struct("<d"),
}  # fmt: skip
_FORMATS = {INT8: "b", INT16: "h", INT32: "i", INT64: "q", FLOAT32: "f", FLOAT64: "d"}
_VOCABS = {VOCAB32: 4, VOCAB64: 8}


# -- binary -------------------------------------------------------------------------------------------------------------------------------


def to_binary(values: Sequence[Value]) -> bytes:
    """Return a bottle in binary. If all items are floats, `yarp::sig::Vector` can read it."""
    return b"".join(_list(values))


def _list(values: Sequence[Value]) -> list[bytes]:
    if values and all(type(each) is float for each in values):
        return [struct.pack(f"<ii{len(values)}d", LIST + FLOAT64, len(values), *values)]
    parts = [struct.pack("<ii", LIST, len(values))]
    for each in values:
        parts += _item(each)
    return parts


def _item(value: Value) -> list[bytes]:
    if isinstance(value, bool | int):
        number = int(value)
        if -(2**31) <= number < 2**31:
            return [struct.pack("<ii", INT32, number)]
        return [struct.pack("<iq", INT64, max(-(2**63), min(number, 2**63 - 1)))]
    if isinstance(value, float):
        return [struct.pack("<id", FLOAT64, value)]
    if isinstance(value, Vocab):
        word = value.encode()[:8]
        return [struct.pack("<i4s", VOCAB32, word) if len(word) <= 4 else struct.pack("<i8s", VOCAB64, word)]
    if isinstance(value, str):
        text = value.encode("utf-8", "replace")
        return [struct.pack("<ii", STRING, len(text)), text]
    if isinstance(value, bytes):
        return [struct.pack("<ii", BLOB, len(value)), value]
    return _list(value)


def from_binary(data: bytes | memoryview) -> list[Value]:
    """Return the values of a bottle in binary.

    Raises:
        Refused: it is no bottle (`parse_error`), or has too many items (`too_large`).
    """
    reader = _Reader(data)
    code = reader.number(_I32)
    if not code & (LIST | DICT):
        raise Refused("parse_error", f"a bottle begins with the tag of a list, {LIST}, not {code}")
    return reader.list(code & ~(LIST | DICT), 0)


class _Reader:
    """Reads through a bottle once, and counts items and bytes of texts."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self._at = 0
        self._items = 0
        self._texts = 0

    def number(self, form: struct.Struct) -> int:
        found: int = form.unpack(self._take(form.size))[0]
        return found

    def _take(self, size: int) -> memoryview:
        if not 0 <= size <= len(self._data) - self._at:
            raise Refused("parse_error", "a bottle ends within an item, or an item claims more bytes than there are")
        taken = self._data[self._at : self._at + size]
        self._at += size
        return taken

    def list(self, code: int, depth: int) -> list[Value]:
        count = self.number(_I32)
        self._items += max(count, 0)
        if count < 0 or self._items > ITEMS or depth > DEPTH:
            raise Refused("too_large", f"a bottle has at most {ITEMS} items in {DEPTH} lists within each other")
        if code in _FORMATS:
            form = struct.Struct(f"<{count}{_FORMATS[code]}")
            return list(form.unpack(self._take(form.size)))
        return [self._value(code or self.number(_I32), depth) for _ in range(count)]

    def _value(self, code: int, depth: int) -> Value:
        if code & (LIST | DICT):
            return self.list(code & ~(LIST | DICT), depth + 1)
        if code in _NUMBERS:
            return self.number(_NUMBERS[code])
        if code in _VOCABS:
            return Vocab(bytes(self._take(_VOCABS[code])).rstrip(b"\0").decode("utf-8", "replace"))
        if code == STRING:
            text = self._take(self.number(_I32))
            self._texts += len(text)
            if self._texts > TEXTS:
                raise Refused("too_large", f"the texts of a bottle have at most {TEXTS} bytes")
            return bytes(text).decode("utf-8", "replace")
        if code == BLOB:
            return bytes(self._take(self.number(_I32)))
        raise Refused("parse_error", f"no item has the tag {code}")


# -- text ---------------------------------------------------------------------------------------------------------------------------------

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z_0-9.\-]*")
_ESCAPES = {"\n": "\\n", "\r": "\\r", "\0": "\\0", "\\": "\\\\", '"': '\\"'}
_UNESCAPES = {"n": "\n", "r": "\r", "0": "\0"}
_WORDS = ("true", "false", "null", "inf", "nan")
_NO_WORD = re.compile(r"[^!-~]|[\[\]]")


def to_text(values: Sequence[Value]) -> str:
    """Return a bottle on one line, without the line end."""
    return " ".join(map(_text, values))


def _text(value: Value) -> str:
    if isinstance(value, bool | int):
        return str(int(value))
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, Vocab):
        return f"[{_NO_WORD.sub('', value)}]" if value else "[]"
    if isinstance(value, str):
        if _PLAIN.fullmatch(value) and value not in _WORDS:
            return value
        return '"' + "".join(_ESCAPES.get(ch, ch) for ch in value) + '"'
    if isinstance(value, bytes):
        return "{" + (" ".join(map(str, value)) if len(value) <= TEXT_BLOB else "") + "}"
    return f"({to_text(value)})"


# In this order: a quoted text, a blob, a bracket of a list, or a word up to the next blank.
_TOKEN = re.compile(r'\s*,?\s*(?:("(?:[^"\\]|\\.)*")|(\{[^{}]*\})|([()])|((?:[^\s(){}",\\]|\\.)+))', re.DOTALL)
_INTEGER = re.compile(r"[+-]?\d{1,19}")
_HEXADECIMAL = re.compile(r"[+-]?0[xX][0-9a-fA-F]{1,8}")
_FLOAT = re.compile(r"[+-]?(?:\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)")
_NAMED: Mapping[str, Value] = {
    "true": Vocab("1"), "false": Vocab(""), "null": Vocab("null"), "inf": math.inf, "-inf": -math.inf, "nan": math.nan,
}  # fmt: skip


def from_text(line: str) -> list[Value]:
    """Return the values of a bottle on one line.

    Raises:
        Refused: it is no bottle (`parse_error`), or has too many items (`too_large`).
    """
    top: list[Value] = []
    lists = [top]
    at, line = 0, line.strip()
    for _ in range(ITEMS + 2):
        if at >= len(line):
            break
        found = _TOKEN.match(line, at)
        if found is None:
            raise Refused("parse_error", f"no bottle from here: {line[at : at + 40]}")
        at = found.end()
        bracket = found[3]
        if bracket == "(":
            if len(lists) > DEPTH:
                raise Refused("too_large", f"a bottle has at most {DEPTH} lists within each other")
            inner: list[Value] = []
            lists[-1].append(inner)
            lists.append(inner)
        elif bracket == ")":
            if len(lists) == 1:
                raise Refused("parse_error", "a list ends that has not begun")
            lists.pop()
        else:
            lists[-1].append(_READERS[found.lastindex or 4](found[0].strip().lstrip(",").lstrip()))
    if at < len(line):
        raise Refused("too_large", f"a bottle has at most {ITEMS} items")
    if len(lists) > 1:
        raise Refused("parse_error", "a list has no end: a closing bracket is missing")
    return top


def _quoted(token: str) -> Value:
    return re.sub(r"\\(.)", lambda found: _UNESCAPES.get(found[1], found[1]), token[1:-1], flags=re.DOTALL)


def _blob(token: str) -> Value:
    try:
        return bytes(int(each) & 0xFF for each in token[1:-1].split())
    except ValueError:
        raise Refused("parse_error", "a blob is {whole numbers}") from None


def _word(token: str) -> Value:
    if token in _NAMED:
        return _NAMED[token]
    if _INTEGER.fullmatch(token):
        return int(token)
    if _HEXADECIMAL.fullmatch(token):
        return int(token, 16)
    if _FLOAT.fullmatch(token):
        return float(token)
    if token[0] == "[" and token[-1] == "]":
        return Vocab(token[1:-1])
    return re.sub(r"\\(.)", r"\1", token, flags=re.DOTALL)


_READERS: Mapping[int, Callable[[str], Value]] = {1: _quoted, 2: _blob, 4: _word}
