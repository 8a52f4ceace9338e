"""The file transfer protocol, as far as ground stations need it to read parameters. Files are read-only; everything else is refused at once."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping

from msgspec import Struct

from uwserver_adapters.mavlink.wire.channel import Outgoing
from uwserver_adapters.mavlink.wire.dialect import addressed_to

_HEAD = struct.Struct("<HBBBBBxI")
DATA = 239
"""Bytes of a file in one message."""
SIZE = 251
TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST, ACK, NAK = 1, 2, 3, 4, 5, 14, 15, 128, 129
INVALID_SESSION, NO_SESSIONS, END, UNKNOWN_COMMAND, NOT_FOUND = 4, 5, 6, 7, 10
SESSIONS = 64
"""Files that may be open at a time, of all clients."""
BURST_PARTS = 20
"""Messages of one burst: 4780 bytes. Then the peer requests the next."""


class Request(Struct, frozen=True):
    """The payload of FILE_TRANSFER_PROTOCOL.

    Attributes:
        seq: number of the request; its answer has the next.
        session: number of an open file.
        opcode: what to do.
        size: length of `data`, or how much is wanted.
        offset: bytes in a file, or entries in a listing.
        data: name or content.
    """

    seq: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes


def parse(payload: bytes) -> Request:
    """Return the request in a payload of any length. Missing bytes are zero."""
    seq, session, opcode, size, _, _, offset = _HEAD.unpack(payload[: _HEAD.size].ljust(_HEAD.size, b"\0"))
    return Request(seq, session, opcode, size, offset, payload[_HEAD.size :].ljust(DATA, b"\0")[: min(size, DATA)])


class Files:
    """Serves files.

    Args:
        sources: content by name, built each time that the file is opened. Called with the part of the name after its `?`.
    """

    def __init__(self, sources: Mapping[str, Callable[[str], bytes]]) -> None:
        self._sources = sources
        self._open: dict[tuple[int, int, int], bytes] = {}

    def answer(self, owner: tuple[int, int], request: Request) -> Iterator[bytes]:
        """Yield the payloads that answer a request: one, or several for a burst.

        Args:
            owner: system and component that asks; it owns its sessions.
            request: the request.
        """
        if request.opcode == OPEN:
            yield self._opened(owner, request)
        elif request.opcode in (READ, BURST):
            yield from self._read(owner, request)
        elif request.opcode == TERMINATE:
            self._open.pop((*owner, request.session), None)
            yield _reply(request, ACK)
        elif request.opcode == RESET:
            for key in [key for key in self._open if key[:2] == owner]:
                del self._open[key]
            yield _reply(request, ACK)
        elif request.opcode == CRC:
            content = self._content(request)
            if content is None:
                yield _refusal(request, NOT_FOUND)
            else:
                # The checksum of MAVLink FTP is CRC-32 without the inversions of zlib.
                crc = zlib.crc32(content, 0xFFFF_FFFF) ^ 0xFFFF_FFFF
                yield _reply(request, ACK, struct.pack("<I", crc))
        elif request.opcode == LIST:
            yield _refusal(request, END if request.offset else NOT_FOUND)
        else:
            yield _refusal(request, UNKNOWN_COMMAND)

    def _content(self, request: Request) -> bytes | None:
        name, _, options = request.data.split(b"\0", 1)[0].decode("latin-1").partition("?")
        source = self._sources.get(name)
        return None if source is None else source(options)

    def _opened(self, owner: tuple[int, int], request: Request) -> bytes:
        content = self._content(request)
        if content is None:
            return _refusal(request, NOT_FOUND)
        # The client chooses the number, as in ArduPilot. Some clients expect their own number, and others use the one in the answer.
        key = (*owner, request.session)
        if key not in self._open and len(self._open) >= SESSIONS:
            return _refusal(request, NO_SESSIONS)
        self._open[key] = content
        return _reply(request, ACK, struct.pack("<I", len(content)))

    def _read(self, owner: tuple[int, int], request: Request) -> Iterator[bytes]:
        content = self._open.get((*owner, request.session))
        if content is None:
            yield _refusal(request, INVALID_SESSION)
            return
        if request.offset >= len(content):
            yield _refusal(request, END)
            return
        size = min(request.size or DATA, DATA)
        if request.opcode == READ:
            yield _reply(request, ACK, content[request.offset : request.offset + size])
            return
        offset, seq = request.offset, request.seq
        for part in range(BURST_PARTS):
            data = content[offset : offset + size]
            is_last = part == BURST_PARTS - 1 or offset + len(data) >= len(content)
            answer = Request(seq, request.session, request.opcode, 0, offset, b"")
            yield _reply(answer, ACK, data, is_last)
            offset, seq = offset + len(data), seq + 1
            if is_last:
                return


def message(payload: bytes, peer: tuple[int, int]) -> Outgoing:
    """Return FILE_TRANSFER_PROTOCOL for a peer."""
    return "FILE_TRANSFER_PROTOCOL", {**addressed_to(peer), "payload": tuple(payload)}


def _reply(request: Request, opcode: int, data: bytes = b"", is_last: bool = False) -> bytes:
    seq = (request.seq + 1) & 0xFFFF
    return _HEAD.pack(seq, request.session, opcode, len(data), request.opcode, is_last, request.offset) + data


def _refusal(request: Request, reason: int) -> bytes:
    return _reply(request, NAK, bytes((reason,)))
