"""Sound-velocity sensor, which measures over a short acoustic path in the water."""

from __future__ import annotations

import math
from typing import Any

from uwserver.environment.column import SOUND_SPEED
from uwserver.modifiers.base import Memory, Number
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    loop,
    p_NS,
    record,
    submergence,
    water_property,
)
from uwserver.table import NonNegative


class SoundSpeedConfig(SensorTable, tag="sound_speed", kw_only=True, frozen=True):
    """A sound-velocity sensor.

    Attributes:
        ideal: exact, whatever the other keys say.
        accuracy_mps: standard deviation of a constant error, drawn once a run.
        sigma_mps: standard deviation of white noise.
    """

    message = "SoundSpeed"
    ideal: bool = False
    accuracy_mps: NonNegative = 0.0
    sigma_mps: NonNegative = 0.0

    def traits(self) -> Traits:
        """Declare its errors, constant and white."""
        return Traits(sigmas={"sound_speed": (math.hypot(self.sigma_mps, self.accuracy_mps),)})

    def build(self, mount: Pose) -> SoundSpeed:
        return SoundSpeed(mount, self)


class SoundSpeedMemory(Memory):
    """Attributes:
    offset: constant error, m/s."""

    offset: Number = 0.0


_RECORD = record([("sigma", "f8")], [("offset", "f8")])


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the sound speed; invalid in air."""
    p = p_NS(head, surroundings)
    if submergence(surroundings, p, t) < 0.0:
        out[0], head.valid = MISSING, 0
        return
    out[0] = water_property(surroundings, SOUND_SPEED, p[2])
    if head.exact == 0:
        noise, _ = normals(head.key, head.number, SAMPLE, 0)
        out[0] += row.m.offset + row.sigma * noise


class SoundSpeed(TableSensor[SoundSpeedConfig]):
    """Speed of sound at the mount."""

    doc = "Speed of sound in the water at the mount; no value in air."
    fields = (Field("sound_speed", "m/s", "speed of sound"),)
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("sigma",)
    memory_type = SoundSpeedMemory

    def fill(self, row: Any) -> None:
        row["sigma"] = self._config.sigma_mps

    def turn_on_row(self, memory: Any) -> None:
        memory["offset"] = self._config.accuracy_mps * self.drawn(1)[0]
