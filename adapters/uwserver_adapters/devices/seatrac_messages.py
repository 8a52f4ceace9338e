"""SeaTrac's serial protocol (Blueprint Subsea, SeaTrac Serial Interface, as public drivers have it).

A line is ``#`` (to the beacon) or ``$`` (from it), bytes as hexadecimal digits, CRC16, CR and LF. All numbers are little-endian.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from msgspec import Struct

from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver_adapters.devices.codec import FULL_TURN_DEG, deg
from uwserver_adapters.devices.device import Garbage

LINE_LIMIT = 1024
"""Longest line of a peer, bytes. The settings of a beacon take some 400."""
SYS_ALIVE, SYS_INFO, SYS_REBOOT = 0x01, 0x02, 0x03
STATUS, STATUS_CFG_GET, STATUS_CFG_SET = 0x10, 0x11, 0x12
XCVR_STATUS, PING_SEND, PING_RESP, PING_ERROR = 0x3A, 0x40, 0x42, 0x43
NAV_QUERY_SEND, NAV_QUERY_RESP, NAV_ERROR = 0x50, 0x52, 0x53
DAT_SEND, DAT_RECEIVE, DAT_ERROR = 0x60, 0x61, 0x63
OK, FAIL, PARAM_MISSING, PARAM_INVALID = 0x00, 0x01, 0x04, 0x05
BUSY, TIMED_OUT, IDLE, REQUESTING = 0x30, 0x34, 0x3B, 0x3D
ENVIRONMENT, ATTITUDE = 0x01, 0x02
"""Bits of the content of a status message."""
ONE_WAY, ONE_WAY_USBL, REQ, REQU, REQX = 0, 1, 2, 4, 6
"""Kinds of messages. The first two want no answer. The others request a range, also a direction, and also the other beacon's depth; the kind
of the answer is the next number."""
RANGE_VALID, USBL_VALID, POSITION_VALID, POSITION_ENHANCED = 0x01, 0x02, 0x04, 0x08
QUERY_DEPTH, QUERY_SUPPLY, QUERY_TEMPERATURE, QUERY_ATTITUDE = 0x01, 0x02, 0x04, 0x08
STATUS_HZ = (0.0, 1.0, 2.5, 5.0, 10.0, 25.0)
"""Rate of status messages, by the number of the mode."""
TIMER_HZ = 16_000
CHANNELS = 4
"""Hydrophones of an X150."""
DECI, TENTH_US = 10.0, 1e7


@dataclass(frozen=True)
class SeaTracMessage:
    """A command to the beacon, or one of its messages."""

    number: int
    payload: bytes = b""


def _step(value: int) -> int:
    for _ in range(8):
        value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


_CRC_OF_BYTE = [_step(value) for value in range(256)]


def crc16(data: bytes) -> int:
    """Return the CRC-16/ARC."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _CRC_OF_BYTE[(crc ^ byte) & 0xFF]
    return crc


def encode(message: SeaTracMessage, mark: bytes = b"$") -> bytes:
    """Return the line of a message; `mark` is ``#`` for a command."""
    body = bytes((message.number,)) + message.payload
    return mark + (body + crc16(body).to_bytes(2, "little")).hex().upper().encode() + b"\r\n"


def decode(line: bytes) -> SeaTracMessage | Garbage:
    """Parse the line of a command, without its end."""
    if not line.startswith(b"#"):
        return Garbage("a line is no command of the SeaTrac protocol: those begin with #")
    try:
        body = bytes.fromhex(line[1:].decode("ascii"))
    except ValueError:
        return Garbage("a command of the SeaTrac protocol holds what is no pair of hexadecimal digits")
    if len(body) < 3:
        return Garbage("a command of the SeaTrac protocol is too short")
    if crc16(body[:-2]) != int.from_bytes(body[-2:], "little"):
        return Garbage("the checksum of a command of the SeaTrac protocol is wrong")
    return SeaTracMessage(body[0], body[1:-2])


# -- values ---------------------------------------------------------------------------------------------------------------------------


def i16(value: float) -> int:
    """Return the nearest signed whole number of 16 bits."""
    return min(0x7FFF, max(-0x8000, round(value)))


def i32(value: float) -> int:
    """Return the nearest signed whole number of 32 bits."""
    return min(0x7FFFFFFF, max(-0x80000000, round(value)))


def u16(value: float) -> int:
    """Return the nearest unsigned whole number of 16 bits."""
    return min(0xFFFF, max(0, round(value)))


class Local(Struct, frozen=True):
    """Readings of a beacon's own sensors.

    Attributes:
        q_NS: attitude, w x y z; None without a sensor, or before its first sample.
        depth: m; None likewise.
        temperature: degC.
        pressure: Pa.
        sound_speed: speed of sound that the beacon uses, m/s.
    """

    q_NS: Quat | None = None
    depth: float | None = None
    temperature: float = 0.0
    pressure: float = 0.0
    sound_speed: float = 1500.0

    def attitude(self) -> bytes:
        """Return yaw, pitch and roll, in tenths of a degree."""
        roll, pitch, yaw = (0.0, 0.0, 0.0) if self.q_NS is None else rpy_from_quat(self.q_NS)
        return struct.pack(
            "<3h", *(i16(DECI * deg(angle)) for angle in (math.remainder(yaw, 2 * math.pi), pitch, roll))
        )

    def environment(self) -> bytes:
        """Return supply voltage (0, as nothing measures it), temperature, pressure, depth and sound speed."""
        depth = i32(DECI * (self.depth or 0.0))
        return struct.pack(
            "<HhiiH", 0, i16(DECI * self.temperature), i32(self.pressure / 100.0), depth, u16(DECI * self.sound_speed)
        )  # fmt: skip


class Found(Struct, frozen=True):
    """Position of another beacon; None for values that are not known.

    Attributes:
        reach: range, m.
        travel_time: of the sound there and back, s.
        bearing, elevation: rad; the elevation is positive downwards, towards z.
        p_N: position relative to this beacon, m; known where the attitude is.
        depth: depth that the other beacon tells, m.
    """

    reach: float | None = None
    travel_time: float = 0.0
    bearing: float | None = None
    elevation: float = 0.0
    p_N: Vec3 | None = None
    depth: float | None = None


def fix(own: int, other: int, kind: int, local: Local, found: Found) -> bytes:
    """Return ACOFIX, the record of a fix.

    Signal strengths and the error of the fit are 0, as nothing measures them.

    Args:
        own: number of the destination.
        other: number of the source.
        kind: kind of the message.
        local: readings of this beacon's own sensors.
        found: position of the other beacon.
    """
    flags, body = 0, b""
    if found.reach is not None:
        flags |= RANGE_VALID
        count, one_way = i32(TIMER_HZ * found.travel_time), i32(0.5 * TENTH_US * found.travel_time)
        body += struct.pack("<IiH", max(0, count), one_way, u16(DECI * found.reach))
    if found.bearing is not None:
        flags |= USBL_VALID
        azimuth, upwards = deg(found.bearing) % FULL_TURN_DEG, -deg(found.elevation)
        body += struct.pack("<B4hhhh", CHANNELS, 0, 0, 0, 0, i16(DECI * azimuth), i16(DECI * upwards), 0)
    if found.p_N is not None:
        north, east, down = found.p_N
        flags |= POSITION_VALID | (POSITION_ENHANCED if found.depth is not None else 0)
        depth = (local.depth or 0.0) + down if found.depth is None else found.depth
        body += struct.pack("<3h", i16(DECI * east), i16(DECI * north), i16(DECI * depth))
    head = struct.pack("<BBBB", own, other, flags, kind) + local.attitude()
    head += struct.pack("<HHh", u16(DECI * (local.depth or 0.0)), u16(DECI * local.sound_speed), 0)
    return head + body
