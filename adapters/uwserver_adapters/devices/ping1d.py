"""Blue Robotics Ping1D, as bluerobotics-ping and Ping Viewer speak to it (ping-protocol, messages of ping1d)."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, cast

from msgspec import Struct
from msgspec.structs import replace

from uwserver.adapter import AdapterContext
from uwserver.ports import Sample
from uwserver.table import Name
from uwserver_adapters.devices import ping_protocol as ping
from uwserver_adapters.devices.codec import NANOSECONDS
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, Reply, set_at_sensor

MILLIMETRES = 1000.0
SET_DEVICE_ID, SET_RANGE, SET_SPEED_OF_SOUND, SET_MODE_AUTO = 1000, 1001, 1002, 1003
SET_PING_INTERVAL, SET_GAIN, SET_PING_ENABLE = 1004, 1005, 1006
FIRMWARE_VERSION, DEVICE_ID, VOLTAGE_5, SPEED_OF_SOUND, RANGE, MODE_AUTO, PING_INTERVAL, GAIN = range(1200, 1208)
TRANSMIT_DURATION, GENERAL_INFO, DISTANCE_SIMPLE, DISTANCE = 1208, 1210, 1211, 1212
PROCESSOR_TEMPERATURE, PCB_TEMPERATURE, PING_ENABLE, PROFILE = 1213, 1214, 1215, 1300
CONTINUOUS_START, CONTINUOUS_STOP = 1400, 1401
DEVICE_TYPE, REVISION, FIRMWARE = 1, 1, (3, 29)
POINTS = 200
"""Points of a profile, as the device's firmware gives them."""
SLOWEST, FASTEST = 1_000_000, 2_000_000
"""Limits of the speed of sound, mm/s."""
GAINS = 6
"""Largest `gain_setting`; the settings stand for gains from 0.6 to 144."""
_DISTANCE = struct.Struct("<IHHIIII")
_KEPT = {
    SET_MODE_AUTO: ("mode_auto", 1), SET_PING_INTERVAL: ("ping_interval", 0xFFFF), SET_GAIN: ("gain", GAINS),
    SET_PING_ENABLE: ("ping_enabled", 1),
}  # fmt: skip
"""Settings that are only kept: the field of `Settings`, and its largest value."""


class Ping1DTable(DeviceTable, tag="ping1d", kw_only=True, frozen=True):
    """Attributes:
    sensor: the echosounder (``rov/altimeter``), of kind `altimeter`.
    """

    sensor: Name

    def build(self, context: AdapterContext) -> Ping1D:
        """Return the device."""
        return Ping1D(self, context)


class Settings(Struct, frozen=True):
    """Settings in the device's own units: mm, mm/s, ms."""

    scan_start: int = 0
    scan_length: int = 30_000
    speed_of_sound: int = 1_500_000
    mode_auto: int = 1
    ping_interval: int = 100
    gain: int = 3
    ping_enabled: int = 1


class Ping1D(ping.PingDevice):
    """The device.

    Attributes:
        subscriptions: its port.
        settings: the present settings.
    """

    model, id_setting = "Ping1D", SET_DEVICE_ID
    forms: ClassVar[Mapping[int, str]] = {
        SET_DEVICE_ID: "<B", SET_RANGE: "<II", SET_SPEED_OF_SOUND: "<I", SET_MODE_AUTO: "<B", SET_PING_INTERVAL: "<H", SET_GAIN: "<B",
        SET_PING_ENABLE: "<B", CONTINUOUS_START: "<H", CONTINUOUS_STOP: "<H", ping.GENERAL_REQUEST: "<H", ping.SET_DEVICE_ID: "<B",
    }  # fmt: skip

    def __init__(self, table: Ping1DTable, context: AdapterContext) -> None:
        super().__init__(1)
        self._context = context
        self._source = DeviceInput("sensor", table.sensor, context.ports, ("range", "confidence"))
        self.subscriptions: Collection[str] = (self._source.path,)
        self.settings = Settings(ping_interval=round(1000.0 / self._source.rate_hz))
        self._number = self._distance = self._confidence = 0
        self._continuous: set[int] = set()
        self._due_ns = 0
        self.values = {
            ping.DEVICE_INFORMATION: lambda: struct.pack("<BBBBBB", DEVICE_TYPE, REVISION, *FIRMWARE, 0, 0),
            ping.PROTOCOL_VERSION: lambda: ping.VERSION,
            FIRMWARE_VERSION: lambda: struct.pack("<BBHH", DEVICE_TYPE, REVISION, *FIRMWARE),
            DEVICE_ID: lambda: struct.pack("<B", self.device_id),
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

    def reset(self) -> None:
        """Start again at another time; settings stay."""
        self._due_ns = 0

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def obey(self, number: int, values: tuple[int, ...], reply: Reply) -> str | None:
        """Carry out a setting."""
        value = values[0]
        if number == SET_RANGE:
            told = replace(self.settings, scan_start=value, scan_length=values[1], mode_auto=0)
            self._set({"range": sum(values) / MILLIMETRES}, number, told, reply)
            return None
        if number == SET_SPEED_OF_SOUND:
            # At the sensor 0 stands for the true speed. Release 0.2 of the maker's library sends 0 for any speed, which is a bug of it.
            if not SLOWEST <= value <= FASTEST:
                return f"the speed of sound is {SLOWEST} to {FASTEST} mm/s"
            told = replace(self.settings, speed_of_sound=value)
            self._set({"sound_speed": value / MILLIMETRES}, number, told, reply)
            return None
        if number == CONTINUOUS_START:
            if value not in (PROFILE, DISTANCE, DISTANCE_SIMPLE):
                return f"message {value} is not sent continuously: use {PROFILE}, {DISTANCE} or {DISTANCE_SIMPLE}"
            self._continuous.add(value)
        elif number == CONTINUOUS_STOP:
            self._continuous.discard(value)
        else:
            name, largest = _KEPT[number]
            if value > largest:
                return f"{name} is at most {largest}"
            self.settings = replace(self.settings, **{name: value})
        return ""

    def _set(self, arguments: dict[str, object], number: int, told: Settings, reply: Reply) -> None:
        """Set something at the sensor. Clients read back at once, so the device tells the new settings until the sensor refuses them."""
        before, self.settings = self.settings, told

        def done(fault: str) -> None:
            if not fault:
                self.acknowledge(number, reply)
                return
            if self.settings is told:
                self.settings = before
            self.refuse(number, fault, reply)

        set_at_sensor(self._context, self._source, arguments, done)

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a ping. Without an echo the device keeps the last distance, with a confidence of 0, as the real one does."""
        if not self.settings.ping_enabled or sample.t_ns < self._due_ns:
            return []
        self._due_ns = sample.t_ns + round((self.settings.ping_interval - 1) * NANOSECONDS / 1000)
        said = cast(dict[str, Any], self._source.values(sample))
        self._number = (self._number + 1) & 0xFFFFFFFF
        self._confidence = 0
        if sample.valid:
            self._distance = min(0xFFFFFFFF, max(0, round(said["range"] * MILLIMETRES)))
            self._confidence = min(100, max(0, round(100.0 * said["confidence"])))
        return [self.value(message_id) for message_id in sorted(self._continuous)]

    def _general_info(self) -> bytes:
        settings = self.settings
        return struct.pack("<HHHHBB", *FIRMWARE, 5000, settings.ping_interval, settings.gain, settings.mode_auto)

    def _measured(self) -> bytes:
        settings = self.settings
        return _DISTANCE.pack(
            self._distance, self._confidence, 0, self._number, settings.scan_start, settings.scan_length, settings.gain
        )  # fmt: skip

    def _profile(self) -> bytes:
        """Make a profile with one peak, three points wide: the sensor gives one echo, and how far it stands out."""
        settings, points = self.settings, bytearray(POINTS)
        if settings.scan_length and self._confidence:
            peak = (self._distance - settings.scan_start) * POINTS // settings.scan_length
            for place, part in ((peak - 1, 0.5), (peak, 1.0), (peak + 1, 0.5)):
                if 0 <= place < POINTS:
                    points[place] = round(255 * part * self._confidence / 100)
        return self._measured() + struct.pack("<H", POINTS) + bytes(points)
