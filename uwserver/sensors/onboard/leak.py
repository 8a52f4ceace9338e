"""Leak probe: it detects water in the hull. A service switches the leak itself on."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import Meta

from uwserver.modifiers.base import Memory
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, SensorTable, Settings
from uwserver.sensors.compiled import CompiledSensor, SensorKernel, gauge_pressure, loop, p_NS, place_of, record
from uwserver.table import NonNegative, Positive


class LeakConfig(SensorTable, tag="leak", kw_only=True, frozen=True):
    """A probe that is wet when `threshold_m3` of water are in the hull. The water adds no weight to the vehicle.

    Attributes:
        area_m2: area of the hole at the start. Water enters at 0.6 A sqrt(2 dp / rho), with the gauge pressure dp at the mount.
        threshold_m3: volume of water that makes the probe wet.
    """

    message = "Leak"
    area_m2: NonNegative = 0.0
    threshold_m3: Positive = 1e-6

    def build(self, mount: Pose) -> Leak:
        """Return the sensor; its mount is the position of the hole."""
        return Leak(mount, self)


class LeakSettings(Settings, frozen=True):
    """The leak to inject."""

    area_m2: Annotated[float, Meta(ge=0)]


class LeakMemory(Memory):
    """Attributes:
    volume: volume of the water in the hull, m^3."""

    volume: Annotated[float, Meta(ge=0)] = 0.0


DISCHARGE = 0.6
"""Discharge coefficient of a sharp-edged orifice (Torricelli's law with contraction), from textbooks of hydraulics."""


_RECORD = record([("area", "f8"), ("threshold", "f8")], [("volume", "f8")])


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Let water in while there is a hole under pressure, and write whether the probe is wet; always valid."""
    pressure = gauge_pressure(surroundings, p_NS(head, surroundings), t)
    if row.area > 0.0 and pressure > 0.0:
        row.m.volume += DISCHARGE * row.area * math.sqrt(2.0 * pressure / place_of(surroundings).density) * head.dt
    out[0] = 1.0 if row.m.volume >= row.threshold else 0.0


class Leak(CompiledSensor):
    """A leak probe. Its memory holds the water in the hull."""

    doc = "Leak probe in the hull. To make a leak, give `area_m2` to the service `set`; a reset of the world dries the hull."
    fields = (Field("leak", "1", "the probe is wet", type="bool"),)
    kernel = SensorKernel(_RECORD, loop(measure))
    memory_type = LeakMemory
    exact = True
    settings: LeakSettings

    def __init__(self, mount: Pose, config: LeakConfig) -> None:
        self._threshold = config.threshold_m3
        self.arguments = (Argument("area_m2", "float", "area of the hole", "m^2", required=False, minimum=0.0),)
        super().__init__(mount, LeakSettings(config.area_m2))

    def fill(self, row: Any) -> None:
        row["area"], row["threshold"] = self.settings.area_m2, self._threshold
