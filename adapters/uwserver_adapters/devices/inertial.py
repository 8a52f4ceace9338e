"""An inertial unit of the market has IMU, attitude, magnetometer and satellite receiver in one case. Here each is a sensor of its own."""

from __future__ import annotations

import math
from collections.abc import Collection
from datetime import datetime, timezone
from typing import Any, cast

from msgspec import Struct

from uwserver.adapter import AdapterContext
from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.ports import Sample
from uwserver.table import Name
from uwserver_adapters.devices.codec import NANOSECONDS, instant
from uwserver_adapters.devices.device import DeviceInput, DeviceTable

GPS_ZERO = datetime(1980, 1, 6, tzinfo=timezone.utc)
LEAP_S = 18
"""Seconds by which GPS time is ahead of UTC, since 2017."""
WEEK_S = 604_800

_FIX = ("latitude", "longitude", "height", "v_NS", "satellites", "fix")
_ACCURACIES = ("horizontal_accuracy", "vertical_accuracy", "velocity_accuracy")


class InertialTable(DeviceTable, kw_only=True, frozen=True):
    """Attributes:
    imu: the IMU (``rov/imu``). The device sends its messages with the readings of this sensor.
    attitude: attitude sensor, mounted as the IMU.
    magnetometer: mounted as the IMU; without it the device tells a field of 0.
    gps: satellite receiver; without it the device tells that it has no fix.
    """

    imu: Name
    attitude: Name
    magnetometer: Name | None = None
    gps: Name | None = None


class Fix(Struct, frozen=True):
    """A fix of the satellite receiver.

    Attributes:
        kind: 0 for no fix, 3 for a three-dimensional one; without a fix all but `satellites` are 0.
        satellites: number of satellites.
        latitude, longitude: rad.
        height: m.
        v_N: velocity, m/s.
        horizontal_accuracy, vertical_accuracy: m, of each axis.
        velocity_accuracy: m/s, of each axis.
        t_ns: simulation time of the reading.
    """

    kind: int = 0
    satellites: int = 0
    latitude: float = 0.0
    longitude: float = 0.0
    height: float = 0.0
    v_N: Vec3 = (0.0, 0.0, 0.0)
    horizontal_accuracy: float = 0.0
    vertical_accuracy: float = 0.0
    velocity_accuracy: float = 0.0
    t_ns: int = 0


class Readings(Struct, frozen=True):
    """All readings of the device: one of the IMU, and the newest one of each other sensor at that time.

    Attributes:
        t_ns: simulation time of the IMU's reading.
        epoch_ns: UTC of simulation time 0, ns since 1970.
        f_S: specific force, m/s^2; (0, 0, -g) at rest and level.
        w_S: angular rate, rad/s.
        field_S: magnetic flux density, T.
        temperature: degC.
        q_NS: attitude, w x y z.
        fix: fix of the satellite receiver.
    """

    t_ns: int
    epoch_ns: int
    f_S: Vec3
    w_S: Vec3
    field_S: Vec3
    temperature: float
    q_NS: Quat
    fix: Fix

    @property
    def rpy(self) -> Vec3:
        """Roll, pitch and yaw, rad; yaw is within half a turn."""
        roll, pitch, yaw = rpy_from_quat(self.q_NS)
        return roll, pitch, math.remainder(yaw, 2.0 * math.pi)

    @property
    def utc(self) -> datetime:
        """UTC of the IMU's reading."""
        return instant(self.epoch_ns + self.t_ns)

    @property
    def gps_ns(self) -> int:
        """GPS time, ns since 1980-01-06, limited to what 64 bits hold: 0 before 1980, and no later than in 2564."""
        ns = self.epoch_ns + self.t_ns + (LEAP_S - int(GPS_ZERO.timestamp())) * NANOSECONDS
        return max(0, min(ns, 2**64 - 1))

    @property
    def gps_week(self) -> int:
        """Number of the GPS week, from 0 on, without rollover."""
        return self.gps_ns // (WEEK_S * NANOSECONDS)

    @property
    def gps_tow_ns(self) -> int:
        """GPS time since the start of the week, ns."""
        return self.gps_ns % (WEEK_S * NANOSECONDS)


class InertialDevice:
    """An inertial unit: the sensors of its table, and messages with rates of their own.

    Attributes:
        subscriptions: ports of the sensors.
        newest: the newest readings; None before the first.

    Raises:
        CannotServe: a sensor is not there, or lacks a field.
    """

    def __init__(self, table: InertialTable, context: AdapterContext) -> None:
        self._context = context
        ports = context.ports
        self._imu = DeviceInput("imu", table.imu, ports, ("f_S", "w_S"), ("temperature",))
        self._attitude = DeviceInput("attitude", table.attitude, ports, ("q_NS",))
        self._field = (
            DeviceInput("magnetometer", table.magnetometer, ports, ("field_S",)) if table.magnetometer else None
        )
        self._gps = DeviceInput("gps", table.gps, ports, _FIX, _ACCURACIES) if table.gps else None
        sources = (self._imu, self._attitude, self._field, self._gps)
        self.subscriptions: Collection[str] = {source.path for source in sources if source is not None}
        self._periods: dict[int, int] = {}
        self.reset()

    def reset(self) -> None:
        """Start again at another time: nothing is known. Settings stay."""
        self._q: Quat | None = None
        self._field_S: Vec3 = (0.0, 0.0, 0.0)
        self._fix = Fix()
        self.newest: Readings | None = None
        self._periods.clear()

    def measure(self, sample: Sample) -> Readings | None:
        """Take a sample of one of the sensors. Returns all readings when it is the IMU's, once there was an attitude."""
        if self._attitude.path == sample.port and sample.valid:
            self._q = cast(Quat, self._attitude.values(sample)["q_NS"])
        if self._field is not None and self._field.path == sample.port and sample.valid:
            self._field_S = cast(Vec3, self._field.values(sample)["field_S"])
        if self._gps is not None and self._gps.path == sample.port:
            self._fix = _fix(self._gps.values(sample), sample)
        if self._imu.path != sample.port or not sample.valid or self._q is None:
            return None
        said = cast(dict[str, Any], self._imu.values(sample))
        self.newest = Readings(
            sample.t_ns, self._context.world.epoch_ns, said["f_S"], said["w_S"], self._field_S,
            said.get("temperature") or 0.0, self._q, self._fix,
        )  # fmt: skip
        return self.newest

    def is_due(self, message: int, period: int) -> bool:
        """Return whether a message is due: once in each period, so that its rate is right with an IMU of any higher rate.

        Args:
            message: number of the message.
            period: number of the present period, counted from simulation time 0.
        """
        before, self._periods[message] = self._periods.get(message, -1), period
        return period != before


def _fix(said: Any, sample: Sample) -> Fix:
    if not sample.valid or not said["fix"]:
        return Fix(0, said["satellites"] or 0, t_ns=sample.t_ns)
    h, v, s = (said.get(name) or 0.0 for name in _ACCURACIES)
    return Fix(
        said["fix"], said["satellites"], said["latitude"], said["longitude"], said["height"], said["v_NS"], h, v, s, sample.t_ns
    )  # fmt: skip
