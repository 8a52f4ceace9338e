"""Shaft speed of thrusters, as their speed controllers report it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import Measurement
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.table import Name, NonNegative


class RpmConfig(SensorTable, tag="rpm", kw_only=True, frozen=True):
    """Shaft speeds. Each thruster's device file needs `[electric]`.

    Attributes:
        ideal: exact, whatever else is given.
        members: names of thrusters, in the order of the list.
        sigma_radps: standard deviation of white noise.
        signed: False for a controller that knows no direction.
    """

    ideal: bool = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)]
    sigma_radps: NonNegative = 0.0
    signed: bool = True

    def build(self, mount: Pose) -> Rpm:
        """The instrument; its mount does not matter."""
        return Rpm(self)


class Rpm(Sensor):
    """Speeds from the thrust that the shafts give at rest."""

    doc = "Shaft speed of thrusters; no value where the device file does not give it."

    def __init__(self, config: RpmConfig) -> None:
        self._config = config
        self._sigma = 0.0 if config.ideal else config.sigma_radps
        order = ", ".join(config.members)
        self.fields = (Field("speeds", "rad/s", f"shaft speed, order: {order}", "", (len(config.members),)),)
        super().__init__()

    def sense(self, scope: Scope) -> Measurement:
        """Invalid where no thruster is known."""
        members, wiring = self._config.members, scope.wiring
        draws = self.rng.standard_normal(len(members)).tolist()
        if wiring is None or not all(name in wiring.electrics for name in members):
            return Measurement([(None,) * len(members)], False)
        speeds = [wiring.shaft_speed(name) for name in members]
        if not self._config.signed:
            speeds = [abs(speed) for speed in speeds]
        return Measurement([tuple(s + self._sigma * d for s, d in zip(speeds, draws, strict=True))], True)
