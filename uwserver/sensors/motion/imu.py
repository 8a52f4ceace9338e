"""Inertial measurement unit: specific force and angular rate at the mount, in the sensor's frame."""

from __future__ import annotations

from typing import Any

from uwserver.environment.column import TEMPERATURE
from uwserver.modifiers.base import Memory
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable, Traits
from uwserver.sensors.compiled import (
    CompiledSensor,
    SensorKernel,
    inertial_rate,
    loop,
    p_NB,
    q_SB,
    record,
    rotate,
    specific_force,
    water_property,
)
from uwserver.sensors.motion.triad import (
    TRIAD,
    TRIAD_DRAWS,
    TRIAD_LANES,
    TRIAD_MEMORY,
    TriadErrors,
    TriadMemory,
    disturbed,
    fill_triad,
    turn_on,
)


class ImuConfig(SensorTable, tag="imu", kw_only=True, frozen=True):
    """An IMU. Without the two tables it is exact. A `profile` gives both.

    Attributes:
        ideal: exact, whatever the other keys say.
        gyroscope: errors of `w_S`, in rad/s.
        accelerometer: errors of `f_S`, in m/s2.
    """

    message = "Imu"
    ideal: bool = False
    gyroscope: TriadErrors = TriadErrors()
    accelerometer: TriadErrors = TriadErrors()

    def traits(self) -> Traits:
        """Declare its errors."""
        f, w = self.accelerometer.sigma(self.rate_hz), self.gyroscope.sigma(self.rate_hz)
        return Traits(sigmas={"f_S": f, "w_S": w})

    def build(self, mount: Pose) -> Imu:
        return Imu(mount, self)


class ImuMemory(Memory):
    """Attributes:
    gyroscope, accelerometer: the errors of the two triads."""

    gyroscope: TriadMemory = TriadMemory()
    accelerometer: TriadMemory = TriadMemory()


_RECORD = record(
    [("gyroscope", TRIAD), ("accelerometer", TRIAD)], [("gyroscope", TRIAD_MEMORY), ("accelerometer", TRIAD_MEMORY)]
)


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the specific force, from the equations of motion, and the angular rate. Both include the rotation of the Earth, if it turns."""
    f_S, w_S = specific_force(head, surroundings), rotate(q_SB(head), inertial_rate(head, surroundings))
    if head.exact == 0:
        w_S = disturbed(row.gyroscope, row.m.gyroscope, head, 0, w_S)
        f_S = disturbed(row.accelerometer, row.m.accelerometer, head, TRIAD_LANES, f_S)
    out[0], out[1], out[2] = f_S
    out[3], out[4], out[5] = w_S
    out[6] = water_property(surroundings, TEMPERATURE, p_NB(head, surroundings)[2])


class Imu(CompiledSensor):
    """An IMU, which is always valid."""

    doc = "Inertial measurement unit: specific force (gravity included) and angular rate in the sensor frame."
    needs_rates = True
    fields = (
        Field("f_S", "m/s^2", "specific force at the mount; (0, 0, -g) at rest and level", "S", (3,)),
        Field(
            "w_S",
            "rad/s",
            'angular rate of the vehicle against the stars; with [world] earth = "flat", against N',
            "S",
            (3,),
        ),
        Field("temperature", "degC", "temperature of the surrounding water"),
    )
    kernel = SensorKernel(_RECORD, loop(measure))
    random = (
        "gyroscope.white",
        "gyroscope.wander",
        "gyroscope.walk",
        "m.gyroscope.instability",
        "accelerometer.white",
        "accelerometer.wander",
        "accelerometer.walk",
        "m.accelerometer.instability",
    )
    memory_type = ImuMemory

    def __init__(self, mount: Pose, config: ImuConfig) -> None:
        self._config = config
        self.exact = config.ideal or config.gyroscope == config.accelerometer == TriadErrors()
        super().__init__(mount)

    def fill(self, row: Any) -> None:
        fill_triad(row["gyroscope"], self._config.gyroscope)
        fill_triad(row["accelerometer"], self._config.accelerometer)

    def turn_on_row(self, memory: Any) -> None:
        draws = self.drawn(2 * TRIAD_DRAWS)
        turn_on(memory["gyroscope"], self._config.gyroscope, draws[:TRIAD_DRAWS])
        turn_on(memory["accelerometer"], self._config.accelerometer, draws[TRIAD_DRAWS:])
