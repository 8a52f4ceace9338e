"""A vehicle's clock: UTC as the oscillator on board counts it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import Measurement, Memory
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.table import NonNegative
from uwserver.units import NANOSECONDS


class ClockConfig(SensorTable, tag="clock", kw_only=True, frozen=True):
    """A clock that was set some time before and drifts.

    Attributes:
        ideal: exact, whatever else is given.
        offset_s: at t = 0.
        offset_sigma_s: standard deviation of one more offset, drawn once a run.
        drift: seconds gained a second.
        drift_sigma: standard deviation of more drift, drawn once a run (1e-6 is 1 ppm).
    """

    ideal: bool = False
    offset_s: float = 0.0
    offset_sigma_s: NonNegative = 0.0
    drift: float = 0.0
    drift_sigma: NonNegative = 0.0

    def build(self, mount: Pose) -> ClockSensor:
        """The instrument; its mount does not matter."""
        return ClockSensor(self)


class ClockMemory(Memory):
    """Attributes:
    offset: by which the clock is ahead at t = 0, s.
    drift: seconds gained a second."""

    offset: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    drift: Annotated[float, Meta(ge=-1, le=1)] = 0.0


class ClockSensor(Sensor):
    """Time as the vehicle knows it."""

    doc = "UTC and running time by the clock of the vehicle."
    fields = (
        Field("utc_ns", "ns", "nanoseconds since 1970-01-01, UTC without leap seconds", type="int"),
        Field("elapsed", "s", "time since the start of the scenario, by this clock"),
    )

    memory: ClockMemory

    def __init__(self, config: ClockConfig) -> None:
        self._config = ClockConfig(rate_hz=config.rate_hz) if config.ideal else config
        super().__init__()

    def turn_on(self) -> ClockMemory:
        """Offset (s) and drift."""
        c = self._config
        offset, drift = self.rng.standard_normal(2).tolist()
        return ClockMemory(c.offset_s + c.offset_sigma_s * offset, c.drift + c.drift_sigma * drift)

    def sense(self, scope: Scope) -> Measurement:
        """Always valid."""
        error_ns = round((self.memory.offset + self.memory.drift * scope.t) * NANOSECONDS)
        shown = scope.t_ns + error_ns
        return Measurement([scope.earth.epoch_ns + shown, shown / NANOSECONDS], True)
