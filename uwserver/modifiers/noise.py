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
    """Independent normal error of each component. Give `sigma` (per sample, in the field's unit) or `density` (unit/sqrt(Hz), as data sheets
    do; sigma = density sqrt(rate)); with both they add in variance."""

    field: Name
    sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> _White:
        """The modifier; ValueError as `Stream.index`."""
        return _White(self, stream)


class _White(Operation):
    code = WHITE

    def __init__(self, config: WhiteNoise, stream: Stream) -> None:
        super().__init__(stream, stream.index(config.field), (config.sigma, config.density))


@compiled
def white(op: Any, row: Array, reading: Any, dt: float) -> None:
    """Parameters: sigma, density."""
    sigma = math.sqrt(op.p[0] ** 2 + op.p[1] ** 2 / dt)
    for k in range(0, op.count, 2):
        a, b = normals(op.key, reading.number, SAMPLE, k // 2)
        row[op.first + k] += sigma * a
        if k + 1 < op.count:
            row[op.first + k + 1] += sigma * b


class GaussMarkov(ModifierTable, tag="gauss_markov", kw_only=True, frozen=True):
    """Exponentially correlated error: standard deviation `sigma` (field's unit), correlation time `tau_s`. The usual stand-in for bias
    instability. It starts from its stationary distribution."""

    field: Name
    sigma: NonNegative
    tau_s: Positive

    def build(self, stream: Stream) -> _GaussMarkov:
        """The modifier; ValueError as `Stream.index`."""
        return _GaussMarkov(self, stream)


class Correlated(Memory):
    """Attributes:
    last: time of the reading before, s.
    error: of each component, field's unit."""

    last: Time = NEVER
    error: tuple[Number, ...] = ()


class _GaussMarkov(Operation):
    code = GAUSS_MARKOV

    def __init__(self, config: GaussMarkov, stream: Stream) -> None:
        index = stream.index(config.field)
        start = config.sigma * draw_normals(stream.key, stream.fields[index].size)
        super().__init__(stream, index, (config.sigma, config.tau_s), Correlated(error=tuple(start.tolist())))


@compiled
def gauss_markov(op: Any, numbers: Array, row: Array, reading: Any, dt: float) -> None:
    """Parameters: sigma, tau; remembers `Correlated`."""
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
        probability: of each reading.
        sigma: standard deviation of the error of each component then, field's unit.
        one_sided: only to more, as an echo by a detour is always late.
    """

    field: Name
    probability: Probability
    sigma: NonNegative
    one_sided: bool = False

    def build(self, stream: Stream) -> _Outlier:
        """The modifier; ValueError as `Stream.index`."""
        return _Outlier(self, stream)


class _Outlier(Operation):
    code = OUTLIER

    def __init__(self, config: Outlier, stream: Stream) -> None:
        super().__init__(stream, stream.index(config.field), (config.probability, config.sigma, config.one_sided))


@compiled
def outlier(op: Any, row: Array, reading: Any) -> None:
    """Parameters: probability, sigma, whether only to more. The first lane decides whether there is one."""
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance >= op.p[0]:
        return
    for k in range(op.count):
        error, _ = normals(op.key, reading.number, SAMPLE, 1 + k)
        row[op.first + k] += op.p[1] * (abs(error) if op.p[2] != 0.0 else error)
