"""Reads single values from a message that cannot be decoded, so that its refusal can name the request that it answers."""

from __future__ import annotations

import json
import re

import msgspec

from uwserver.adapter.bounds import BINARY, LIST, MAP, MESSAGE_LIMIT, REFUSED, SIZES, TEXT, length_at

LOOKED_AT = 2048
"""Texts, maps and lists of JSON, or values of msgpack, that are examined, so that nonsense takes at most a millisecond."""

# The closing quote is optional. So a text without end takes linear time, and is the last token.
_STRING = rb'"[^"\\]*(?:\\.[^"\\]*)*"?'
_TOKEN = re.compile(_STRING + rb"|[\[\]{}]", re.DOTALL)
_VALUE = re.compile(rb"\s*:\s*(-?\d{1,20}(?![\d.eE])|" + _STRING + rb")", re.DOTALL)
_FIXED_EXTENSIONS = {0xD4: 3, 0xD5: 4, 0xD6: 6, 0xD7: 10, 0xD8: 18}


def json_member(text: bytes, name: str) -> int | str | None:
    """Return the first integer or text under a name in the outermost map of a JSON message, or None if it cannot be read."""
    head = text[:MESSAGE_LIMIT]
    key = b'"%s"' % name.encode()
    depth = 0
    for number, token in enumerate(_TOKEN.finditer(head)):
        found = token[0]
        if number >= LOOKED_AT or (depth < 1 and (number or found != b"{")):
            return None
        if found in (b"{", b"["):
            depth += 1
        elif found in (b"}", b"]"):
            depth -= 1
        elif depth == 1 and found == key and (value := _VALUE.match(head, token.end())):
            return _plain(value[1])
    return None


def _plain(token: bytes) -> int | str | None:
    try:
        value: int | str = json.loads(token)
        if isinstance(value, str):
            value.encode()
    except ValueError:
        # It is cut off, or has half a surrogate pair in it.
        return None
    return value


def msgpack_member(frame: bytes | memoryview, name: str) -> int | str | None:
    """Return the first integer or text under a name in the outermost map of a msgpack message, or None if it cannot be read."""
    if not frame or SIZES[frame[0]] != MAP:
        return None
    key = msgspec.msgpack.encode(name)
    entries, position = length_at(frame, 0)
    left = LOOKED_AT
    for _ in range(min(entries, LOOKED_AT)):
        value, left = _after(frame, position, left)
        end, left = _after(frame, value, left)
        if end > len(frame):
            return None
        if frame[position:value] == key:
            return _scalar(frame[value:end])
        position = end
    return None


def _scalar(data: bytes | memoryview) -> int | str | None:
    try:
        value = msgspec.msgpack.decode(data)
    except ValueError:
        return None
    return value if type(value) in (int, str) else None


def _after(frame: bytes | memoryview, position: int, left: int) -> tuple[int, int]:
    """Return where the value after this one begins, and how many more values may be examined.

    The position is beyond the end of the frame if this value is cut off, or has more parts than may be examined.
    """
    awaited = 1
    for looked in range(left):
        if position >= len(frame):
            break
        lead = frame[position]
        size = SIZES[lead]
        if size > 0:
            position += size
        elif size == REFUSED:
            position += _extension(frame, position)
        else:
            count, position = length_at(frame, position)
            if size in (TEXT, BINARY):
                position += count
            elif size in (LIST, MAP):
                awaited += count * -size
        awaited -= 1
        if not awaited:
            return position, left - looked - 1
    return len(frame) + 1, 0


def _extension(frame: bytes | memoryview, position: int) -> int:
    lead = frame[position]
    if lead in range(0xC7, 0xCA):
        width = 1 << lead - 0xC7
        return 2 + width + int.from_bytes(frame[position + 1 : position + 1 + width], "big")
    return _FIXED_EXTENSIONS.get(lead, 1)
