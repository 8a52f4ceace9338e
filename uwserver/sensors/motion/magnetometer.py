"""Magnetometer: the Earth's field of the World Magnetic Model, and what the vehicle's own iron and currents make of it."""

from __future__ import annotations

from typing import ClassVar

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.modifiers.base import Measurement, Memory
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.sensors.motion.triad import Triad, TriadErrors, TriadMemory

_UNIT: tuple[Vec3, Vec3, Vec3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class MagnetometerConfig(SensorTable, tag="magnetometer", kw_only=True, frozen=True):
    """A three-axis magnetometer. It needs `[world] origin_lat_deg` and `origin_lon_deg`.

    Attributes:
        ideal: the Earth's field alone, whatever else is given.
        soft_iron: matrix that the field in S is multiplied by.
        hard_iron_T: field of the vehicle's magnetised parts, in S; one more is drawn with `errors.turn_on`.
        thruster_field_TpA: field in S per ampere that the thrusters draw together.
        errors: of the device, in T.
    """

    needs_origin: ClassVar[bool] = True
    ideal: bool = False
    soft_iron: tuple[Vec3, Vec3, Vec3] = _UNIT
    hard_iron_T: Vec3 = (0.0, 0.0, 0.0)
    thruster_field_TpA: Vec3 = (0.0, 0.0, 0.0)
    errors: TriadErrors = TriadErrors()

    def build(self, mount: Pose) -> Magnetometer:
        return Magnetometer(mount, self)


class MagnetometerMemory(Memory):
    """Attributes:
    triad: the errors of the three axes."""

    triad: TriadMemory = TriadMemory()


class Magnetometer(Sensor):
    """Magnetic field at the mount."""

    doc = "Magnetic flux density at the mount: the Earth's field, distorted by the vehicle."
    fields = (Field("field_S", "T", "magnetic flux density", "S", (3,)),)

    memory: MagnetometerMemory

    def __init__(self, mount: Pose, config: MagnetometerConfig) -> None:
        self._mount, self._config = mount, config
        self._triad = Triad(TriadErrors() if config.ideal else config.errors)
        super().__init__()

    def turn_on(self) -> MagnetometerMemory:
        return MagnetometerMemory(self._triad.turn_on(self.rng))

    def sense(self, scope: Scope) -> Measurement:
        """Always valid."""
        earth_N = scope.earth.magnetic_field(scope.position(self._mount.p))
        field = rotate(conjugate(scope.attitude(self._mount.q)), earth_N)
        if not self._config.ideal:
            field = self._distorted(field, scope)
        if not self._triad.exact:
            draws = self.rng.standard_normal(self._triad.draws).tolist()
            field, self.memory.triad = self._triad.disturbed(field, self.memory.triad, self.dt, draws)
        return Measurement([field], True)

    def _distorted(self, field: Vec3, scope: Scope) -> Vec3:
        c = self._config
        x, y, z = (row[0] * field[0] + row[1] * field[1] + row[2] * field[2] for row in c.soft_iron)
        hx, hy, hz = c.hard_iron_T
        if any(c.thruster_field_TpA) and scope.wiring is not None and scope.wiring.voltage > 0.0:
            current = scope.wiring.power() / scope.wiring.voltage
            kx, ky, kz = c.thruster_field_TpA
            hx, hy, hz = hx + kx * current, hy + ky * current, hz + kz * current
        return x + hx, y + hy, z + hz
