"""Leak probe: tells when water stands in the hull. The leak itself is switched on by a service."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import Measurement, Memory
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings
from uwserver.table import NonNegative, Positive


class LeakConfig(SensorTable, tag="leak", kw_only=True, frozen=True):
    """A probe that is wet when `threshold_m3` of water are in the hull. The water that comes in adds no weight.

    Attributes:
        area_m2: of the hole at the start; water enters under the pressure at the mount, A sqrt(2 dp / rho) 0.6.
        threshold_m3: what makes the probe wet.
    """

    area_m2: NonNegative = 0.0
    threshold_m3: Positive = 1e-6

    def build(self, mount: Pose) -> Leak:
        """The instrument; its mount is the hole."""
        return Leak(mount, self)


class LeakSettings(Settings, frozen=True):
    """A fault to inject."""

    area_m2: Annotated[float, Meta(ge=0)]


class LeakMemory(Memory):
    """Attributes:
    volume: of the water in the hull, m^3."""

    volume: Annotated[float, Meta(ge=0)] = 0.0


_DISCHARGE = 0.6
"""Discharge coefficient of a sharp-edged orifice (Torricelli with contraction), as in any textbook of hydraulics."""


class Leak(Sensor):
    """Water counted in its memory, m3."""

    doc = "Leak probe in the hull. To make a leak, give `area_m2` to the service `set`; a reset of the world dries the hull."
    fields = (Field("leak", "1", "the probe is wet", type="bool"),)
    draws = False
    settings: LeakSettings
    memory: LeakMemory

    def __init__(self, mount: Pose, config: LeakConfig) -> None:
        self._mount, self._threshold = mount, config.threshold_m3
        self.arguments = (Argument("area_m2", "float", "area of the hole", "m^2", required=False, minimum=0.0),)
        super().__init__(LeakSettings(config.area_m2))

    def turn_on(self) -> LeakMemory:
        """Dry."""
        return LeakMemory()

    def sense(self, scope: Scope) -> Measurement:
        """Always valid."""
        water = scope.water
        head = water.pressure(scope.position(self._mount.p), scope.t) - water.atmospheric_pressure
        if self.settings.area_m2 > 0.0 and head > 0.0:
            speed = (2.0 * head / water.density) ** 0.5
            self.memory.volume += _DISCHARGE * self.settings.area_m2 * speed * self.dt
        return Measurement([self.memory.volume >= self._threshold], True)
