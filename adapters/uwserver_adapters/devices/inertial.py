"""What an inertial unit of the market has in one case: IMU, attitude, magnetometer and satellite receiver, which are sensors of their own here."""

from __future__ import annotations

import math
from collections.abc import Collection
from datetime import datetime, timezone
from typing import Any, cast

from msgspec import Struct

from uwserver.adapter import AdapterContext
from uwserver.frames import rpy_from_quat
from uwserver.ports import Sample
from uwserver.table import Name
from uwserver_adapters.devices.codec import NANOSECONDS, instant
from uwserver_adapters.devices.device import DeviceTable, Source

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

GPS_ZERO = datetime(1980, 1, 6, tzinfo=timezone.utc)
LEAP_S = 18
"""Of GPS time before UTC, since 2017."""
WEEK_S = 604_800

_FIX = ("latitude", "longitude", "height", "v_NS", "satellites", "fix")
_ACCURACIES = ("horizontal_accuracy", "vertical_accuracy", "velocity_accuracy")


class InertialTable(DeviceTable, kw_only=True, frozen=True):
    """Attributes:
    imu: the sensor whose readings set the pace (``rov/imu``).
    attitude: of the case; mount it as the IMU.
    magnetometer: mount it as the IMU; without it the device tells a field of 0.
    gps: satellite receiver; without it the device tells that it has no fix.
    """

    imu: Name
    attitude: Name
    magnetometer: Name | None = None
    gps: Name | None = None


class Fix(Struct, frozen=True):
    """Of the satellite receiver.

    Attributes:
        kind: 0 none, 3 three-dimensional; without a fix all but `satellites` are 0.
        latitude, longitude: rad.
        height: m.
        v_N: m/s.
        horizontal_accuracy, vertical_accuracy: m, of each axis.
        velocity_accuracy: m/s, of each axis.
        t_ns: simulation time of the reading.
    """

    kind: int = 0
    satellites: int = 0
    latitude: float = 0.0
    longitude: float = 0.0
    height: float = 0.0
    v_N: Vector = (0.0, 0.0, 0.0)
    horizontal_accuracy: float = 0.0
    vertical_accuracy: float = 0.0
    velocity_accuracy: float = 0.0
    t_ns: int = 0


class Readings(Struct, frozen=True):
    """All that the device measures, the newest of each sensor when the IMU spoke.

    Attributes:
        t_ns: simulation time of the IMU's reading.
        epoch_ns: of simulation time 0, UTC.
        f_S: specific force, m/s^2; (0, 0, -g) at rest and level.
        w_S: angular rate, rad/s.
        field_S: magnetic flux density, T.
        temperature: degC.
        q_NS: attitude, w x y z.
        fix: of the satellite receiver.
    """

    t_ns: int
    epoch_ns: int
    f_S: Vector
    w_S: Vector
    field_S: Vector
    temperature: float
    q_NS: Quaternion
    fix: Fix

    @property
    def rpy(self) -> Vector:
        """Roll, pitch and yaw, rad; yaw within half a turn."""
        roll, pitch, yaw = rpy_from_quat(self.q_NS)
        return roll, pitch, math.remainder(yaw, 2.0 * math.pi)

    @property
    def utc(self) -> datetime:
        """Time of the world."""
        return instant(self.epoch_ns + self.t_ns)

    @property
    def gps_ns(self) -> int:
        """GPS time since 1980-01-06, within what 64 bits hold: 0 before, and no later than in 2564."""
        ns = self.epoch_ns + self.t_ns + (LEAP_S - int(GPS_ZERO.timestamp())) * NANOSECONDS
        return max(0, min(ns, 2**64 - 1))

    @property
    def gps_week(self) -> int:
        """Number of the week, from 0 on, all counted."""
        return self.gps_ns // (WEEK_S * NANOSECONDS)

    @property
    def gps_tow_ns(self) -> int:
        """Since the start of the week."""
        return self.gps_ns % (WEEK_S * NANOSECONDS)


class InertialSensors:
    """The sensors of the table together.

    Attributes:
        wanted: their ports.

    Raises:
        CannotServe: one is not there, or lacks a field.
    """

    def __init__(self, table: InertialTable, context: AdapterContext) -> None:
        self._context = context
        ports = context.ports
        self._imu = Source("imu", table.imu, ports, ("f_S", "w_S"), ("temperature",))
        self._attitude = Source("attitude", table.attitude, ports, ("q_NS",))
        self._field = Source("magnetometer", table.magnetometer, ports, ("field_S",)) if table.magnetometer else None
        self._gps = Source("gps", table.gps, ports, _FIX, _ACCURACIES) if table.gps else None
        sources = (self._imu, self._attitude, self._field, self._gps)
        self.wanted: Collection[str] = {source.path for source in sources if source is not None}
        self.rate_hz = self._imu.rate_hz
        self.reset()

    def reset(self) -> None:
        """The time of the world begins again: nothing is known."""
        self._q: Quaternion | None = None
        self._field_S: Vector = (0.0, 0.0, 0.0)
        self._fix = Fix()
        self.newest: Readings | None = None

    def see(self, sample: Sample) -> Readings | None:
        """A sample of one of them. Returns all readings when it is the IMU's, once there was an attitude."""
        if self._attitude.path == sample.port and sample.valid:
            self._q = cast(Quaternion, self._attitude.values(sample)["q_NS"])
        if self._field is not None and self._field.path == sample.port and sample.valid:
            self._field_S = cast(Vector, self._field.values(sample)["field_S"])
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


def _fix(said: Any, sample: Sample) -> Fix:
    if not sample.valid or not said["fix"]:
        return Fix(0, said["satellites"] or 0, t_ns=sample.t_ns)
    h, v, s = (said.get(name) or 0.0 for name in _ACCURACIES)
    return Fix(
        said["fix"], said["satellites"], said["latitude"], said["longitude"], said["height"], said["v_NS"], h, v, s, sample.t_ns
    )  # fmt: skip
