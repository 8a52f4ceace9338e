"""Errors that grow with time: a straight drift, and a random walk."""

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
    """Error that starts at zero and grows: a straight drift and a random walk.

    Attributes:
        rate: straight drift, field's unit a second; one number for all components, or one a component.
        rate_sigma: standard deviation of more of it, drawn once, unit/s.
        density: of the random walk, field's unit/sqrt(s): after t seconds its standard deviation is density sqrt(t).
    """

    field: Name
    rate: float | tuple[float, ...] = 0.0
    rate_sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> _Drift:
        """The modifier.

        Raises:
            ValueError: unknown field, or `rate` has another number of components than the field.
        """
        return _Drift(self, stream)


class Drifting(Memory):
    """Attributes:
    last: time of the reading before, s.
    walk: what the random walk of each component has come to, field's unit.
    rate: straight drift of each component, unit/s."""

    last: Time = NEVER
    walk: tuple[Number, ...] = ()
    rate: tuple[Number, ...] = ()


class _Drift(Operation):
    code = DRIFT

    def __init__(self, config: Drift, stream: Stream) -> None:
        index, rate = stream.of_each(config.field, "rate", config.rate)
        drawn = (config.rate_sigma * draw_normals(stream.key, len(rate))).tolist()
        start = Drifting(walk=(0.0,) * len(rate), rate=tuple(r + d for r, d in zip(rate, drawn, strict=True)))
        super().__init__(stream, index, (config.density,), start)


@compiled
def drift(op: Any, numbers: Array, row: Array, reading: Any, dt: float) -> None:
    """Parameters: density; remembers `Drifting`."""
    t = reading.t_ns / 1e9
    spread = op.p[0] * math.sqrt(since(reading, numbers[op.memory], dt))
    numbers[op.memory] = t
    walk, rate = op.memory + 1, op.memory + 1 + op.count
    for k in range(op.count):
        if spread > 0.0:
            step, _ = normals(op.key, reading.number, SAMPLE, k)
            numbers[walk + k] += spread * step
        row[op.first + k] += numbers[walk + k] + numbers[rate + k] * t


class RandomWalk(ModifierTable, tag="random_walk", kw_only=True, frozen=True):
    """Error that wanders off from zero: variance density**2 t; `density` in unit/sqrt(s). A `drift` without its straight part."""

    field: Name
    density: NonNegative

    def build(self, stream: Stream) -> _Drift:
        """The modifier; ValueError as `Stream.index`."""
        return _Drift(Drift(field=self.field, density=self.density), stream)
