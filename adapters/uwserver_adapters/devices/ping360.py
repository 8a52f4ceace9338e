"""Blue Robotics Ping360, as bluerobotics-ping and Ping Viewer speak to it (ping-protocol, messages of ping360)."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from msgspec import Struct
from msgspec.structs import replace

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.ports import Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver.table import Name, Positive
from uwserver_adapters.devices import ping_protocol as ping
from uwserver_adapters.devices.codec import rad
from uwserver_adapters.devices.device import DeviceTable, Reply, Source
from uwserver_adapters.devices.ping_protocol import Frame, FrameReader, encode

SET_DEVICE_ID, DEVICE_DATA, AUTO_DEVICE_DATA = 2000, 2300, 2301
RESET, TRANSDUCER, AUTO_TRANSMIT, MOTOR_OFF = 2600, 2601, 2602, 2903
DEVICE_TYPE, REVISION, FIRMWARE = 2, 1, (3, 3, 8)
"""The first firmware that scans by itself is 3.3, as remembered."""
STEPS = 400
"""Of a full turn: one is a gradian."""
SAMPLE_UNIT_S = 25e-9
"""Of `sample_period`."""
SLOWEST_STEP = 10
"""Gradians from ping to ping of an automatic scan."""
_NARROW_RAD, _WIDE_STEP_RAD = 1e-3, 0.6
"""Sector and step that keep the head of the sensor where it is: one step alone fits."""
_STATE = struct.Struct("<BBHHHHH")
_SCAN = struct.Struct("<BBHHHHHHBBH")
_FORMS = {
    SET_DEVICE_ID: "<BB", ping.SET_DEVICE_ID: "<B", ping.GENERAL_REQUEST: "<H", RESET: "<BB", MOTOR_OFF: "<",
    TRANSDUCER: "<BBHHHHHBB", AUTO_TRANSMIT: "<BBHHHHHHBB",
}  # fmt: skip


class Ping360Table(DeviceTable, tag="ping360", kw_only=True, frozen=True):
    """Attributes:
    sensor: the sonar (``rov/sonar``), of kind `scanning_sonar`.
    zero_deg: where angle 0 of the device points, from x of the sensor towards y.
    gains_db: gain of the sensor for the settings low, normal, high. What the device adds is not published: these are guesses.
    sound_speed_mps: by which a time of the device is a range of the sensor: its `assumed_sound_speed_mps`.
    """

    sensor: Name
    zero_deg: float = 0.0
    gains_db: tuple[float, float, float] = (-12.0, 0.0, 12.0)
    sound_speed_mps: Positive = 1500.0

    def build(self, context: AdapterContext) -> Ping360:
        """The device."""
        return Ping360(self, context)


class Settings(Struct, frozen=True):
    """As the device holds them, in its units (gradians, us, 25 ns, kHz)."""

    mode: int = 1
    gain_setting: int = 0
    angle: int = 0
    transmit_duration: int = 32
    sample_period: int = 80
    transmit_frequency: int = 740
    number_of_samples: int = 1200


class Scan(Struct, frozen=True):
    """An automatic scan; angles in gradians, the delay in ms."""

    start_angle: int
    stop_angle: int
    num_steps: int
    delay: int


LIMITS: Mapping[str, tuple[int, int]] = {
    "gain_setting": (0, 2), "angle": (0, STEPS - 1), "transmit_duration": (1, 1000), "sample_period": (80, 40_000),
    "transmit_frequency": (500, 1000), "number_of_samples": (200, 1200),
    "start_angle": (0, STEPS - 1), "stop_angle": (0, STEPS - 1), "num_steps": (1, SLOWEST_STEP), "delay": (0, 100),
}  # fmt: skip
"""Least and most, of the ping-protocol."""


def fault_of(table: Struct) -> str:
    """Why these settings cannot be; "" where they can."""
    for name, (least, most) in LIMITS.items():
        value = getattr(table, name, least)
        if not least <= value <= most:
            return f"{name} is {least} to {most}, not {value}"
    return ""


def resample(bins: Sequence[int], bins_per_sample: float, count: int) -> bytes:
    """Echo levels at another spacing: the peak of what a sample covers; 0 beyond the last bin."""
    edges = [k * bins_per_sample for k in range(count + 1)]
    places = ((int(a), max(int(a) + 1, math.ceil(b))) for a, b in itertools.pairwise(edges))
    return bytes(max(bins[a:b], default=0) for a, b in places)


@dataclass(frozen=True)
class _Awaited:
    """The ping that a peer asked for."""

    settings: Settings
    reply: Reply


class Ping360:
    """The device.

    Attributes:
        wanted: its port.
        settings: as it is now.
    """

    def __init__(self, table: Ping360Table, context: AdapterContext) -> None:
        self._table = table
        self._context = context
        self._source = Source("sensor", table.sensor, context.ports, ("head_angle", "range", "gain", "bins"))
        self._service = f"{self._source.path}/set"
        if self._service not in context.services:
            raise CannotServe(f'sensor: "{table.sensor}" has no service "set": name a sensor of kind scanning_sonar')
        bins = next(field for field in context.ports[self._source.path].fields if field.name == "bins")
        if bins.type != "int":
            raise CannotServe(f'sensor: "{table.sensor}" gives pressures: a Ping360 needs output = "counts"')
        self.wanted: Collection[str] = (self._source.path,)
        self.settings = Settings()
        self._scan: Scan | None = None
        self._awaited: _Awaited | None = None
        self._data = b""
        self._id = 2
        self._gets: dict[int, Callable[[], bytes]] = {
            ping.DEVICE_INFORMATION: lambda: struct.pack("<BBBBBB", DEVICE_TYPE, REVISION, *FIRMWARE, 0),
            ping.PROTOCOL_VERSION: lambda: ping.VERSION,
            DEVICE_DATA: self._device_data,
            AUTO_DEVICE_DATA: self._auto_device_data,
        }

    def reader(self) -> FrameReader:
        """Frames."""
        return FrameReader()

    def reset(self) -> None:
        """The time of the world begins again, and the sensor is as its scenario has it; nothing is awaited any more."""
        self._forget("the world began again")
        self._scan = None

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: Frame, reply: Reply) -> str:
        """A request or a command; each is answered by the value, the ping, an acknowledgement or a refusal."""
        if message.destination not in (0, self._id, ping.BROADCAST):
            return ""  # for another device on the line
        number = message.message_id
        if not message.payload and number in self._gets:
            reply(self._said(number))
            return ""
        form = _FORMS.get(number)
        if form is None or len(message.payload) != struct.calcsize(form):
            return self._refuse(
                number, "this simulated Ping360 does not know the message, or not of this length", reply
            )
        values = struct.unpack(form, message.payload)
        if number == ping.GENERAL_REQUEST:
            if values[0] not in self._gets:
                return self._refuse(values[0], "this simulated Ping360 cannot say that", reply)
            reply(self._said(values[0]))
            return ""
        if number == TRANSDUCER:
            return self._take_transducer(Settings(*values[:7]), bool(values[7]), reply)
        if number == AUTO_TRANSMIT:
            state = (*values[:2], self.settings.angle, *values[2:6])
            return self._take_scan(Settings(*state), Scan(*values[6:]), reply)
        return self._take_common(number, values[0] if values else 0, reply)

    def _take_common(self, number: int, value: int, reply: Reply) -> str:
        if number == MOTOR_OFF:
            self._scan = None
        elif number == RESET:
            if value:
                return self._refuse(number, "this simulated Ping360 has no bootloader", reply)
            self.reset()
            self.settings, self._data = Settings(), b""
        elif not 1 <= value <= 254:
            return self._refuse(number, "the id is 1 to 254", reply)
        else:
            self._id = value
        reply(ping.acknowledgement(number, self._id))
        return ""

    def _take_transducer(self, told: Settings, transmits: bool, reply: Reply) -> str:
        fault = fault_of(told)
        if fault:
            return self._refuse(TRANSDUCER, fault, reply)
        self._forget("another command came before the ping was over")
        self.settings, self._scan = told, None
        if not transmits:
            reply(encode(Frame(DEVICE_DATA, self._state() + struct.pack("<H", 0), self._id)))
            return ""
        awaited = self._awaited = _Awaited(told, reply)

        def answered(fault: str) -> None:
            if fault and self._awaited is awaited:
                self._forget(fault)

        self._set(self._radians(told.angle), _NARROW_RAD, _WIDE_STEP_RAD, answered)
        return ""

    def _take_scan(self, told: Settings, scan: Scan, reply: Reply) -> str:
        fault = fault_of(told) or fault_of(scan)
        if fault:
            return self._refuse(AUTO_TRANSMIT, fault, reply)
        self._forget("another command came before the ping was over")
        self.settings, self._scan = told, scan
        between = (scan.stop_angle - scan.start_angle) % STEPS
        step, count = rad(0.9 * scan.num_steps), between // scan.num_steps + 1
        if between + scan.num_steps >= STEPS:
            middle, width = self._radians(scan.start_angle), 2.0 * math.pi
        else:
            middle = self._radians(scan.start_angle + 0.5 * (count - 1) * scan.num_steps)
            width = max(_NARROW_RAD, (count - 1) * step)

        def answered(fault: str) -> None:
            if not fault:
                reply(ping.acknowledgement(AUTO_TRANSMIT, self._id))
                return
            if self._scan is scan:
                self._scan = None
            self._refuse(AUTO_TRANSMIT, fault, reply)

        self._set(middle, width, step, answered)
        return ""

    def _set(self, middle: float, width: float, step: float, done: Callable[[str], None]) -> None:
        """Head, range and gain at the sensor, as the settings want them; `done` is told why not, or ""."""

        def answered(answer: Answer | Progress) -> None:
            if isinstance(answer, Answer):
                done("" if answer.fault is None else answer.fault.text)

        arguments = {
            "range": self._bounded("range", self._reach()),
            "gain": self._bounded("gain", self._table.gains_db[self.settings.gain_setting]),
            "step": step, "sector_center": middle, "sector_width": width,
        }  # fmt: skip
        try:
            self._context.call(self._service, arguments, self._context.name, answered)
        except Refused as error:
            done(error.fault.text)

    def _bounded(self, name: str, value: float) -> float:
        """Within what the sensor takes: the device itself listens for any time."""
        argument = next((a for a in self._context.services[self._service].arguments if a.name == name), None)
        if argument is not None and argument.minimum is not None:
            value = max(value, argument.minimum)
        if argument is not None and argument.maximum is not None:
            value = min(value, argument.maximum)
        return value

    def _reach(self) -> float:
        """Range at the end of the last sample, m."""
        seconds = self.settings.number_of_samples * self.settings.sample_period * SAMPLE_UNIT_S
        return 0.5 * self._table.sound_speed_mps * seconds

    def _radians(self, angle: float) -> float:
        return math.remainder(rad(self._table.zero_deg + 0.9 * angle), 2.0 * math.pi)

    def _forget(self, reason: str) -> None:
        """Tell the peer that waits that its ping does not come."""
        awaited, self._awaited = self._awaited, None
        if awaited is not None:
            awaited.reply(ping.refusal(TRANSDUCER, reason, self._id))

    def _refuse(self, message_id: int, reason: str, reply: Reply) -> str:
        reply(ping.refusal(message_id, reason, self._id))
        return f"message {message_id}: {reason}"

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """A ping of the sensor: the one that a peer waits for, or one of the automatic scan; others are nobody's."""
        said = cast(dict[str, Any], self._source.values(sample))
        if said["head_angle"] is None or not self._is_asked(said):
            return []
        angle = round((said["head_angle"] / rad(0.9)) - self._table.zero_deg / 0.9) % STEPS
        if self._awaited is None:
            if self._scan is None:
                return []
            self.settings = replace(self.settings, angle=angle)
            self._data = self._samples(sample, said)
            return [self._said(AUTO_DEVICE_DATA)]
        if angle == self.settings.angle:
            awaited, self._awaited = self._awaited, None
            self._data = self._samples(sample, said)
            awaited.reply(self._said(DEVICE_DATA))
        return []

    def _is_asked(self, said: Mapping[str, Any]) -> bool:
        """Whether the ping was sent with the settings of now: the one under way when they came was not."""
        reach = self._bounded("range", self._reach())
        gain = self._bounded("gain", self._table.gains_db[self.settings.gain_setting])
        return bool(abs(said["range"] - reach) < 1e-6 * reach and abs(said["gain"] - gain) < 1e-6)

    def _samples(self, sample: Sample, said: Mapping[str, Any]) -> bytes:
        count = self.settings.number_of_samples
        bins = said["bins"]
        if not sample.valid or not bins:
            return bytes(count)
        return resample(bins, self._reach() / count / (said["range"] / len(bins)), count)

    def _said(self, message_id: int) -> bytes:
        return encode(Frame(message_id, self._gets[message_id](), self._id))

    def _state(self) -> bytes:
        s = self.settings
        return _STATE.pack(
            s.mode, s.gain_setting, s.angle, s.transmit_duration, s.sample_period, s.transmit_frequency, s.number_of_samples
        )  # fmt: skip

    def _device_data(self) -> bytes:
        return self._state() + struct.pack("<H", len(self._data)) + self._data

    def _auto_device_data(self) -> bytes:
        s, scan = self.settings, self._scan or Scan(0, STEPS - 1, 1, 0)
        head = _SCAN.pack(
            s.mode, s.gain_setting, s.angle, s.transmit_duration, s.sample_period, s.transmit_frequency,
            scan.start_angle, scan.stop_angle, scan.num_steps, scan.delay, s.number_of_samples,
        )  # fmt: skip
        return head + struct.pack("<H", len(self._data)) + self._data
