"""Streams of bytes to lines or frames, and those to values, without a socket: a peer's fault is an exception with a text, never a crash.

`receive` only stores, ``next_...`` parses. Nothing is kept above the limit, and nothing is reserved for a length that was only claimed.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from uwserver.adapter.nesting import json_fault, msgpack_fault
from uwserver.ports import Refused

EncodingName = Literal["json", "msgpack"]

_JSON = msgspec.json.Decoder()
_MSGPACK = msgspec.msgpack.Decoder()


class Undecodable(Refused):
    """Bytes that are no value (`parse_error`), or one that is not taken (`invalid_request`); the text says why.

    Attributes:
        is_valid: it is a value of this encoding, but nested too deep, say.
    """

    def __init__(self, reason: str, is_valid: bool) -> None:
        super().__init__("invalid_request" if is_valid else "parse_error", reason)
        self.is_valid = is_valid


def decode(data: bytes, encoding: EncodingName) -> object:
    """One value, and nothing after it. Neither depth nor claimed lengths can exhaust stack or memory.

    Raises:
        Undecodable: see there.
    """
    reason = json_fault(data) if encoding == "json" else msgpack_fault(data)
    if reason is not None:
        raise Undecodable(reason, is_valid=True)
    try:
        value: object = (_JSON if encoding == "json" else _MSGPACK).decode(data)
    except (
        ValueError
    ) as error:  # msgspec's own errors are ValueErrors; others: no UTF-8, or a number of thousands of digits
        raise Undecodable(str(error), is_valid=False) from None
    return value


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
            Refused: it is too long (`too_large`), told once a line; the next one can be had.
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
            line = bytes(self._buffer[:end]).strip()
            del self._buffer[: end + 1]
            self._searched = 0
            if line:
                return line

    def _too_long(self, size: int) -> None:
        del self._buffer[:size]
        self._searched = 0
        raise Refused("too_large", f"a line holds at most {self.limit} bytes: the rest of it is skipped")


class Frames:
    """Frames that begin with their length, u32 big-endian.

    Args:
        limit: longest frame, bytes.

    Attributes:
        is_lost: a frame was too long: where the next one begins is not known, nothing is taken any more.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.is_lost = False
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        if not self.is_lost:
            self._buffer += data

    def next_frame(self) -> bytes | None:
        """The next frame without its length; None until more bytes come.

        Raises:
            Refused: it is too long (`too_large`); the connection is to be ended.
        """
        if len(self._buffer) < 4:
            return None
        length = int.from_bytes(self._buffer[:4], "big")
        if length > self.limit:
            self.is_lost = True
            self._buffer.clear()
            text = f"a frame holds at most {self.limit} bytes, this one claims {length}; it begins with its length as u32 big-endian"
            raise Refused("too_large", text)
        if len(self._buffer) < 4 + length:
            return None
        frame = bytes(self._buffer[4 : 4 + length])
        del self._buffer[: 4 + length]
        return frame


def line(body: bytes) -> bytes:
    """A body as `Lines` reads it; it holds no line end."""
    return body + b"\n"


def frame(body: bytes) -> bytes:
    """A body as `Frames` reads it."""
    return len(body).to_bytes(4, "big") + body
