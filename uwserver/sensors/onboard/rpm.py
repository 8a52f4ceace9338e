"""Shaft speed of thrusters, as their speed controllers report it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Field
from uwserver.sensors.base import Named, Pose, Scope, SensorTable, Traits
from uwserver.sensors.compiled import MISSING, SensorKernel, TableSensor, loop, record, shaft_speed
from uwserver.sensors.wiring import Wiring
from uwserver.table import Name, NonNegative

MOST_MEMBERS = 64
"""Most thrusters of one sensor."""


class RpmConfig(SensorTable, tag="rpm", kw_only=True, frozen=True):
    """Shaft speeds. Each thruster's device file needs `[electric]`.

    Attributes:
        ideal: exact, whatever the other keys say.
        members: names of thrusters, in the order of the reading.
        sigma_radps: standard deviation of white noise.
        signed: False for a controller that does not know the direction.
    """

    message = "ShaftSpeeds"
    example: ClassVar[Mapping[str, Any]] = {"members": ["t1"]}
    ideal: bool = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=MOST_MEMBERS)]
    sigma_radps: NonNegative = 0.0
    signed: bool = True

    def traits(self) -> Traits:
        """Declare the thrusters that it measures."""
        return Traits(names=tuple(Named(("members", k), "thrusters", name) for k, name in enumerate(self.members)))

    def build(self, mount: Pose) -> Rpm:
        """Return the sensor; its mount does not matter."""
        return Rpm(self)


_RECORD = record([("members", "i8", (MOST_MEMBERS,)), ("signed", "i8"), ("sigma", "f8")])


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the shaft speeds; invalid if one of them is not known."""
    for k in range(len(out)):
        speed = shaft_speed(head, surroundings, row.members[k])
        if math.isnan(speed):
            out[:], head.valid = MISSING, 0
            return
        out[k] = speed if row.signed != 0 else abs(speed)
        if head.exact == 0:
            noise, _ = normals(head.key, head.number, SAMPLE, k)
            out[k] += row.sigma * noise


class Rpm(TableSensor[RpmConfig]):
    """Shaft speeds, computed from the open-water thrust at rest."""

    doc = "Shaft speed of thrusters; no value if the device file does not give it."
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("sigma",)

    def __init__(self, config: RpmConfig) -> None:
        self._places = [-1] * len(config.members)
        order = ", ".join(config.members)
        self.fields = (Field("speeds", "rad/s", f"shaft speed, order: {order}", "", (len(config.members),)),)
        super().__init__(Pose(), config)

    def wire(self, wiring: Wiring) -> None:
        """Find the numbers of its thrusters among those of the vehicle. They stay the same when other vehicles are added or removed."""
        self._places = [wiring.place_of(name) for name in self._config.members]
        self.fill(self.rows.rows[self.row])

    def fill(self, row: Any) -> None:
        c = self._config
        row["members"][: len(c.members)] = self._places
        row["signed"], row["sigma"] = c.signed, c.sigma_radps

    def sense(self, scope: Scope) -> Measurement | None:
        """Return a reading outside a world, of the thrusters in the scope."""
        if scope.wiring is not None:
            self.wire(scope.wiring)
        return super().sense(scope)
