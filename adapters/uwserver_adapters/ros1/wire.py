"""TCPROS, both sides, without sockets: blocks that begin with their length (u32, little endian), and headers, whose fields do too."""

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
    """Splits the bytes of one connection into blocks: `receive` stores, `next_block` parses.

    Memory grows with the bytes that came, not with the length that a block claims.

    Attributes:
        limit: longest block, bytes; may be changed between two blocks.
    """

    def __init__(self, limit: int = HEADER_LIMIT) -> None:
        self.limit = limit
        self._buffer = bytearray()

    @property
    def waiting(self) -> int:
        """Number of stored bytes."""
        return len(self._buffer)

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_block(self) -> bytes | None:
        """Return the next block without its length; None until more bytes come.

        Raises:
            Refused: the block is too long (`too_large`). The connection must be ended.
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
    """Return a body with its length in front."""
    return _U32.pack(len(body)) + body


def header(fields: Mapping[str, str]) -> bytes:
    """Return a connection header with its length."""
    return block(b"".join(block(f"{key}={value}".encode()) for key, value in fields.items()))


def fields_of(body: bytes) -> dict[str, str]:
    """Return the fields of a header, which is given without its length.

    Raises:
        Refused: it is no header, or has too many fields.
    """
    fields: dict[str, str] = {}
    at = count = 0
    while at < len(body):
        count += 1
        if count > FIELDS:
            raise Refused("too_large", f"a header has at most {FIELDS} fields")
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
        at += length
    return fields


def answer(ok: bool, body: bytes) -> bytes:
    """Return the answer of a service: the bytes of its response, or if not `ok` the text of the fault."""
    return (b"\x01" if ok else b"\x00") + block(body)
