"""Errors of the zero and of the scale: constant ones, given or drawn once at the start of a run, and ones that grow with time."""

from __future__ import annotations

import math
from typing import Any

from uwserver.modifiers.base import NEVER, Memory, ModifierTable, Number, Stream, Time
from uwserver.modifiers.operations import Operation, since
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, draw_normals, normals
from uwserver.table import Name, NonNegative

BIAS, SCALE = 4, 5
"""Codes of the operations."""


class Bias(ModifierTable, tag="bias", kw_only=True, frozen=True):
    """Adds `value` (in the field's unit; one number for all components, or one for each) and a turn-on error that is drawn once with `sigma`."""

    field: Name
    value: float | tuple[float, ...] = 0.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: unknown field, or `value` has another number of components than the field.
        """
        return _constant(BIAS, stream, self.field, "value", self.value, self.sigma)


class Scale(ModifierTable, tag="scale", kw_only=True, frozen=True):
    """Multiplies by `factor` (one number for all components, or one for each; with 1.01 the sensor reads 1 % too high) plus an error of the factor
    that is drawn once with `sigma`."""

    field: Name
    factor: float | tuple[float, ...] = 1.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: unknown field, or `factor` has another number of components than the field.
        """
        return _constant(SCALE, stream, self.field, "factor", self.factor, self.sigma)


class Constants(Memory):
    """The constant of each component.

    Attributes:
        each: bias (field's unit) or factor, drawn errors included.
    """

    each: tuple[Number, ...] = ()


def _constant(
    code: int, stream: Stream, field: str, key: str, given: float | tuple[float, ...], sigma: float
) -> Operation:
    """Return an operation with one constant for each component: what key `key` gives, plus an error that is drawn once."""
    index, each = stream.of_each(field, key, given)
    turn_on = (sigma * draw_normals(stream.key, len(each))).tolist()
    return Operation(code, stream, index, memory=Constants(tuple(g + t for g, t in zip(each, turn_on, strict=True))))


@compiled
def bias(op: Any, numbers: Array, row: Array) -> None:
    """Add the bias. Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] += numbers[op.memory + k]


@compiled
def scale(op: Any, numbers: Array, row: Array) -> None:
    """Multiply by the factor. Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] *= numbers[op.memory + k]


DRIFT = 6
"""Code of the operation."""


class Drift(ModifierTable, tag="drift", kw_only=True, frozen=True):
    """An error that starts at zero and grows: a linear drift and a random walk.

    Attributes:
        rate: linear drift, field's unit per second; one number for all components, or one for each.
        rate_sigma: standard deviation of a further rate that is drawn once, unit/s.
        density: of the random walk, field's unit/sqrt(s): after t seconds its standard deviation is density sqrt(t).
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
