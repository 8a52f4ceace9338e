"""Blue Robotics Ping1D, as bluerobotics-ping and Ping Viewer speak to it (ping-protocol, messages of ping1d)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection
from typing import Any, cast

from msgspec import Struct
from msgspec.structs import replace

from uwserver.adapter import AdapterContext
from uwserver.ports import Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver.table import Name
from uwserver_adapters.devices import ping_protocol as ping
from uwserver_adapters.devices.codec import NANOSECONDS
from uwserver_adapters.devices.device import DeviceTable, Reply, Source
from uwserver_adapters.devices.ping_protocol import Frame, FrameReader, encode

MILLIMETRES = 1000.0
SET_DEVICE_ID, SET_RANGE, SET_SPEED_OF_SOUND, SET_MODE_AUTO = 1000, 1001, 1002, 1003
SET_PING_INTERVAL, SET_GAIN, SET_PING_ENABLE = 1004, 1005, 1006
FIRMWARE_VERSION, DEVICE_ID, VOLTAGE_5, SPEED_OF_SOUND, RANGE, MODE_AUTO, PING_INTERVAL, GAIN = range(1200, 1208)
TRANSMIT_DURATION, GENERAL_INFO, DISTANCE_SIMPLE, DISTANCE = 1208, 1210, 1211, 1212
PROCESSOR_TEMPERATURE, PCB_TEMPERATURE, PING_ENABLE, PROFILE = 1213, 1214, 1215, 1300
CONTINUOUS_START, CONTINUOUS_STOP = 1400, 1401
DEVICE_TYPE, REVISION, FIRMWARE = 1, 1, (3, 29)
POINTS = 200
"""Of a profile, as the device's firmware gives them."""
SLOWEST, FASTEST = 1_000_000, 2_000_000
"""mm/s."""
GAINS = 6
"""Of 0.6 to 144: what `gain_setting` counts."""
_DISTANCE = struct.Struct("<IHHIIII")
_FORMS = {
    SET_DEVICE_ID: "<B", SET_RANGE: "<II", SET_SPEED_OF_SOUND: "<I", SET_MODE_AUTO: "<B", SET_PING_INTERVAL: "<H", SET_GAIN: "<B",
    SET_PING_ENABLE: "<B", CONTINUOUS_START: "<H", CONTINUOUS_STOP: "<H", ping.GENERAL_REQUEST: "<H", ping.SET_DEVICE_ID: "<B",
}  # fmt: skip


class Ping1DTable(DeviceTable, tag="ping1d", kw_only=True, frozen=True):
    """Attributes:
    sensor: the echosounder (``rov/altimeter``), of kind `altimeter`.
    """

    sensor: Name

    def build(self, context: AdapterContext) -> Ping1D:
        """The device."""
        return Ping1D(self, context)


class Settings(Struct, frozen=True):
    """As the device holds them, in its units (mm, mm/s, ms)."""

    device_id: int = 1
    scan_start: int = 0
    scan_length: int = 30_000
    speed_of_sound: int = 1_500_000
    mode_auto: int = 1
    ping_interval: int = 100
    gain: int = 3
    ping_enabled: int = 1


class Ping1D:
    """The device.

    Attributes:
        wanted: its port.
        settings: as it is now.
    """

    def __init__(self, table: Ping1DTable, context: AdapterContext) -> None:
        self._context = context
        self._source = Source("sensor", table.sensor, context.ports, ("range", "confidence"))
        self.wanted: Collection[str] = (self._source.path,)
        self.settings = Settings(ping_interval=round(1000.0 / self._source.rate_hz))
        self._number = 0
        self._distance = 0
        self._confidence = 0
        self._continuous: set[int] = set()
        self._due_ns = 0
        self._gets: dict[int, Callable[[], bytes]] = {
            ping.DEVICE_INFORMATION: lambda: struct.pack("<BBBBBB", DEVICE_TYPE, REVISION, *FIRMWARE, 0, 0),
            ping.PROTOCOL_VERSION: lambda: ping.VERSION,
            FIRMWARE_VERSION: lambda: struct.pack("<BBHH", DEVICE_TYPE, REVISION, *FIRMWARE),
            DEVICE_ID: lambda: struct.pack("<B", self.settings.device_id),
            SPEED_OF_SOUND: lambda: struct.pack("<I", self.settings.speed_of_sound),
            RANGE: lambda: struct.pack("<II", self.settings.scan_start, self.settings.scan_length),
            MODE_AUTO: lambda: struct.pack("<B", self.settings.mode_auto),
            PING_INTERVAL: lambda: struct.pack("<H", self.settings.ping_interval),
            GAIN: lambda: struct.pack("<I", self.settings.gain),
            PING_ENABLE: lambda: struct.pack("<B", self.settings.ping_enabled),
            GENERAL_INFO: self._general_info,
            DISTANCE_SIMPLE: lambda: struct.pack("<IB", self._distance, self._confidence),
            DISTANCE: self._measured,
            PROFILE: self._profile,
        }
        self._sets: dict[int, Callable[[int, Reply], str]] = {
            SET_DEVICE_ID: self._set_device_id,
            ping.SET_DEVICE_ID: self._set_device_id,
            SET_SPEED_OF_SOUND: self._set_speed_of_sound,
            SET_MODE_AUTO: lambda value, _: self._keep("mode_auto", value, 1),
            SET_PING_INTERVAL: lambda value, _: self._keep("ping_interval", value, 0xFFFF),
            SET_GAIN: lambda value, _: self._keep("gain", value, GAINS),
            SET_PING_ENABLE: lambda value, _: self._keep("ping_enabled", value, 1),
            CONTINUOUS_START: self._start,
            CONTINUOUS_STOP: self._stop,
        }

    def reader(self) -> FrameReader:
        """Frames."""
        return FrameReader()

    def reset(self) -> None:
        """The time of the world begins again; settings stay."""
        self._due_ns = 0

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: Frame, reply: Reply) -> str:
        """A request or a setting; each is answered by the value, an acknowledgement or a refusal."""
        if message.destination not in (0, self.settings.device_id, ping.BROADCAST):
            return ""  # for another device on the line
        if not message.payload and message.message_id in self._gets:
            reply(self._said(message.message_id))
            return ""
        form = _FORMS.get(message.message_id)
        if form is None or len(message.payload) != struct.calcsize(form):
            return self._refuse(
                message.message_id, "this simulated Ping1D does not know the message, or not of this length", reply
            )
        values = struct.unpack(form, message.payload)
        if message.message_id == ping.GENERAL_REQUEST:
            if values[0] not in self._gets:
                return self._refuse(values[0], "this simulated Ping1D cannot say that", reply)
            reply(self._said(values[0]))
            return ""
        if message.message_id == SET_RANGE:
            self._set_range(values[0], values[1], reply)
            return ""
        reason = self._sets[message.message_id](values[0], reply)
        if reason:
            return self._refuse(message.message_id, reason, reply)
        if message.message_id != SET_SPEED_OF_SOUND:
            self._acknowledge(message.message_id, reply)
        return ""

    def _said(self, message_id: int) -> bytes:
        return encode(Frame(message_id, self._gets[message_id](), self.settings.device_id))

    def _acknowledge(self, message_id: int, reply: Reply) -> None:
        reply(ping.acknowledgement(message_id, self.settings.device_id))

    def _refuse(self, message_id: int, reason: str, reply: Reply) -> str:
        reply(ping.refusal(message_id, reason, self.settings.device_id))
        return f"message {message_id}: {reason}"

    def _keep(self, name: str, value: int, largest: int) -> str:
        if value > largest:
            return f"{name} is at most {largest}"
        self.settings = replace(self.settings, **{name: value})
        return ""

    def _set_device_id(self, value: int, _: Reply) -> str:
        return "the id is 1 to 254" if value == 0 else self._keep("device_id", value, 254)

    def _start(self, value: int, _: Reply) -> str:
        if value not in (PROFILE, DISTANCE, DISTANCE_SIMPLE):
            return f"message {value} is not sent continuously: use {PROFILE}, {DISTANCE} or {DISTANCE_SIMPLE}"
        self._continuous.add(value)
        return ""

    def _stop(self, value: int, _: Reply) -> str:
        self._continuous.discard(value)
        return ""

    def _set_speed_of_sound(self, value: int, reply: Reply) -> str:
        # At the sensor 0 stands for the truth; release 0.2 of the maker's library sends it for any speed, by a mistake of its own.
        if not SLOWEST <= value <= FASTEST:
            return f"the speed of sound is {SLOWEST} to {FASTEST} mm/s"
        told = replace(self.settings, speed_of_sound=value)
        self._call({"sound_speed": value / MILLIMETRES}, SET_SPEED_OF_SOUND, told, reply)
        return ""

    def _set_range(self, start: int, length: int, reply: Reply) -> None:
        told = replace(self.settings, scan_start=start, scan_length=length, mode_auto=0)
        self._call({"range": (start + length) / MILLIMETRES}, SET_RANGE, told, reply)

    def _call(self, arguments: dict[str, object], message_id: int, told: Settings, reply: Reply) -> None:
        """Set it at the sensor. Clients read back at once, so it is told from now on, until the sensor refuses it."""
        before = self.settings

        def answered(answer: Answer | Progress) -> None:
            if not isinstance(answer, Answer):
                return
            if answer.fault is None:
                self._acknowledge(message_id, reply)
                return
            if self.settings is told:
                self.settings = before
            self._refuse(message_id, answer.fault.text, reply)

        try:
            self._context.call(f"{self._source.path}/set", arguments, self._context.name, answered)
        except Refused as refused:
            self._refuse(message_id, refused.fault.text, reply)
            return
        self.settings = told

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """A ping; without an echo the last distance stays, at no confidence, as the device has it."""
        if not self.settings.ping_enabled or sample.t_ns < self._due_ns:
            return []
        self._due_ns = sample.t_ns + round((self.settings.ping_interval - 1) * NANOSECONDS / 1000)
        said = cast(dict[str, Any], self._source.values(sample))
        self._number = (self._number + 1) & 0xFFFFFFFF
        self._confidence = 0
        if sample.valid:
            self._distance = min(0xFFFFFFFF, max(0, round(said["range"] * MILLIMETRES)))
            self._confidence = min(100, max(0, round(100.0 * said["confidence"])))
        return [self._said(message_id) for message_id in sorted(self._continuous)]

    def _general_info(self) -> bytes:
        settings = self.settings
        return struct.pack("<HHHHBB", *FIRMWARE, 5000, settings.ping_interval, settings.gain, settings.mode_auto)

    def _measured(self) -> bytes:
        settings = self.settings
        return _DISTANCE.pack(
            self._distance, self._confidence, 0, self._number, settings.scan_start, settings.scan_length, settings.gain
        )  # fmt: skip

    def _profile(self) -> bytes:
        """The sensor gives one echo and how far it stands out: that is the one peak of the profile, three points wide."""
        settings, points = self.settings, bytearray(POINTS)
        if settings.scan_length and self._confidence:
            peak = (self._distance - settings.scan_start) * POINTS // settings.scan_length
            for place, part in ((peak - 1, 0.5), (peak, 1.0), (peak + 1, 0.5)):
                if 0 <= place < POINTS:
                    points[place] = round(255 * part * self._confidence / 100)
        return self._measured() + struct.pack("<H", POINTS) + bytes(points)
