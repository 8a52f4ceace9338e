"""Blueprint Subsea Oculus multibeam imaging sonars, as the maker's viewer and public drivers speak to them."""

from __future__ import annotations

import ipaddress
import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal, cast

import numpy as np
from msgspec import UNSET, Meta

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import rpy_from_quat
from uwserver.ports import Buffer, Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver.table import Name, Positive
from uwserver_adapters.devices import oculus_messages as wire
from uwserver_adapters.devices.codec import NANOSECONDS, deg
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, Reply, Report
from uwserver_adapters.devices.oculus_messages import Fire, OculusMessage, OculusReader, Ping

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
        if message.number == wire.DUMMY:
            return ""
        if message.number != wire.SIMPLE_FIRE:
            return f"message 0x{message.number:02X} is not simulated"
        fire = wire.fire_of(message)
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
            metres = fire.reach if fire.flags & wire.IN_METRES or most == math.inf else 0.01 * fire.reach * most
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
        is_pinging = self.fire.ping_rate != wire.STANDBY
        if self._told_ns < 0 or sample.t_ns - self._told_ns >= STATUS_NS:
            self._told_ns = sample.t_ns
            part = MODELS[self._table.model][0]
            said.append(Report(wire.status(self._table.device_id, part, self._address, is_pinging), True))
            if not is_pinging:
                said.append(Report(wire.encode(OculusMessage(wire.DUMMY, source=self._table.device_id)), False))
        if is_pinging and self._is_due(sample.t_ns):
            said += self._ping(sample)
        return said

    def _is_due(self, t_ns: int) -> bool:
        # The sensor may ping at just the wanted rate: a ping that is a little early counts.
        period = 0.999 * NANOSECONDS / wire.PING_HZ[self.fire.ping_rate]
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
        return [Report(wire.result(table.device_id, fire, ping, _packed(counts, fire.flags)), False)]


def _packed(counts: Any, flags: int) -> bytes:
    """Return counts (rows, beams) in the form of the client's flags: perhaps of 16 bits each, perhaps with a gain before each row."""
    if flags & wire.WITH_16_BITS:
        counts = counts.astype("<u2") * np.uint16(257)
    if not flags & wire.WITH_GAINS:
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
        (fire.ping_rate in (*wire.PING_HZ, wire.STANDBY), f"ping rate {fire.ping_rate}: 0 to {wire.STANDBY}"),
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
