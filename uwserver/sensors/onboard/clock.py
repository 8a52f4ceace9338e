"""The clock of a vehicle: UTC as counted by an oscillator on board."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from uwserver.modifiers.base import Memory
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.compiled import SensorKernel, TableSensor, loop, place_of, record
from uwserver.table import NonNegative


class ClockConfig(SensorTable, tag="clock", kw_only=True, frozen=True):
    """A clock that was set some time ago and drifts.

    Attributes:
        ideal: exact, whatever the other keys say.
        offset_s: offset at t = 0.
        offset_sigma_s: standard deviation of a further offset, drawn once a run.
        drift: seconds gained per second.
        drift_sigma: standard deviation of a further drift (1e-6 is 1 ppm), drawn once a run.
    """

    message = "TimeReference"
    ideal: bool = False
    offset_s: float = 0.0
    offset_sigma_s: NonNegative = 0.0
    drift: float = 0.0
    drift_sigma: NonNegative = 0.0

    def build(self, mount: Pose) -> ClockSensor:
        """Return the sensor; its mount does not matter."""
        return ClockSensor(Pose(), self)


class ClockMemory(Memory):
    """Attributes:
    offset: time by which the clock is ahead at t = 0, s.
    drift: seconds gained per second."""

    offset: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    drift: Annotated[float, Meta(ge=-1, le=1)] = 0.0


_RECORD = record([], [("offset", "f8"), ("drift", "f8")])


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the time; always valid."""
    error_ns = 0 if head.exact != 0 else rounded_ns(row.m.offset + row.m.drift * t)
    shown = place_of(surroundings).t_ns + error_ns
    out.view(np.int64)[0] = place_of(surroundings).epoch_ns + shown
    out[1] = shown / 1e9


class ClockSensor(TableSensor[ClockConfig]):
    """UTC and elapsed time by the vehicle's clock."""

    doc = "UTC and elapsed time by the clock of the vehicle."
    fields = (
        Field("utc_ns", "ns", "nanoseconds since 1970-01-01, UTC without leap seconds", type="int"),
        Field("elapsed", "s", "time since the start of the scenario, by this clock"),
    )
    kernel = SensorKernel(_RECORD, loop(measure))
    memory_type = ClockMemory

    def turn_on_row(self, memory: Any) -> None:
        """Draw offset (s) and drift."""
        c = self._config
        offset, drift = self.drawn(2)
        memory["offset"] = c.offset_s + c.offset_sigma_s * offset
        memory["drift"] = c.drift + c.drift_sigma * drift
