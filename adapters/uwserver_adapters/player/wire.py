"""Player's messages, both sides, without input or output: a header of 40 bytes and a body, in XDR (big-endian, in steps of four bytes).

Source: playerproject/player (`player.h`, `interfaces/*.def`, and the code that its generator makes), tried with its client library.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from uwserver.ports import Refused

BANNER = b"Player v.3.1.1-dev".ljust(32, b"\0")
"""The first bytes of a server. Clients check only their number."""
MESSAGE_LIMIT = 1 << 17
"""Longest body that is read, bytes. Player's own limit is 8 MiB."""
NAME_BYTES = 64
"""Longest name of a driver, with the zero at its end, bytes."""

DATA, CMD, REQ, ACK, SYNCH, NACK = range(1, 7)
"""Types of messages."""
PLAYER, GPS, POSITION3D, OPAQUE, IMU, RANGER = 1, 13, 30, 51, 60, 62
"""Interfaces."""
DEVLIST, DRIVERINFO, DEV, PULL_DATA, DATAMODE, ADD_REPLACE_RULE = 1, 2, 3, 4, 5, 10
"""Requests of the interface `PLAYER`."""
OPEN, CLOSE, ERROR = 1, 2, 3
"""Kinds of access to a device."""
PUSH, PULL = 1, 2
"""Modes of delivery."""

_HEADER = struct.Struct(">6IdII")
_U32 = struct.Struct(">I")


class PlayerMessage(NamedTuple):
    """A message: device (interface, and number in it), type and subtype, body, time (s), and number."""

    interface: int
    number: int
    type: int
    subtype: int
    body: bytes = b""
    timestamp: float = 0.0
    seq: int = 0
    host: int = 0
    robot: int = 0


def encode(message: PlayerMessage) -> bytes:
    """Return the bytes of a message."""
    address = (message.host, message.robot, message.interface, message.number)
    head = _HEADER.pack(*address, message.type, message.subtype, message.timestamp, message.seq, len(message.body))
    return head + message.body


class Decoder:
    """Turns the bytes of one client into messages: `receive` stores, `next_event` parses."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_event(self) -> PlayerMessage | None:
        """Return the next message; None until more bytes come.

        Raises:
            Refused: the bytes are no message of Player, or it is too long. The connection is to be ended.
        """
        if len(self._buffer) < _HEADER.size:
            return None
        host, robot, interface, index, kind, subtype, timestamp, seq, size = _HEADER.unpack_from(self._buffer)
        if not (DATA <= kind <= NACK and subtype < 256 and interface < 65536 and index < 65536):
            raise Refused("invalid_request", "this port speaks Player 3: a message begins with a header of 40 bytes")
        if size > MESSAGE_LIMIT:
            raise Refused("too_large", f"a message claims {size} bytes, at most {MESSAGE_LIMIT} are read")
        end = _HEADER.size + size
        if len(self._buffer) < end:
            return None
        body = bytes(memoryview(self._buffer)[_HEADER.size : end])
        del self._buffer[:end]
        return PlayerMessage(interface, index, kind, subtype, body, timestamp, seq, host, robot)


# -- bodies -------------------------------------------------------------------------------------------------------------------------------


def doubles(*numbers: float) -> bytes:
    """Return numbers of eight bytes."""
    return struct.pack(f">{len(numbers)}d", *numbers)


def floats(*numbers: float) -> bytes:
    """Return numbers of four bytes."""
    return struct.pack(f">{len(numbers)}f", *numbers)


def u32(*numbers: int) -> bytes:
    """Return whole numbers of four bytes; XDR has shorter ones in four bytes, too."""
    return struct.pack(f">{len(numbers)}I", *numbers)


def octets(data: bytes) -> bytes:
    """Return an array of bytes: their number twice, the bytes, and zeros up to the next step of four."""
    return u32(len(data), len(data)) + data + b"\0" * (-len(data) % 4)


def rows(numbers: Sequence[float]) -> bytes:
    """Return an array of numbers of eight bytes: how many there are, twice, and the numbers."""
    return u32(len(numbers), len(numbers)) + doubles(*numbers)


def read_u32(body: bytes, at: int = 0) -> int:
    """Return a whole number in a body.

    Raises:
        Refused: the body is too short.
    """
    (found,) = read(_U32, body, at)
    return int(found)


def read(form: struct.Struct, body: bytes, at: int = 0) -> tuple[float, ...]:
    """Return numbers in a body.

    Raises:
        Refused: the body is too short.
    """
    if len(body) < at + form.size:
        raise Refused("parse_error", f"a body of {len(body)} bytes is too short, {at + form.size} are needed")
    return form.unpack_from(body, at)


def read_octets(body: bytes) -> bytes:
    """Return the array of bytes that is the whole body.

    Raises:
        Refused: the body holds something else.
    """
    size, again = read_u32(body), read_u32(body, 4)
    if size != again or len(body) < 8 + size:
        raise Refused("parse_error", f"a body of {len(body)} bytes says that {size} are in it")
    return body[8 : 8 + size]
