"""Lines of text, both sides, without input or output. The grammar is docs/reference/moos_text.md.

Each line is ``[#tag] NAME=value [NAME=value ...]`` or ``[#tag] VERB arguments``; a value is a number or a text, quoted as in JSON if need be.
"""

from __future__ import annotations

import math
import re

import msgspec
from msgspec import Struct

from uwserver.adapter import Lines
from uwserver.ports import ErrorCode, Refused

VERBS = ("SUBSCRIBE", "UNSUBSCRIBE", "LIST", "GET", "CALL", "HELP", "QUIT")
LINE_LIMIT = 1 << 16
"""Longest line, bytes."""
PAIRS = 256
"""Most variables that one line may write."""
TEXT_LIMIT = 1 << 15
"""Longest quoted text, characters."""
NUMBER_LIMIT = 64
"""Longest number, characters."""

_TAG = re.compile(r"#(\S{1,64})(?:\s+|$)")
_NAME = re.compile(r"[^\s=,;\"#]{1,256}")
_QUOTED = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"')
_BARE = re.compile(r"[^\s,;\"=]+")
_GAP = re.compile(r"[\s,;]*")
_ADVICE = 'separate pairs by spaces, commas or semicolons, and quote a text with such or with "=" in it: USM_RESET="x=0,y=-20"'
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


class Write(Struct, frozen=True):
    """A line that writes variables."""

    pairs: tuple[tuple[str, float | str], ...]
    tag: str = ""


class Verb(Struct, frozen=True):
    """A line with something to do: `verb` is one of VERBS, `rest` is the text behind it."""

    verb: str
    rest: str = ""
    tag: str = ""


class Malformed(Struct, frozen=True):
    """A line that cannot be understood. The next one can."""

    code: ErrorCode
    text: str
    tag: str = ""


class LineDecoder(Lines):
    """Turns the bytes of one connection into events: `receive` stores, `next_event` parses.

    Args:
        limit: longest line, bytes. A longer one is reported once, and thrown away as it comes.
    """

    def __init__(self, limit: int = LINE_LIMIT) -> None:
        super().__init__(limit)

    def next_event(self) -> Write | Verb | Malformed | None:
        """Return the next line's meaning; None until more bytes come."""
        try:
            line = self.next_line()
        except Refused as refused:
            return Malformed(refused.fault.code, refused.fault.text)
        return None if line is None else parse(line)


def parse(line: bytes) -> Write | Verb | Malformed:
    """Return the meaning of one line, without its end."""
    try:
        text = line.decode().strip()
    except UnicodeDecodeError as error:
        return Malformed("parse_error", f"no UTF-8 at byte {error.start}")
    tag = ""
    if found := _TAG.match(text):
        tag, text = found[1], text[found.end() :]
    word, _, rest = text.partition(" ")
    if word.upper() in VERBS:
        return Verb(word.upper(), rest.strip(), tag)
    try:
        return Write(_pairs(text), tag)
    except ValueError as error:
        return Malformed("parse_error", str(error), tag)


def _pairs(text: str) -> tuple[tuple[str, float | str], ...]:
    pairs = []
    at = 0
    while at < len(text):
        name = _NAME.match(text, at)
        if name is None or text[name.end() : name.end() + 1] != "=":
            raise ValueError(f'"{text[at : at + 40]}" is neither NAME=value nor one of {", ".join(VERBS)}')
        value, at = _value(text, name.end() + 1)
        pairs.append((name[0], value))
        if len(pairs) > PAIRS:
            raise ValueError(f"a line writes at most {PAIRS} variables: write several lines")
        gap = _GAP.match(text, at)
        assert gap is not None
        if gap.end() == at and at < len(text):
            raise ValueError(f'"{text[at : at + 40]}" behind a value: {_ADVICE}')
        at = gap.end()
    if not pairs:
        raise ValueError("nothing behind the tag")
    return tuple(pairs)


def _value(text: str, at: int) -> tuple[float | str, int]:
    if text[at : at + 1] == '"':
        quoted = _QUOTED.match(text, at, at + TEXT_LIMIT)
        if quoted is None and len(text) > at + TEXT_LIMIT:
            raise ValueError(f"a quoted text has at most {TEXT_LIMIT} characters")
        if quoted is None:
            raise ValueError('a quoted text that does not end: close it with ", write " within it as \\"')
        try:
            return msgspec.json.decode(quoted[0].encode(), type=str), quoted.end()
        except msgspec.DecodeError:
            raise ValueError(f"{quoted[0][:40]}: quote as in JSON") from None
    bare = _BARE.match(text, at)
    if bare is None:
        raise ValueError('a value is missing: write "" for an empty text')
    word = bare[0]
    if len(word) <= NUMBER_LIMIT and _NUMBER.fullmatch(word):
        number = float(word)
        if not math.isfinite(number):
            raise ValueError(f"{word[:40]} is too large")
        return number, bare.end()
    return word, bare.end()


def pair_line(name: str, value: float | str | bytes) -> str:
    """Return a variable as a line: numbers in full precision, texts always quoted, of binary values the size."""
    if isinstance(value, bytes):
        return f'{name}="<binary> {len(value)} bytes"'
    if isinstance(value, str):
        return f"{name}={msgspec.json.encode(value.encode('utf-8', 'replace').decode()).decode()}"
    return f"{name}={value!r}"


def reply_line(tag: str, text: str = "") -> str:
    """Return the answer to a line that was carried out."""
    return " ".join(filter(None, (_tagged(tag), "OK", text)))


def error_line(tag: str, code: str, text: str) -> str:
    """Return the answer to a line that was not carried out."""
    return " ".join(filter(None, (_tagged(tag), "ERROR", code, " ".join(text.split()))))


def _tagged(tag: str) -> str:
    return f"#{tag}" if tag else ""
