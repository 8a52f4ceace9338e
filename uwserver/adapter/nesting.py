"""Checks of a message before a decoder sees it: how deep it nests, and whether what it claims to hold is really there.

Both run without recursion and in a time that grows with the message's length alone, so no peer can exhaust the stack, the memory (msgspec
makes a list as long as a msgpack header claims) or the loop.
"""

from __future__ import annotations

import re

MAX_DEPTH = 32
"""Maps and lists within each other."""
MAX_VALUES = 1 << 18
"""Values in one msgpack message: bounds the time of its check."""
MAX_BINARY = 4 << 20
"""Bytes in all binary values of one msgpack message."""

# The closing quote is optional: the pattern then never has to give back what it took, and an unterminated string costs linear time.
_JSON_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def json_fault(line: bytes) -> str | None:
    """Why a JSON line is not decoded; None when it may be. What is no JSON is the decoder's to say."""
    if line.count(b"[") + line.count(b"{") <= MAX_DEPTH:
        return None
    depth = 0
    for bracket in _JSON_STRING.sub(b"", line).translate(None, _NO_BRACKETS):
        depth += 1 if bracket in b"[{" else -1
        if depth > MAX_DEPTH:
            return _too_deep()
    return None


def msgpack_fault(frame: bytes) -> str | None:
    """Why a msgpack frame is not decoded; None when exactly one complete value of maps, lists, texts, bytes and numbers fills it."""
    position, end = 0, len(frame)
    open_containers: list[int] = []  # values that each enclosing container still waits for
    awaited = 1
    values = binary = 0
    while awaited or open_containers:
        if not awaited:
            awaited = open_containers.pop()
            continue
        if position >= end:
            return "the frame ends within a value"
        awaited -= 1
        lead = frame[position]
        size = _SIZES[lead]
        if size > 0:
            position += size
        elif size == _REFUSED:
            return f"type byte 0x{lead:02x} is not part of the schema: send maps, lists, texts, bytes, numbers, booleans and nil"
        else:
            width = _WIDTHS[lead]
            # Of a one-byte header the low bits count: 4 for maps and lists (texts so short are in _SIZES).
            count = int.from_bytes(frame[position + 1 : position + 1 + width], "big") if width else lead & 0x0F
            position += 1 + width
            if size in (_TEXT, _BINARY):
                position += count
                binary += count if size == _BINARY else 0
                if binary > MAX_BINARY:
                    return f"more than {MAX_BINARY} bytes in binary values: send several messages"
                continue
            count *= -size  # a map holds a key and a value for each entry
            values += count
            if values > MAX_VALUES:
                return f"more than {MAX_VALUES} values in one message: send several"
            open_containers.append(awaited)
            awaited = count
            if len(open_containers) > MAX_DEPTH:
                return _too_deep()
    return None if position == end else "the length of the frame does not fit its value"


def _too_deep() -> str:
    return f"nested deeper than {MAX_DEPTH} levels: flatten the message"


_LIST, _MAP, _TEXT, _BINARY, _REFUSED = -1, -2, -3, -4, -5


def _sizes() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """By type byte: bytes of a whole scalar or short text, else what it begins; and the width of its length field."""
    sizes, widths = [1] * 256, [0] * 256
    for lead in range(0x80, 0x90):
        sizes[lead] = _MAP
    for lead in range(0x90, 0xA0):
        sizes[lead] = _LIST
    for lead in range(0xA0, 0xC0):
        sizes[lead] = 1 + (lead & 0x1F)
    for lead in (0xC1, *range(0xC7, 0xCA), *range(0xD4, 0xD9)):  # unused, extensions
        sizes[lead] = _REFUSED
    for lead, size in zip(range(0xCA, 0xD4), (5, 9, 2, 3, 5, 9, 2, 3, 5, 9), strict=True):  # floats, then integers
        sizes[lead] = size
    for lead, (size, width) in zip(
        (*range(0xC4, 0xC7), *range(0xD9, 0xE0)),
        (
            *((_BINARY, n) for n in (1, 2, 4)),
            *((_TEXT, n) for n in (1, 2, 4)),
            (_LIST, 2),
            (_LIST, 4),
            (_MAP, 2),
            (_MAP, 4),
        ),
        strict=True,
    ):
        sizes[lead], widths[lead] = size, width
    return tuple(sizes), tuple(widths)


_SIZES, _WIDTHS = _sizes()
