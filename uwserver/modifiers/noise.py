"""Random errors: white noise, first-order Gauss-Markov noise, outliers."""

from __future__ import annotations

import math
from typing import Any

from uwserver.modifiers.base import NEVER, Memory, ModifierTable, Number, Stream, Time
from uwserver.modifiers.operations import Operation, since
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, draw_normals, normals, uniforms
from uwserver.table import Name, NonNegative, Positive, Probability

WHITE, GAUSS_MARKOV, OUTLIER = 1, 2, 3
"""Codes of the operations."""


class WhiteNoise(ModifierTable, tag="white_noise", kw_only=True, frozen=True):
    """An independent normal error of each component. Give `sigma` (of a sample, in the field's unit) or `density` (unit/sqrt(Hz), as in data sheets;
    sigma = density sqrt(rate)). If both are given, their variances add."""

    field: Name
    sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        return Operation(WHITE, stream, stream.index(self.field), (self.sigma, self.density))


@compiled
def white(op: Any, row: Array, reading: Any, dt: float) -> None:
    """Add white noise. Parameters: sigma, density."""
    sigma = math.sqrt(op.p[0] ** 2 + op.p[1] ** 2 / dt)
    for k in range(0, op.count, 2):
        a, b = normals(op.key, reading.number, SAMPLE, k // 2)
        row[op.first + k] += sigma * a
        if k + 1 < op.count:
            row[op.first + k + 1] += sigma * b


class GaussMarkov(ModifierTable, tag="gauss_markov", kw_only=True, frozen=True):
    """An exponentially correlated error with standard deviation `sigma` (field's unit) and correlation time `tau_s`, the usual model of bias
    instability. It starts from its stationary distribution."""

    field: Name
    sigma: NonNegative
    tau_s: Positive

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        index = stream.index(self.field)
        start = self.sigma * draw_normals(stream.key, stream.fields[index].size)
        memory = Correlated(error=tuple(start.tolist()))
        return Operation(GAUSS_MARKOV, stream, index, (self.sigma, self.tau_s), memory)


class Correlated(Memory):
    """The present error.

    Attributes:
        last: time of the previous reading, s.
        error: error of each component, field's unit.
    """

    last: Time = NEVER
    error: tuple[Number, ...] = ()


@compiled
def gauss_markov(op: Any, numbers: Array, row: Array, reading: Any, dt: float) -> None:
    """Add the correlated error. Parameters: sigma, tau; remembers `Correlated`."""
    decay = math.exp(-since(reading, numbers[op.memory], dt) / op.p[1])
    scale = op.p[0] * math.sqrt(1.0 - decay * decay)
    numbers[op.memory] = reading.t_ns / 1e9
    first = op.memory + 1
    for k in range(0, op.count, 2):
        a, b = normals(op.key, reading.number, SAMPLE, k // 2)
        numbers[first + k] = decay * numbers[first + k] + scale * a
        row[op.first + k] += numbers[first + k]
        if k + 1 < op.count:
            numbers[first + k + 1] = decay * numbers[first + k + 1] + scale * b
            row[op.first + k + 1] += numbers[first + k + 1]


class Outlier(ModifierTable, tag="outlier", kw_only=True, frozen=True):
    """Now and then a reading is far off.

    Attributes:
        probability: that a reading is an outlier.
        sigma: standard deviation of the error of each of its components, field's unit.
        one_sided: the error is always positive, as of an echo on a detour, which always comes late.
    """

    field: Name
    probability: Probability
    sigma: NonNegative
    one_sided: bool = False

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        return Operation(OUTLIER, stream, stream.index(self.field), (self.probability, self.sigma, self.one_sided))


@compiled
def outlier(op: Any, row: Array, reading: Any) -> None:
    """Add an error to outliers. Parameters: probability, sigma, whether it is one-sided. Lane 0 decides whether the reading is one."""
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance >= op.p[0]:
        return
    for k in range(op.count):
        error, _ = normals(op.key, reading.number, SAMPLE, 1 + k)
        row[op.first + k] += op.p[1] * (abs(error) if op.p[2] != 0.0 else error)
