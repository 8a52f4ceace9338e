"""Splits streams of bytes into lines or frames, and decodes these into values, without a socket. A fault of a peer is an exception with a text.

If a message cannot be decoded, `json_member` and `msgpack_member` read single values from it, so that its refusal can name the request that it
answers.

`receive` only stores bytes, ``next_...`` parses them. Not more than the limit is kept, and no memory is reserved for a length that was only
claimed.
"""

from __future__ import annotations

import json
import re
from typing import Literal, NoReturn

import msgspec

from uwserver.adapter.bounds import (
    BINARY,
    LIST,
    MAP,
    MESSAGE_LIMIT,
    REFUSED,
    SIZES,
    TEXT,
    Excess,
    length_at,
    weigh_json,
    weigh_msgpack,
)
from uwserver.ports import ErrorCode, Refused

EncodingName = Literal["json", "msgpack"]

LARGE = 64 << 10
"""Length in bytes from which a frame is not copied: a copy into fresh memory takes 0.6 ms per megabyte."""

_HEAD = 4 << 10
"""Bytes that are kept of a line that is too long, from which its request can be recognised."""

_JSON = msgspec.json.Decoder()
_MSGPACK = msgspec.msgpack.Decoder()

_PAIR = re.compile(rb"\\u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}")
_BLANKS = re.compile(rb"\s+")
_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")

LOOKED_AT = 2048
"""Texts, maps and lists of JSON, or values of msgpack, that are examined, so that nonsense takes at most a millisecond."""
# The closing quote is optional. So a text without end takes linear time, and is the last token.
_STRING = rb'"[^"\\]*(?:\\.[^"\\]*)*"?'
_TOKEN = re.compile(_STRING + rb"|[\[\]{}]", re.DOTALL)
_VALUE = re.compile(rb"\s*:\s*(-?\d{1,20}(?![\d.eE])|" + _STRING + rb")", re.DOTALL)
_FIXED_EXTENSIONS = {0xD4: 3, 0xD5: 4, 0xD6: 6, 0xD7: 10, 0xD8: 18}


class Undecodable(Refused):
    """Bytes that are no value (`parse_error`), or a value that is refused (`invalid_request`, `too_large`); the text says why.

    Attributes:
        is_valid: whether it may be a value of this encoding that is refused, because it is nested too deep, for example.
    """

    def __init__(self, code: ErrorCode, reason: str) -> None:
        super().__init__(code, reason)
        self.is_valid = code != "parse_error"


def decode(data: bytes | memoryview, encoding: EncodingName) -> object:
    """Decode exactly one value. No message takes more stack, memory or time than the limits of `bounds` allow.

    Args:
        data: the encoded value; JSON as bytes.
        encoding: its encoding.

    Raises:
        Undecodable: it is no value, or a value that is refused.
    """
    try:
        if encoding == "msgpack":
            weigh_msgpack(data)
            value: object = _MSGPACK.decode(data)
            return value
        data = bytes(data)
        return _decoded_slowly(data) if weigh_json(data) else _JSON.decode(data)
    except Excess as excess:
        raise Undecodable(excess.code, str(excess)) from None
    except ValueError as error:
        # Errors of msgspec are ValueErrors, and so are those of text that is no UTF-8.
        raise Undecodable("parse_error", str(error)) from None


def _decoded_slowly(data: bytes) -> object:
    """Decode JSON with many exponents and long numbers. msgspec takes up to 15 us for such a number, the standard library 0.5 us."""
    if b"\\u" in data and _SURROGATE.search(_PAIR.sub(b"", data.replace(b"\\\\", b""))):
        raise ValueError("half a surrogate pair")
    return _SLOW.decode(data.decode())


def _finite(text: str) -> float:
    number = float(text)
    if number - number != 0.0:
        raise ValueError("Number out of range")
    return number


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON")


_SLOW = json.JSONDecoder(parse_float=_finite, parse_constant=_no_constant)


class TooLong(Refused):
    """A line is longer than the limit.

    Attributes:
        head: its first bytes.
    """

    def __init__(self, limit: int, head: bytes) -> None:
        super().__init__("too_large", f"a line holds at most {limit} bytes: the rest of it is skipped")
        self.head = head


class Lines:
    """Splits a stream into lines that end in LF or CRLF. Blanks around lines are removed, and blank lines are skipped.

    Args:
        limit: longest line, bytes; the rest of a longer line is thrown away as it comes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._buffer = bytearray()
        self._searched = 0
        self._is_skipping = False

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""
        if self._is_skipping:
            end = data.find(b"\n")
            if end < 0:
                return
            self._is_skipping = False
            data = data[end + 1 :]
        self._buffer += data

    def next_line(self) -> bytes | None:
        """Return the next line, or None until more bytes come.

        Raises:
            TooLong: a line is too long. It is raised once for each such line; the next line can be read then.
        """
        while True:
            end = self._buffer.find(b"\n", self._searched)
            if end < 0:
                self._searched = len(self._buffer)
                if self._searched > self.limit:
                    self._is_skipping = True
                    self._too_long(self._searched)
                return None
            if end > self.limit:
                self._too_long(end + 1)
            line = _copied(self._buffer, 0, end).strip()
            del self._buffer[: end + 1]
            self._searched = 0
            if line:
                return line
            self._skip_blanks()

    def _skip_blanks(self) -> None:
        """Skip all blank lines at once. One by one, those of a single piece of input could take the time of hundreds of ticks."""
        blanks = _BLANKS.match(self._buffer)
        if blanks is not None:
            end = blanks.end()
            # The match holds a view of the buffer, which could not be resized.
            del blanks
            del self._buffer[: self._buffer.rfind(b"\n", 0, end) + 1]

    def _too_long(self, size: int) -> None:
        head = _copied(self._buffer, 0, min(size, _HEAD))
        del self._buffer[:size]
        self._searched = 0
        raise TooLong(self.limit, head)


class Frames:
    """Splits a stream into frames that begin with their length, u32 big-endian.

    Args:
        limit: longest frame, bytes.

    Attributes:
        is_lost: whether a frame was too long. Nothing is taken any more, because the start of the next frame is not known.
        head: the first bytes of that frame, as far as they had come. If it is sent in small pieces, the id of the request is not among them.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.is_lost = False
        self.head = b""
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""
        if not self.is_lost:
            self._buffer += data

    def next_frame(self) -> bytes | memoryview | None:
        """Return the next frame without its length, or None until more bytes come. A large frame is a view of the received bytes.

        Raises:
            Refused: the frame is too long (`too_large`), and the connection must be ended.
        """
        if len(self._buffer) < 4:
            return None
        length = int.from_bytes(self._buffer[:4], "big")
        if length > self.limit:
            self.is_lost = True
            self.head = bytes(self._buffer[4 : 4 + _HEAD])
            self._buffer.clear()
            text = f"a frame holds at most {self.limit} bytes, this one claims {length}; it begins with its length as u32 big-endian"
            raise Refused("too_large", text)
        end = 4 + length
        if len(self._buffer) < end:
            return None
        if length < LARGE:
            frame = _copied(self._buffer, 4, end)
            del self._buffer[:end]
            return frame
        # The copied rest is short: at most one piece of input follows the end of the frame.
        whole, self._buffer = self._buffer, self._buffer[end:]
        return memoryview(whole)[4:end].toreadonly()


def _copied(buffer: bytearray, start: int, end: int) -> bytes:
    # A slice of the bytearray itself would be one more copy, and a slow one.
    with memoryview(buffer) as whole:
        return bytes(whole[start:end])


def line(body: bytes) -> bytes:
    """Return a body, which has no line end in it, as `Lines` reads it."""
    return body + b"\n"


def frame(body: bytes) -> bytes:
    """Return a body as `Frames` reads it."""
    return len(body).to_bytes(4, "big") + body


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
