"""Random errors: white noise, first-order Gauss-Markov noise, random walk."""

from __future__ import annotations

import math

from uwserver.modifiers.base import Measurement, Stream, shifted
from uwserver.table import Name, NonNegative, Positive, Table


class WhiteNoise(Table, tag="white_noise", tag_field="kind", kw_only=True, frozen=True):
    """Independent normal error of each component. Give `sigma` (per sample, in the field's unit) or `density` (unit/sqrt(Hz), as data sheets
    do; sigma = density sqrt(rate)); with both they add in variance."""

    field: Name
    sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> _White:
        """The modifier; ValueError as `Stream.index`."""
        return _White(self, stream)


class _White:
    def __init__(self, config: WhiteNoise, stream: Stream) -> None:
        self.stream, self.memory = stream, list[float]()
        self._config = config
        self._index = stream.index(config.field)
        self._size = stream.fields[self._index].size

    def apply(self, reading: Measurement) -> None:
        c = self._config
        sigma = math.sqrt(c.sigma**2 + c.density**2 / self.stream.dt)
        draws = self.stream.rng.normal(0.0, sigma, self._size).tolist()
        reading.values[self._index] = shifted(reading.values[self._index], draws)


class GaussMarkov(Table, tag="gauss_markov", tag_field="kind", kw_only=True, frozen=True):
    """Exponentially correlated error: standard deviation `sigma` (field's unit), correlation time `tau_s`. The usual stand-in for bias
    instability. It starts from its stationary distribution."""

    field: Name
    sigma: NonNegative
    tau_s: Positive

    def build(self, stream: Stream) -> _GaussMarkov:
        """The modifier; ValueError as `Stream.index`."""
        return _GaussMarkov(self, stream)


class _GaussMarkov:
    def __init__(self, config: GaussMarkov, stream: Stream) -> None:
        self.stream, self._config = stream, config
        self._index = stream.index(config.field)
        self.memory: list[float] = stream.rng.normal(0.0, config.sigma, stream.fields[self._index].size).tolist()

    def apply(self, reading: Measurement) -> None:
        c = self._config
        decay = math.exp(-self.stream.dt / c.tau_s)
        scale = c.sigma * math.sqrt(1.0 - decay * decay)
        draws = self.stream.rng.standard_normal(len(self.memory)).tolist()
        self.memory = [decay * b + scale * n for b, n in zip(self.memory, draws, strict=True)]
        reading.values[self._index] = shifted(reading.values[self._index], self.memory)


class RandomWalk(Table, tag="random_walk", tag_field="kind", kw_only=True, frozen=True):
    """Error that wanders off from zero: variance density**2 t; `density` in unit/sqrt(s)."""

    field: Name
    density: NonNegative

    def build(self, stream: Stream) -> _RandomWalk:
        """The modifier; ValueError as `Stream.index`."""
        return _RandomWalk(self, stream)


class _RandomWalk:
    def __init__(self, config: RandomWalk, stream: Stream) -> None:
        self.stream, self._config = stream, config
        self._index = stream.index(config.field)
        self.memory = [0.0] * stream.fields[self._index].size

    def apply(self, reading: Measurement) -> None:
        scale = self._config.density * math.sqrt(self.stream.dt)
        draws = self.stream.rng.standard_normal(len(self.memory)).tolist()
        self.memory = [b + scale * n for b, n in zip(self.memory, draws, strict=True)]
        reading.values[self._index] = shifted(reading.values[self._index], self.memory)
