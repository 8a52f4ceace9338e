"""TCPROS, both sides, without input or output: blocks that begin with their length (u32, little endian), and the header, whose fields do the same."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from uwserver.ports import Refused

HEADER_LIMIT = 1 << 16
"""Longest header, bytes."""
MESSAGE_LIMIT = 1 << 24
"""Longest message that is read, bytes."""
FIELDS = 64
"""Most fields of a header."""

_U32 = struct.Struct("<I")


class Blocks:
    """Bytes of one connection to blocks: `receive` stores, `next_block` parses. Nothing is reserved for a length that was only claimed.

    Attributes:
        limit: longest block, bytes; may be changed between two.
    """

    def __init__(self, limit: int = HEADER_LIMIT) -> None:
        self.limit = limit
        self._buffer = bytearray()

    @property
    def waiting(self) -> int:
        """Bytes that are stored."""
        return len(self._buffer)

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_block(self) -> bytes | None:
        """The next block without its length; None until more bytes come.

        Raises:
            Refused: it is too long (`too_large`); the connection is to be ended.
        """
        if len(self._buffer) < 4:
            return None
        (length,) = _U32.unpack_from(self._buffer)
        if length > self.limit:
            raise Refused("too_large", f"a block claims {length} bytes, at most {self.limit} are read")
        end = 4 + length
        if len(self._buffer) < end:
            return None
        block = bytes(memoryview(self._buffer)[4:end])
        del self._buffer[:end]
        return block


def block(body: bytes) -> bytes:
    """A body as `Blocks` reads it."""
    return _U32.pack(len(body)) + body


def header(fields: Mapping[str, str]) -> bytes:
    """A connection header with its length."""
    return block(b"".join(block(f"{key}={value}".encode()) for key, value in fields.items()))


def fields_of(body: bytes) -> dict[str, str]:
    """The fields of a header, without its length.

    Raises:
        Refused: it is none.
    """
    fields: dict[str, str] = {}
    at = 0
    while at < len(body):
        if len(body) - at < 4:
            raise Refused("parse_error", "a header ends within the length of a field")
        (length,) = _U32.unpack_from(body, at)
        at += 4
        if length > len(body) - at:
            raise Refused("parse_error", "a field is longer than its header")
        key, sign, value = body[at : at + length].partition(b"=")
        if not sign:
            raise Refused("parse_error", "a field of a header is key=value")
        fields[key.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        if len(fields) > FIELDS:
            raise Refused("too_large", f"a header has at most {FIELDS} fields")
        at += length
    return fields


def answer(ok: bool, body: bytes) -> bytes:
    """A service's answer: its response, or the text of what is wrong."""
    return (b"\x01" if ok else b"\x00") + block(body)
