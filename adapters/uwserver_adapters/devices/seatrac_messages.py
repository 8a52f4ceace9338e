"""SeaTrac's serial protocol (Blueprint Subsea, SeaTrac Serial Interface, as public drivers have it), and its datagrams through a modem of the world.

A line is ``#`` (to the beacon) or ``$`` (from it), bytes as hexadecimal digits, CRC16, CR and LF. All numbers are little-endian.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, cast

from msgspec import Struct

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import Quat, Vec3, rotate, rpy_from_quat
from uwserver.ports import Buffer, Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver_adapters.devices.codec import FULL_TURN_DEG, deg
from uwserver_adapters.devices.device import DeviceInput, Garbage, Reply

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
LONGEST = 31
"""Most bytes of a datagram."""
EVERYBODY = 0
_CODES = {"busy": BUSY}
"""Status codes of faults; all other faults are FAIL."""


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
        travel_time: travel time of the sound there and back, s.
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


class Datagrams:
    """Sends and receives the datagrams of one beacon.

    Args:
        own: number of this beacon.
        modem: path of its modem, without ``/send`` and ``/received``.
        context: context of the adapter.

    Attributes:
        subscriptions: path of the port where the modem receives.

    Raises:
        CannotServe: there is no such modem.
    """

    def __init__(self, own: int, modem: str, context: AdapterContext) -> None:
        self._own, self._context = own, context
        fields = ("event", "source", "destination", "data", "range", "bearing", "elevation")
        self._heard = DeviceInput("modem", f"{modem}/received", context.ports, fields)
        self._port = f"{modem}/send"
        if self._port not in context.ports:
            raise CannotServe(f'modem: there is no port "{self._port}": name a modem, without /send')
        self.subscriptions: Collection[str] = (self._heard.path,)

    def send(self, payload: bytes, reply: Reply) -> str:
        """Carry out DAT_SEND: beacon, kind of message, length, data. The answer comes once the modem has taken or refused it."""
        destination = payload[0] if payload else 0

        def tell(code: int) -> None:
            reply(encode(SeaTracMessage(DAT_SEND, bytes((code, destination)))))

        reason, code = self._fault(payload)
        if code != OK:
            tell(code)
            return reason
        wants = payload[1] in (REQ, REQU, REQX)

        def answered(answer: Answer | Progress) -> None:
            if isinstance(answer, Answer):
                tell(_CODES.get(answer.fault.code, FAIL) if answer.fault else OK)

        value = {"destination": destination, "data": payload[3:], "acknowledge": float(wants)}
        try:
            self._context.command(self._port, value, self._context.name, answered)
        except Refused as refused:
            tell(FAIL)
            return f"the modem refuses it: {refused.fault.text}"
        return ""

    def _fault(self, payload: bytes) -> tuple[str, int]:
        """Return why a datagram cannot be sent, and the status code of that; "" and OK where it can."""
        if len(payload) < 3:
            return "a datagram: beacon, kind of message and length are needed", PARAM_MISSING
        destination, kind, length = payload[:3]
        wants_nothing = kind in (ONE_WAY, ONE_WAY_USBL)
        there = len(payload) - 3
        faults = (
            (
                length != there or length > LONGEST,
                f"a datagram of {length} bytes: {there} are there, at most {LONGEST}",
            ),
            (not length and wants_nothing, "a datagram without data that wants no answer"),
            (destination > 15 or destination == self._own, f"beacon {destination}: 0 to 15, and not its own"),
            (not wants_nothing and kind not in (REQ, REQU, REQX), f"message type {kind}"),
            (destination == EVERYBODY and not wants_nothing, "a message to all wants no answer"),
        )
        reason = next((text for is_wrong, text in faults if is_wrong), "")
        return reason, PARAM_INVALID if reason else OK

    def hear(self, sample: Sample, local: Local) -> list[bytes]:
        """Take a sample of the modem: a datagram came, was delivered, or got no answer. Returns its message for the peers."""
        if not sample.valid:
            return []
        said = cast(dict[str, Any], self._heard.values(sample))
        if said["event"] == "failed":
            return [encode(SeaTracMessage(DAT_ERROR, bytes((TIMED_OUT, said["destination"] & 0xFF))))]
        is_answer = said["event"] == "delivered"
        other = (said["destination"] if is_answer else said["source"]) & 0xFF
        data = said["data"].data[:LONGEST] if isinstance(said["data"], Buffer) and not is_answer else b""
        found, kind = self._found(said, local), ONE_WAY
        if is_answer:
            kind = (REQ if found.bearing is None else REQU) + 1
        elif found.bearing is not None:
            kind = ONE_WAY_USBL
        addressed = self._own if is_answer else said["destination"] & 0xFF
        record = fix(addressed, other, kind, local, found)
        return [encode(SeaTracMessage(DAT_RECEIVE, record + bytes((is_answer, len(data))) + data + b"\x01"))]

    def _found(self, said: dict[str, Any], local: Local) -> Found:
        reach, bearing, elevation = said["range"], said["bearing"], said["elevation"] or 0.0
        p_N = None
        if reach is not None and bearing is not None and local.q_NS is not None:
            flat = reach * math.cos(elevation)
            p_S = (flat * math.cos(bearing), flat * math.sin(bearing), reach * math.sin(elevation))
            p_N = rotate(local.q_NS, p_S)
        travel_time = 0.0 if reach is None else 2.0 * reach / local.sound_speed
        return Found(reach, travel_time, bearing, elevation, p_N)
