"""Errors that grow with time: a linear drift, and a random walk."""

from __future__ import annotations

import math
from typing import Any

from uwserver.modifiers.base import NEVER, Memory, ModifierTable, Number, Stream, Time
from uwserver.modifiers.operations import Operation, since
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, draw_normals, normals
from uwserver.table import Name, NonNegative

DRIFT = 6
"""Code of the operation."""


class Drift(ModifierTable, tag="drift", kw_only=True, frozen=True):
    """An error that starts at zero and grows: a linear drift and a random walk.

    Attributes:
        rate: linear drift, field's unit per second; one number for all components, or one for each.
        rate_sigma: standard deviation of a further rate that is drawn once, unit/s.
        density: density of the random walk, field's unit/sqrt(s): after t seconds its standard deviation is density sqrt(t).
    """

    field: Name
    rate: float | tuple[float, ...] = 0.0
    rate_sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: unknown field, or `rate` has another number of components than the field.
        """
        index, rate = stream.of_each(self.field, "rate", self.rate)
        drawn = (self.rate_sigma * draw_normals(stream.key, len(rate))).tolist()
        start = Drifting(walk=(0.0,) * len(rate), rate=tuple(r + d for r, d in zip(rate, drawn, strict=True)))
        return Operation(DRIFT, stream, index, (self.density,), start)


class RandomWalk(ModifierTable, tag="random_walk", kw_only=True, frozen=True):
    """An error that wanders off from zero, of variance density**2 t; `density` in unit/sqrt(s). It is a `drift` without its linear part."""

    field: Name
    density: NonNegative

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        return Drift(field=self.field, density=self.density).build(stream)


class Drifting(Memory):
    """How far the error has grown.

    Attributes:
        last: time of the previous reading, s.
        walk: present value of the random walk of each component, field's unit.
        rate: linear drift of each component, unit/s.
    """

    last: Time = NEVER
    walk: tuple[Number, ...] = ()
    rate: tuple[Number, ...] = ()


@compiled
def drift(op: Any, numbers: Array, row: Array, reading: Any, dt: float) -> None:
    """Add the drift. Parameters: density; remembers `Drifting`."""
    t = reading.t_ns / 1e9
    spread = op.p[0] * math.sqrt(since(reading, numbers[op.memory], dt))
    numbers[op.memory] = t
    walk, rate = op.memory + 1, op.memory + 1 + op.count
    for k in range(op.count):
        if spread > 0.0:
            step, _ = normals(op.key, reading.number, SAMPLE, k)
            numbers[walk + k] += spread * step
        row[op.first + k] += numbers[walk + k] + numbers[rate + k] * t
