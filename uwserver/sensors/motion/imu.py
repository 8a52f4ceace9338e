"""Inertial measurement unit: specific force and angular rate at the mount, in the sensor's frame."""

from __future__ import annotations

from uwserver.frames import conjugate, rotate
from uwserver.modifiers.base import Measurement, Memory
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.sensors.motion.triad import Triad, TriadErrors, TriadMemory


class ImuConfig(SensorTable, tag="imu", kw_only=True, frozen=True):
    """An IMU. Without the two tables it is exact; a `profile` fills them in.

    Attributes:
        ideal: exact, whatever else is given.
        gyroscope: errors of `w_S`, in rad/s.
        accelerometer: errors of `f_S`, in m/s2.
    """

    ideal: bool = False
    gyroscope: TriadErrors = TriadErrors()
    accelerometer: TriadErrors = TriadErrors()

    def build(self, mount: Pose) -> Imu:
        return Imu(mount, self)


class ImuMemory(Memory):
    """Attributes:
    gyroscope, accelerometer: their errors."""

    gyroscope: TriadMemory = TriadMemory()
    accelerometer: TriadMemory = TriadMemory()


class Imu(Sensor):
    """Specific force from the equations of motion, with lever arm and gravity."""

    doc = "Inertial measurement unit: specific force (gravity included) and angular rate in the sensor frame."
    needs_rates = True
    fields = (
        Field("f_S", "m/s^2", "specific force at the mount; (0, 0, -g) at rest and level", "S", (3,)),
        Field("w_S", "rad/s", "angular rate of the vehicle relative to N", "S", (3,)),
        Field("temperature", "degC", "temperature of the surrounding water"),
    )

    memory: ImuMemory

    def __init__(self, mount: Pose, config: ImuConfig) -> None:
        self._mount = mount
        self._to_S = conjugate(mount.q)
        self._gyroscope = Triad(TriadErrors() if config.ideal else config.gyroscope)
        self._accelerometer = Triad(TriadErrors() if config.ideal else config.accelerometer)
        self._draws = self._gyroscope.draws + self._accelerometer.draws
        super().__init__()

    def turn_on(self) -> ImuMemory:
        return ImuMemory(self._gyroscope.turn_on(self.rng), self._accelerometer.turn_on(self.rng))

    def sense(self, scope: Scope) -> Measurement:
        """Always valid."""
        m = self.memory
        f_S, w_S = scope.specific_force(self._mount), rotate(self._to_S, scope.w_NB_B)
        draws: list[float] = self.rng.standard_normal(self._draws).tolist() if self._draws else []
        if not self._gyroscope.exact:
            w_S, m.gyroscope = self._gyroscope.disturbed(w_S, m.gyroscope, self.dt, draws)
        if not self._accelerometer.exact:
            f_S, m.accelerometer = self._accelerometer.disturbed(
                f_S, m.accelerometer, self.dt, draws, self._gyroscope.draws
            )
        return Measurement([f_S, w_S, scope.water.temperature_at(scope.p_NB[2])], True)
