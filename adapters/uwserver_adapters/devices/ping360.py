"""Blue Robotics Ping360, as bluerobotics-ping and Ping Viewer speak to it (ping-protocol, messages of ping360)."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, cast

from msgspec import Struct
from msgspec.structs import astuple, replace

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.ports import Sample
from uwserver.table import Name, Positive
from uwserver_adapters.devices import ping_protocol as ping
from uwserver_adapters.devices.codec import rad
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, Reply, set_at_sensor

SET_DEVICE_ID, DEVICE_DATA, AUTO_DEVICE_DATA = 2000, 2300, 2301
RESET, TRANSDUCER, AUTO_TRANSMIT, MOTOR_OFF = 2600, 2601, 2602, 2903
DEVICE_TYPE, REVISION, FIRMWARE = 2, 1, (3, 3, 8)
"""The first firmware that scans by itself is 3.3, as remembered."""
STEPS = 400
"""Steps of a full turn; one is a gradian."""
SAMPLE_UNIT_S = 25e-9
"""Unit of `sample_period`, s."""
SLOWEST_STEP = 10
"""Most gradians from ping to ping of an automatic scan."""
_NARROW_RAD, _WIDE_STEP_RAD = 1e-3, 0.6
"""Width of a sector and step, rad, that keep the head of the sensor at one angle: only one step fits into the sector."""
_STATE = struct.Struct("<BBHHHHH")
_SCAN = struct.Struct("<BBHHHHHHBBH")


class Ping360Table(DeviceTable, tag="ping360", kw_only=True, frozen=True):
    """Attributes:
    sensor: the sonar (``rov/sonar``), of kind `scanning_sonar`.
    zero_deg: direction of the device's angle 0, from x of the sensor towards y.
    gains_db: gain of the sensor for the settings low, normal, high. The real gains are not published: these are guesses.
    sound_speed_mps: speed of sound that turns times of the device into ranges of the sensor; give the sensor's `assumed_sound_speed_mps`.
    """

    sensor: Name
    zero_deg: float = 0.0
    gains_db: tuple[float, float, float] = (-12.0, 0.0, 12.0)
    sound_speed_mps: Positive = 1500.0

    def build(self, context: AdapterContext) -> Ping360:
        """Return the device."""
        return Ping360(self, context)


class Settings(Struct, frozen=True):
    """Settings in the device's own units: gradians, us, 25 ns, kHz."""

    mode: int = 1
    gain_setting: int = 0
    angle: int = 0
    transmit_duration: int = 32
    sample_period: int = 80
    transmit_frequency: int = 740
    number_of_samples: int = 1200


class Scan(Struct, frozen=True):
    """An automatic scan: angles in gradians, delay in ms."""

    start_angle: int
    stop_angle: int
    num_steps: int
    delay: int


LIMITS: Mapping[str, tuple[int, int]] = {
    "gain_setting": (0, 2), "angle": (0, STEPS - 1), "transmit_duration": (1, 1000), "sample_period": (80, 40_000),
    "transmit_frequency": (500, 1000), "number_of_samples": (200, 1200),
    "start_angle": (0, STEPS - 1), "stop_angle": (0, STEPS - 1), "num_steps": (1, SLOWEST_STEP), "delay": (0, 100),
}  # fmt: skip
"""Least and most value of each setting, by the ping-protocol."""


def fault_of(table: Struct) -> str:
    """Return why these settings are not possible, or ""."""
    for name, (least, most) in LIMITS.items():
        value = getattr(table, name, least)
        if not least <= value <= most:
            return f"{name} is {least} to {most}, not {value}"
    return ""


def resample(bins: Sequence[int], bins_per_sample: float, count: int) -> bytes:
    """Return echo levels at another spacing: for each sample the largest of the bins that it covers, 0 beyond the last bin.

    Args:
        bins: levels, 0 to 255.
        bins_per_sample: width of a new sample, in bins.
        count: number of samples.
    """
    edges = [k * bins_per_sample for k in range(count + 1)]
    places = ((int(a), max(int(a) + 1, math.ceil(b))) for a, b in itertools.pairwise(edges))
    return bytes(max(bins[a:b], default=0) for a, b in places)


class _Awaited(NamedTuple):
    """A ping that a peer waits for."""

    settings: Settings
    reply: Reply


class Ping360(ping.PingDevice):
    """The device.

    Attributes:
        subscriptions: its port.
        settings: the present settings.
    """

    model, id_setting = "Ping360", SET_DEVICE_ID
    forms: ClassVar[Mapping[int, str]] = {
        SET_DEVICE_ID: "<BB", ping.SET_DEVICE_ID: "<B", ping.GENERAL_REQUEST: "<H", RESET: "<BB", MOTOR_OFF: "<",
        TRANSDUCER: "<BBHHHHHBB", AUTO_TRANSMIT: "<BBHHHHHHBB",
    }  # fmt: skip

    def __init__(self, table: Ping360Table, context: AdapterContext) -> None:
        super().__init__(2)
        self._table = table
        self._context = context
        self._source = DeviceInput("sensor", table.sensor, context.ports, ("head_angle", "range", "gain", "bins"))
        service = context.services.get(f"{self._source.path}/set")
        if service is None:
            raise CannotServe(f'sensor: "{table.sensor}" has no service "set": name a sensor of kind scanning_sonar')
        bins = next(field for field in context.ports[self._source.path].fields if field.name == "bins")
        if bins.type != "int":
            raise CannotServe(f'sensor: "{table.sensor}" gives pressures: a Ping360 needs output = "counts"')
        self._arguments = {argument.name: argument for argument in service.arguments}
        self.subscriptions: Collection[str] = (self._source.path,)
        self.settings = Settings()
        self._scan: Scan | None = None
        self._awaited: _Awaited | None = None
        self._data = b""
        self.values = {
            ping.DEVICE_INFORMATION: lambda: struct.pack("<BBBBBB", DEVICE_TYPE, REVISION, *FIRMWARE, 0),
            ping.PROTOCOL_VERSION: lambda: ping.VERSION,
            DEVICE_DATA: self._device_data,
            AUTO_DEVICE_DATA: self._auto_device_data,
        }

    def reset(self) -> None:
        """Start again at another time, with the sensor as its scenario has it. A peer that waits for a ping is told that none comes."""
        self._forget("the world began again")
        self._scan = None

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def obey(self, number: int, values: tuple[int, ...], reply: Reply) -> str | None:
        """Carry out a command."""
        if number == TRANSDUCER:
            return self._transmit(Settings(*values[:7]), bool(values[7]), reply)
        if number == AUTO_TRANSMIT:
            state = (*values[:2], self.settings.angle, *values[2:6])
            return self._auto_transmit(Settings(*state), Scan(*values[6:]), reply)
        if number == MOTOR_OFF:
            self._scan = None
            return ""
        if values[0]:
            return "this simulated Ping360 has no bootloader"
        self.reset()
        self.settings, self._data = Settings(), b""
        return ""

    def _begin(self, told: Settings, scan: Scan | None) -> None:
        self._forget("another command came before the ping was over")
        self.settings, self._scan = told, scan

    def _transmit(self, told: Settings, transmits: bool, reply: Reply) -> str | None:
        """Turn the head, and ping there if the client wants it; the ping is the answer."""
        if fault := fault_of(told):
            return fault
        self._begin(told, None)
        if not transmits:
            reply(ping.encode(ping.Frame(DEVICE_DATA, self._state() + struct.pack("<H", 0), self.device_id)))
            return None
        awaited = self._awaited = _Awaited(told, reply)

        def done(fault: str) -> None:
            if fault and self._awaited is awaited:
                self._forget(fault)

        self._set(self._radians(told.angle), _NARROW_RAD, _WIDE_STEP_RAD, done)
        return None

    def _auto_transmit(self, told: Settings, scan: Scan, reply: Reply) -> str | None:
        if fault := fault_of(told) or fault_of(scan):
            return fault
        self._begin(told, scan)
        between = (scan.stop_angle - scan.start_angle) % STEPS
        step, count = rad(0.9 * scan.num_steps), between // scan.num_steps + 1
        if between + scan.num_steps >= STEPS:
            middle, width = self._radians(scan.start_angle), 2.0 * math.pi
        else:
            middle = self._radians(scan.start_angle + 0.5 * (count - 1) * scan.num_steps)
            width = max(_NARROW_RAD, (count - 1) * step)

        def done(fault: str) -> None:
            if not fault:
                self.acknowledge(AUTO_TRANSMIT, reply)
                return
            if self._scan is scan:
                self._scan = None
            self.refuse(AUTO_TRANSMIT, fault, reply)

        self._set(middle, width, step, done)
        return None

    def _set(self, middle: float, width: float, step: float, done: Callable[[str], None]) -> None:
        """Set head, range and gain at the sensor. `done` gets the text of a fault, or ""."""
        reach, gain = self._at_sensor()
        arguments = {"range": reach, "gain": gain, "step": step, "sector_center": middle, "sector_width": width}
        set_at_sensor(self._context, self._source, arguments, done)

    def _at_sensor(self) -> tuple[float, float]:
        """Return range (m) and gain (dB) for the present settings, within what the sensor takes: the device itself listens for any time."""
        return (
            self._bounded("range", self._reach()),
            self._bounded("gain", self._table.gains_db[self.settings.gain_setting]),
        )

    def _bounded(self, name: str, value: float) -> float:
        argument = self._arguments.get(name)
        if argument is not None and argument.minimum is not None:
            value = max(value, argument.minimum)
        if argument is not None and argument.maximum is not None:
            value = min(value, argument.maximum)
        return value

    def _reach(self) -> float:
        """Return the range at the end of the last sample, m."""
        seconds = self.settings.number_of_samples * self.settings.sample_period * SAMPLE_UNIT_S
        return 0.5 * self._table.sound_speed_mps * seconds

    def _radians(self, angle: float) -> float:
        return math.remainder(rad(self._table.zero_deg + 0.9 * angle), 2.0 * math.pi)

    def _forget(self, reason: str) -> None:
        """Tell the peer that waits that its ping will not come."""
        awaited, self._awaited = self._awaited, None
        if awaited is not None:
            self.refuse(TRANSDUCER, reason, awaited.reply)

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a ping of the sensor. It answers the peer that waits for it, or belongs to the automatic scan; others are dropped."""
        said = cast(dict[str, Any], self._source.values(sample))
        if said["head_angle"] is None or not self._is_asked(said):
            return []
        angle = round((said["head_angle"] / rad(0.9)) - self._table.zero_deg / 0.9) % STEPS
        if self._awaited is None:
            if self._scan is None:
                return []
            self.settings = replace(self.settings, angle=angle)
            self._data = self._samples(sample, said)
            return [self.value(AUTO_DEVICE_DATA)]
        if angle == self.settings.angle:
            awaited, self._awaited = self._awaited, None
            self._data = self._samples(sample, said)
            awaited.reply(self.value(DEVICE_DATA))
        return []

    def _is_asked(self, said: Mapping[str, Any]) -> bool:
        """Return whether the ping was sent with the present settings: one that was under way when they came was not."""
        reach, gain = self._at_sensor()
        return bool(abs(said["range"] - reach) < 1e-6 * reach and abs(said["gain"] - gain) < 1e-6)

    def _samples(self, sample: Sample, said: Mapping[str, Any]) -> bytes:
        count = self.settings.number_of_samples
        bins = said["bins"]
        if not sample.valid or not bins:
            return bytes(count)
        return resample(bins, self._reach() / count / (said["range"] / len(bins)), count)

    def _state(self) -> bytes:
        return _STATE.pack(*astuple(self.settings))

    def _device_data(self) -> bytes:
        return self._state() + struct.pack("<H", len(self._data)) + self._data

    def _auto_device_data(self) -> bytes:
        scan = self._scan or Scan(0, STEPS - 1, 1, 0)
        *state, number_of_samples = astuple(self.settings)
        head = _SCAN.pack(*state, *astuple(scan), number_of_samples)
        return head + struct.pack("<H", len(self._data)) + self._data
