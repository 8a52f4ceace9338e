"""Inertial measurement unit: specific force and angular rate at the mount, in the sensor's frame."""

from __future__ import annotations

from uwserver.frames import conjugate, rotate
from uwserver.ports import Field, Value
from uwserver.sensors.base import Pose, Scope, SensorTable


class ImuConfig(SensorTable, tag="imu", kw_only=True, frozen=True):
    """An IMU without errors of its own: add them as modifiers of `f_S` and `w_S`."""

    def build(self, mount: Pose) -> Imu:
        """The ideal sensor."""
        return Imu(mount)


class Imu:
    """Specific force from the equations of motion, with lever arm and gravity."""

    doc = "Inertial measurement unit: specific force (gravity included) and angular rate in the sensor frame."
    needs_rates = True
    fields = (
        Field("f_S", "m/s^2", "specific force at the mount; (0, 0, -g) at rest and level", "S", (3,)),
        Field("w_S", "rad/s", "angular rate of the vehicle relative to N", "S", (3,)),
        Field("temperature", "degC", "temperature of the surrounding water"),
    )

    def __init__(self, mount: Pose) -> None:
        self._mount = mount

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        w_S = rotate(conjugate(self._mount.q), scope.w_NB_B)
        return True, [scope.specific_force(self._mount), w_S, scope.water.temperature_at(scope.p_NB[2])]
