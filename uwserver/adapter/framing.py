"""Streams of bytes to lines or frames, and those to values, without a socket: a peer's fault is an exception with a text, never a crash.

`receive` only stores, ``next_...`` parses. Nothing is kept above the limit, and nothing is reserved for a length that was only claimed.
"""

from __future__ import annotations

import json
import re
from typing import Literal, NoReturn

import msgspec

from uwserver.adapter.bounds import Excess, weigh_json, weigh_msgpack
from uwserver.ports import ErrorCode, Refused

EncodingName = Literal["json", "msgpack"]

LARGE = 64 << 10
"""Length from which a frame is not copied, bytes: a copy into fresh memory takes 0.6 ms for a megabyte."""

_HEAD = 4 << 10
"""Bytes of a line that is too long which are kept to say whose it was."""

_JSON = msgspec.json.Decoder()
_MSGPACK = msgspec.msgpack.Decoder()

_PAIR = re.compile(rb"\\u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}")
_BLANKS = re.compile(rb"\s+")
_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


class Undecodable(Refused):
    """Bytes that are no value (`parse_error`), or one that is not taken (`invalid_request`, `too_large`); the text says why.

    Attributes:
        is_valid: it may be a value of this encoding, but nested too deep, say.
    """

    def __init__(self, code: ErrorCode, reason: str) -> None:
        super().__init__(code, reason)
        self.is_valid = code != "parse_error"


def decode(data: bytes | memoryview, encoding: EncodingName) -> object:
    """One value, and nothing after it; JSON comes as bytes. Neither stack nor memory nor time of any message is above the limits of `bounds`.

    Raises:
        Undecodable: see there.
    """
    try:
        if encoding == "msgpack":
            weigh_msgpack(data)
            value: object = _MSGPACK.decode(data)
            return value
        data = bytes(data)  # no copy of what is bytes already
        if weigh_json(data):
            value = _decoded_slowly(data)
        else:
            value = _JSON.decode(data)
    except Excess as excess:
        raise Undecodable(excess.code, str(excess)) from None
    except ValueError as error:  # msgspec's own errors are ValueErrors; others: no UTF-8
        raise Undecodable("parse_error", str(error)) from None
    return value


def _decoded_slowly(data: bytes) -> object:
    """JSON with many exponents and long numbers: msgspec takes up to 15 us for one of these, the standard library 0.5 us."""
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
    """A line is longer than is taken.

    Attributes:
        head: its first bytes.
    """

    def __init__(self, limit: int, head: bytes) -> None:
        super().__init__("too_large", f"a line holds at most {limit} bytes: the rest of it is skipped")
        self.head = head


class Lines:
    """Lines that end in LF or CRLF, without their ends and without blanks around them; blank lines count for nothing.

    Args:
        limit: longest line, bytes; the rest of a longer one is thrown away as it comes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._buffer = bytearray()
        self._searched = 0
        self._is_skipping = False

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        if self._is_skipping:
            end = data.find(b"\n")
            if end < 0:
                return
            self._is_skipping = False
            data = data[end + 1 :]
        self._buffer += data

    def next_line(self) -> bytes | None:
        """The next line; None until more bytes come.

        Raises:
            TooLong: told once a line; the next one can be had.
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
        """All blank lines at once: one by one, those of a single piece would take the time of hundreds of ticks."""
        blanks = _BLANKS.match(self._buffer)
        if blanks is not None:
            end = blanks.end()
            del blanks  # it holds the buffer
            del self._buffer[: self._buffer.rfind(b"\n", 0, end) + 1]

    def _too_long(self, size: int) -> None:
        head = _copied(self._buffer, 0, min(size, _HEAD))
        del self._buffer[:size]
        self._searched = 0
        raise TooLong(self.limit, head)


class Frames:
    """Frames that begin with their length, u32 big-endian.

    Args:
        limit: longest frame, bytes.

    Attributes:
        is_lost: a frame was too long: where the next one begins is not known, nothing is taken any more.
        head: the first bytes of that one, as far as they had come: whoever sends it in small pieces is told without the id.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.is_lost = False
        self.head = b""
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        if not self.is_lost:
            self._buffer += data

    def next_frame(self) -> bytes | memoryview | None:
        """The next frame without its length, a large one as a view of what was received; None until more bytes come.

        Raises:
            Refused: it is too long (`too_large`); the connection is to be ended.
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
        whole, self._buffer = (
            self._buffer,
            self._buffer[end:],
        )  # what comes behind it is no more than one piece that was received
        return memoryview(whole)[4:end].toreadonly()


def _copied(buffer: bytearray, start: int, end: int) -> bytes:
    with memoryview(buffer) as whole:  # a slice of it would be a copy more, and a slow one
        return bytes(whole[start:end])


def line(body: bytes) -> bytes:
    """A body as `Lines` reads it; it holds no line end."""
    return body + b"\n"


def frame(body: bytes) -> bytes:
    """A body as `Frames` reads it."""
    return len(body).to_bytes(4, "big") + body
