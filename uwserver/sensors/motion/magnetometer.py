"""Magnetometer: the Earth's field of the World Magnetic Model, distorted by the vehicle's own iron and currents."""

from __future__ import annotations

from typing import Any

from uwserver.frames import Vec3
from uwserver.modifiers.base import Memory
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable, Traits
from uwserver.sensors.compiled import (
    SensorKernel,
    TableSensor,
    conjugate,
    loop,
    magnetic_field,
    p_NS,
    power,
    q_NS,
    record,
    rotate,
    supply_voltage,
)
from uwserver.sensors.motion.triad import (
    TRIAD,
    TRIAD_DRAWS,
    TRIAD_MEMORY,
    TriadErrors,
    TriadMemory,
    disturbed,
    fill_triad,
    turn_on,
)

_UNIT: tuple[Vec3, Vec3, Vec3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class MagnetometerConfig(SensorTable, tag="magnetometer", kw_only=True, frozen=True):
    """A three-axis magnetometer. It needs `[world] origin_lat_deg` and `origin_lon_deg`.

    Attributes:
        ideal: only the Earth's field, whatever the other keys say.
        soft_iron: matrix by which the field in S is multiplied.
        hard_iron_T: field of the vehicle's magnetised parts, in S. A further one is drawn with `errors.turn_on`.
        thruster_field_TpA: field in S per ampere of the current that all thrusters draw.
        errors: errors of the device, in T.
    """

    message = "MagneticField"
    ideal: bool = False
    soft_iron: tuple[Vec3, Vec3, Vec3] = _UNIT
    hard_iron_T: Vec3 = (0.0, 0.0, 0.0)
    thruster_field_TpA: Vec3 = (0.0, 0.0, 0.0)
    errors: TriadErrors = TriadErrors()

    def traits(self) -> Traits:
        """Declare its errors, and that it needs the Earth's field."""
        return Traits(sigmas={"field_S": self.errors.sigma(self.rate_hz)}, needs_origin=True, needs_field=True)

    def build(self, mount: Pose) -> Magnetometer:
        return Magnetometer(mount, self)


class MagnetometerMemory(Memory):
    """Attributes:
    triad: errors of the three axes."""

    triad: TriadMemory = TriadMemory()


_RECORD = record(
    [("soft_iron", "f8", (3, 3)), ("hard_iron", "f8", (3,)), ("by_current", "f8", (3,)), ("triad", TRIAD)],
    [("triad", TRIAD_MEMORY)],
)


@compiled
def _distorted(row: Any, head: Any, surroundings: Array, field: Vec3) -> Vec3:
    """Return the Earth's field in S with the soft iron, hard iron and thruster fields of the vehicle."""
    s, (x, y, z) = row.soft_iron, field
    hx, hy, hz = row.hard_iron[0], row.hard_iron[1], row.hard_iron[2]
    by = row.by_current
    voltage = supply_voltage(head, surroundings)
    if voltage > 0.0 and (by[0] != 0.0 or by[1] != 0.0 or by[2] != 0.0):
        current = power(head, surroundings) / voltage
        hx, hy, hz = hx + by[0] * current, hy + by[1] * current, hz + by[2] * current
    return (
        s[0, 0] * x + s[0, 1] * y + s[0, 2] * z + hx,
        s[1, 0] * x + s[1, 1] * y + s[1, 2] * z + hy,
        s[2, 0] * x + s[2, 1] * y + s[2, 2] * z + hz,
    )


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the field in S."""
    field = rotate(conjugate(q_NS(head, surroundings)), magnetic_field(surroundings, p_NS(head, surroundings)))
    if head.exact == 0:
        field = disturbed(row.triad, row.m.triad, head, 0, _distorted(row, head, surroundings, field))
    out[0], out[1], out[2] = field


class Magnetometer(TableSensor[MagnetometerConfig]):
    """Magnetic field at the mount; always valid."""

    doc = "Magnetic flux density at the mount: the Earth's field, distorted by the vehicle."
    fields = (Field("field_S", "T", "magnetic flux density", "S", (3,)),)
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("triad.white", "triad.wander", "triad.walk", "m.triad.instability")
    memory_type = MagnetometerMemory

    def fill(self, row: Any) -> None:
        c = self._config
        row["soft_iron"], row["hard_iron"], row["by_current"] = c.soft_iron, c.hard_iron_T, c.thruster_field_TpA
        fill_triad(row["triad"], c.errors)

    def turn_on_row(self, memory: Any) -> None:
        turn_on(memory["triad"], self._config.errors, self.drawn(TRIAD_DRAWS))
