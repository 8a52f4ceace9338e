"""Messages of Blueprint Subsea's Oculus sonars (Oculus.h of the maker's viewer, as public drivers carry it). All numbers are little-endian."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import Struct

from uwserver_adapters.devices.device import BinaryReader, Garbage

HEAD = struct.Struct("<HHHHHIH")
CHECK = 0x4F53
MARK = CHECK.to_bytes(2, "little")
PAYLOAD_LIMIT = 4096
"""Longest payload of a command, bytes. That of a fire message has 73."""
SIMPLE_FIRE, SIMPLE_PING_RESULT, DUMMY = 0x15, 0x23, 0xFF
IN_METRES, WITH_16_BITS, WITH_GAINS = 0x01, 0x02, 0x04
"""Bits of `Fire.flags`. The device sends all other bits back as they came."""
STANDBY = 5
PING_HZ = {0: 10.0, 1: 15.0, 2: 40.0, 3: 5.0, 4: 2.0}
"""Number of a ping rate -> pings in a second, at most."""
PICTURE_OFFSET = 2048
"""Offset of the picture in a ping result, bytes, as in a recorded result of an M1200d."""
_FIRE = struct.Struct("<5B4d")
_EXTENDED = struct.Struct("<9I")
_STATUS = struct.Struct("<IHHI6I4s4s4s6s9d")


@dataclass(frozen=True)
class OculusMessage:
    """Any message; its payload is not parsed."""

    number: int
    payload: bytes = b""
    version: int = 0
    source: int = 0
    destination: int = 0


class Fire(Struct, frozen=True):
    """A fire message of a client (`OculusSimpleFireMessage`): the wanted settings of the sonar.

    Attributes:
        mode: 1 for the low frequency, 2 for the high one.
        ping_rate: a key of `PING_HZ`, or `STANDBY`.
        network_speed, gamma, salinity: sent back unchanged.
        flags: bits.
        reach: range, m or percent.
        gain: percent.
        sound_speed: m/s; 0 leaves it to the device.
        extended: nine more words that version 2 has; empty in version 1.
        version: in the head of the message.
    """

    mode: int = 1
    ping_rate: int = 0
    network_speed: int = 0xFF
    gamma: int = 127
    flags: int = IN_METRES | 0x08
    reach: float = 10.0
    gain: float = 50.0
    sound_speed: float = 0.0
    salinity: float = 0.0
    extended: tuple[int, ...] = ()
    version: int = 0

    def payload(self) -> bytes:
        """Return the payload of the message."""
        data = _FIRE.pack(
            self.mode, self.ping_rate, self.network_speed, self.gamma, self.flags, self.reach, self.gain, self.sound_speed, self.salinity
        )  # fmt: skip
        return data + (_EXTENDED.pack(*self.extended) if self.extended else b"")


class Ping(Struct, frozen=True):
    """The values of a ping result besides the picture.

    Attributes:
        number: counts the pings.
        frequency: Hz.
        sound_speed: m/s.
        t_ns: simulation time at which the ping was sent.
        row_m: range of one row.
        bearings: of the beams, in 0.01 degrees, positive to starboard.
        rpy_deg: roll, pitch and yaw of the device, degrees.
    """

    number: int
    frequency: float
    sound_speed: float
    t_ns: int
    row_m: float
    bearings: Sequence[int]
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


def encode(message: OculusMessage) -> bytes:
    """Return the bytes of a message."""
    head = HEAD.pack(
        CHECK, message.source, message.destination, message.number, message.version, len(message.payload), 0
    )
    return head + message.payload


def fire_of(message: OculusMessage) -> Fire | None:
    """Return what a fire message asks; None where its length is none of the two known ones."""
    extended: tuple[int, ...] = ()
    if len(message.payload) == _FIRE.size + _EXTENDED.size:
        extended = _EXTENDED.unpack_from(message.payload, _FIRE.size)
    elif len(message.payload) != _FIRE.size:
        return None
    values = (*_FIRE.unpack_from(message.payload), extended, message.version)
    return Fire(*values)


def result(device: int, fire: Fire, ping: Ping, picture: bytes) -> bytes:
    """Return an `OculusSimplePingResult`, in the version of the client's fire message.

    Args:
        device: number of the sonar.
        fire: what the client asked.
        ping: the ping.
        picture: rows of beams, the nearest row first, of 8 or 16 bits an item; with gains there are four more bytes before each row.
    """
    rows_bytes = len(ping.bearings) * (2 if fire.flags & WITH_16_BITS else 1) + (4 if fire.flags & WITH_GAINS else 0)
    rows = len(picture) // max(1, rows_bytes)
    data_size = 1 if fire.flags & WITH_16_BITS else 0
    body = fire.payload() + struct.pack("<II3d", ping.number & 0xFFFFFFFF, 0, ping.frequency, 0.0, 0.0)
    if fire.extended:
        roll, pitch, heading = ping.rpy_deg
        body += struct.pack("<5d", heading, pitch, roll, ping.sound_speed, ping.t_ns / 1e9)
    else:
        body += struct.pack("<dI", ping.sound_speed, ping.t_ns // 1000 & 0xFFFFFFFF)
    body += struct.pack("<BdHH", data_size, ping.row_m, rows, len(ping.bearings)) + bytes(16 if fire.extended else 0)
    fixed = HEAD.size + len(body) + 12 + 2 * len(ping.bearings)
    offset = max(PICTURE_OFFSET, fixed)
    body += struct.pack("<III", offset, len(picture), offset + len(picture))
    body += struct.pack(f"<{len(ping.bearings)}h", *ping.bearings) + bytes(offset - fixed) + picture
    return encode(OculusMessage(SIMPLE_PING_RESULT, body, fire.version, device))


def status(device: int, part: int, address: bytes, is_pinging: bool) -> bytes:
    """Return an `OculusStatusMsg`, by which clients find the sonar.

    Args:
        device: number of the sonar.
        part: the maker's number of the model.
        address: IPv4, four bytes.
        is_pinging: the sonar is not in standby.
    """
    main_runs, paused = 3, 0 if is_pinging else 1 << 14
    none = bytes(4)
    body = _STATUS.pack(
        device, 1, part, main_runs | paused, *(0,) * 6, address, b"\xff\xff\xff\0", none, b"\x02\0\0" + device.to_bytes(3, "big"), *(0.0,) * 9
    )  # fmt: skip
    return encode(OculusMessage(0, body, 0, device))


class OculusReader(BinaryReader[OculusMessage]):
    """Splits a stream into messages."""

    mark, noun = MARK, "message of the Oculus protocol"

    def parse(self, buffer: bytearray) -> tuple[int, OculusMessage | Garbage | None]:
        """Read the message at the start of the buffer."""
        if len(buffer) < HEAD.size:
            return 0, None
        _, source, destination, number, version, size, _ = HEAD.unpack_from(buffer)
        if size > PAYLOAD_LIMIT:
            return 1, Garbage(f"a message claims {size} bytes, at most {PAYLOAD_LIMIT} are read")
        end = HEAD.size + size
        if len(buffer) < end:
            return 0, None
        return end, OculusMessage(number, bytes(buffer[HEAD.size : end]), version, source, destination)
