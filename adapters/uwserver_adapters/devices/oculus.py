"""Blueprint Subsea Oculus multibeam imaging sonars, as the maker's viewer and public drivers speak to them.

The messages are those of Oculus.h of the maker's viewer, as public drivers carry it. All numbers are little-endian.
"""

from __future__ import annotations

import ipaddress
import math
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, cast

import numpy as np
from msgspec import UNSET, Meta, Struct

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import rpy_from_quat
from uwserver.ports import Buffer, Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver.table import Name, Positive
from uwserver_adapters.devices.codec import NANOSECONDS, deg
from uwserver_adapters.devices.device import BinaryReader, DeviceInput, DeviceTable, Garbage, Reply, Report

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
MODELS: Mapping[str, tuple[int, float, float]] = {
    "M370s": (1041, 375e3, 375e3), "M750d": (1032, 750e3, 1.2e6), "M1200d": (1042, 1.2e6, 2.1e6), "M3000d": (2203, 1.2e6, 3.0e6),
}  # fmt: skip
"""The maker's part number, frequency of mode 1 and of mode 2, Hz (data sheets)."""
STATUS_NS = NANOSECONDS
"""Simulation time between two status messages, as the device sends them."""
MOST_ROWS = 8192
"""Most rows of a picture, with the blank ones before its first."""
CENTIDEGREES = 100.0 * deg(1.0)
"""Hundredths of a degree in a radian."""
NO_GAIN = np.uint32(1)
"""Gain of each row, for clients that ask for it. They divide by it, and the sensor's counts contain no such gain."""


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
        bearings: bearings of the beams, in 0.01 degrees, positive to starboard.
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


class OculusTable(DeviceTable, tag="oculus", kw_only=True, frozen=True):
    """Attributes:
    sonar: a sensor of kind `multibeam` that gives counts (`image` of uint8).
    model: the model that clients are told.
    attitude: attitude sensor, mounted as the sonar; its angles are sent with each ping of version 2.
    device_id: number of the device.
    gains_db: gain of the sensor for 0 and for 100 percent. The real gains are not published: these are guesses.
    sound_speed_mps: speed of sound that is sent where a client leaves it to the device; give the sensor's `assumed_sound_speed_mps`.
    """

    sonar: Name
    model: Literal["M370s", "M750d", "M1200d", "M3000d"] = "M750d"
    attitude: Name | None = None
    device_id: Annotated[int, Meta(ge=1, le=65535)] = 1
    gains_db: tuple[float, float] = (-20.0, 20.0)
    sound_speed_mps: Positive = 1500.0

    def build(self, context: AdapterContext) -> Oculus:
        """Return the device."""
        return Oculus(self, context)


class Oculus:
    """The device.

    Attributes:
        subscriptions: its ports.
        fire: the last fire message. It holds for all peers.
    """

    def __init__(self, table: OculusTable, context: AdapterContext) -> None:
        self._table, self._context = table, context
        self._source = DeviceInput("sonar", table.sonar, context.ports, ("image", "range", "azimuth"), ("range_start",))
        picture = next(field for field in context.ports[self._source.path].fields if field.name == "image")
        if picture.buffer is not UNSET and picture.buffer.dtype != "uint8":
            raise CannotServe(f'sonar: "{table.sonar}" gives {picture.buffer}: an Oculus needs output = "counts"')
        self._attitude = DeviceInput("attitude", table.attitude, context.ports, ("q_NS",)) if table.attitude else None
        self.subscriptions: Collection[str] = {self._source.path} | ({self._attitude.path} if self._attitude else set())
        service = context.services.get(f"{self._source.path}/set")
        self._arguments = {} if service is None else {argument.name: argument for argument in service.arguments}
        self._address = _ipv4(table.bind)
        self.fire = Fire()
        self._number = 0
        self._pinged_ns = self._told_ns = -1
        self._rpy_deg = (0.0, 0.0, 0.0)

    def reader(self) -> OculusReader:
        """Return a reader of messages."""
        return OculusReader()

    def reset(self) -> None:
        """Start again at another time; the last fire message stays."""
        self._pinged_ns = self._told_ns = -1

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: OculusMessage, reply: Reply) -> str:
        """Carry out a message of a client. The protocol has no answers: each ping result repeats the fire message that it obeys."""
        if message.number == DUMMY:
            return ""
        if message.number != SIMPLE_FIRE:
            return f"message 0x{message.number:02X} is not simulated"
        fire = fire_of(message)
        if fire is None:
            return f"a fire message has a payload of {len(message.payload)} bytes: 37 or 73 are known"
        if fault := _fault(fire):
            return fault
        before, self.fire = self.fire, fire
        asked = self._asked(fire)
        if asked == self._asked(before) or not asked:
            return ""
        try:
            self._context.call(f"{self._source.path}/set", asked, self._context.name, self._answered)
        except Refused as refused:
            self.fire = before
            return f"the sensor refuses it: {refused.fault.text}"
        return ""

    def _answered(self, answer: Answer | Progress) -> None:
        if isinstance(answer, Answer) and answer.fault is not None:
            self._context.stats.count_error(f"{self._table.sonar}: {answer.fault.text}")

    def _asked(self, fire: Fire) -> dict[str, object]:
        """Return the settings of the sensor for a fire message, limited to what the sensor takes: so does the real device."""
        asked: dict[str, object] = {}
        reach = self._arguments.get("range")
        if reach is not None:
            most = math.inf if reach.maximum is None else reach.maximum
            metres = fire.reach if fire.flags & IN_METRES or most == math.inf else 0.01 * fire.reach * most
            asked["range"] = min(most, max(metres, reach.minimum or 0.0))
        if "gain" in self._arguments:
            low, high = self._table.gains_db
            asked["gain"] = low + 0.01 * fire.gain * (high - low)
        mode, name = self._arguments.get("mode"), "low" if fire.mode == 1 else "high"
        if mode is not None and name in mode.choices:
            asked["mode"] = name
        if "sound_speed" in self._arguments and fire.sound_speed:
            asked["sound_speed"] = fire.sound_speed
        return asked

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[Report]:
        """Take a ping or an attitude. Returns the ping, unless it comes too early for the wanted rate, and once a second the status."""
        if self._attitude is not None and sample.port == self._attitude.path:
            if sample.valid:
                angles = rpy_from_quat(cast(tuple[float, float, float, float], self._attitude.values(sample)["q_NS"]))
                self._rpy_deg = (deg(angles[0]), deg(angles[1]), deg(angles[2]))
            return []
        said: list[Report] = []
        is_pinging = self.fire.ping_rate != STANDBY
        if self._told_ns < 0 or sample.t_ns - self._told_ns >= STATUS_NS:
            self._told_ns = sample.t_ns
            part = MODELS[self._table.model][0]
            said.append(Report(status(self._table.device_id, part, self._address, is_pinging), True))
            if not is_pinging:
                said.append(Report(encode(OculusMessage(DUMMY, source=self._table.device_id)), False))
        if is_pinging and self._is_due(sample.t_ns):
            said += self._ping(sample)
        return said

    def _is_due(self, t_ns: int) -> bool:
        # The sensor may ping at just the wanted rate: a ping that is a little early counts.
        period = 0.999 * NANOSECONDS / PING_HZ[self.fire.ping_rate]
        return self._pinged_ns < 0 or t_ns - self._pinged_ns >= period

    def _ping(self, sample: Sample) -> list[Report]:
        said = cast(dict[str, Any], self._source.values(sample))
        image, azimuth = said["image"], said["azimuth"]
        if not sample.valid or not isinstance(image, Buffer) or not isinstance(azimuth, Buffer):
            return []
        counts = image.array()
        rows, beams = counts.shape
        start = said.get("range_start") or 0.0
        row_m = (said["range"] - start) / max(1, rows)
        # The picture of a real device begins at the sonar, that of the sensor at `range_start`.
        blank = min(round(start / row_m), MOST_ROWS - rows) if row_m > 0.0 else 0
        if blank > 0:
            counts = np.concatenate([np.zeros((blank, beams), counts.dtype), counts])
        bearings = np.clip(np.rint(azimuth.array() * CENTIDEGREES), -0x8000, 0x7FFF).astype(int).tolist()
        self._pinged_ns, self._number = sample.t_ns, self._number + 1
        table, fire = self._table, self.fire
        frequency = MODELS[table.model][1 if fire.mode == 1 else 2]
        speed = fire.sound_speed or table.sound_speed_mps
        ping = Ping(self._number, frequency, speed, sample.t_ns, row_m, bearings, self._rpy_deg)
        return [Report(result(table.device_id, fire, ping, _packed(counts, fire.flags)), False)]


def _packed(counts: Any, flags: int) -> bytes:
    """Return counts (rows, beams) in the form of the client's flags: perhaps of 16 bits each, perhaps with a gain before each row."""
    if flags & WITH_16_BITS:
        counts = counts.astype("<u2") * np.uint16(257)
    if not flags & WITH_GAINS:
        return bytes(counts.tobytes())
    rows = counts.shape[0]
    gains = np.full((rows, 1), NO_GAIN, "<u4").view(np.uint8)
    return bytes(
        np.concatenate([gains, np.ascontiguousarray(counts).view(np.uint8).reshape(rows, -1)], axis=1).tobytes()
    )


def _fault(fire: Fire) -> str:
    """Return why a fire message cannot be obeyed, or ""."""
    checks = (
        (fire.mode in (1, 2), f"mode {fire.mode}: 1 or 2"),
        (fire.ping_rate in (*PING_HZ, STANDBY), f"ping rate {fire.ping_rate}: 0 to {STANDBY}"),
        (0.0 < fire.reach <= 1000.0, f"range {fire.reach}: more than 0, at most 1000"),
        (0.0 <= fire.gain <= 100.0, f"gain {fire.gain} percent: 0 to 100"),
        (
            fire.sound_speed == 0.0 or 1000.0 <= fire.sound_speed <= 2000.0,
            f"sound speed {fire.sound_speed}: 0, or 1000 to 2000 m/s",
        ),
        (0.0 <= fire.salinity <= 100.0, f"salinity {fire.salinity}: 0 to 100"),
    )
    return next((text for is_good, text in checks if not is_good), "")


def _ipv4(host: str) -> bytes:
    """Return the address to which clients are told to connect: loopback where the host is no IPv4 address, or stands for all."""
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:
        address = ipaddress.IPv4Address("127.0.0.1")
    return (ipaddress.IPv4Address("127.0.0.1") if address.is_unspecified else address).packed
