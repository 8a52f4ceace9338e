"""Errors that grow with time: a straight drift, and a random walk."""

from __future__ import annotations

import math

from uwserver.modifiers.base import NEVER, Measurement, Memory, Modifier, ModifierTable, Number, Stream, Time, shifted
from uwserver.table import Name, NonNegative
from uwserver.units import NANOSECONDS


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


class _Drift(Modifier):
    memory: Drifting

    def __init__(self, config: Drift, stream: Stream) -> None:
        super().__init__(stream)
        self._density = config.density
        self._index, rate = stream.of_each(config.field, "rate", config.rate)
        n = len(rate)
        drawn = stream.rng.normal(0.0, config.rate_sigma, n).tolist() if config.rate_sigma else [0.0] * n
        self.memory = Drifting(walk=(0.0,) * n, rate=tuple(r + d for r, d in zip(rate, drawn, strict=True)))

    def apply(self, reading: Measurement) -> None:
        m, t = self.memory, reading.t_ns / NANOSECONDS
        if self._density:
            scale = self._density * math.sqrt(reading.since(m.last, self.stream.dt))
            draws = self.stream.rng.standard_normal(len(m.walk)).tolist()
            m.walk = tuple([w + scale * d for w, d in zip(m.walk, draws, strict=True)])
        m.last = t
        offsets = [w + r * t for w, r in zip(m.walk, m.rate, strict=True)]
        reading.values[self._index] = shifted(reading.values[self._index], offsets)


class RandomWalk(ModifierTable, tag="random_walk", kw_only=True, frozen=True):
    """Error that wanders off from zero: variance density**2 t; `density` in unit/sqrt(s). A `drift` without its straight part."""

    field: Name
    density: NonNegative

    def build(self, stream: Stream) -> _Drift:
        """The modifier; ValueError as `Stream.index`."""
        return _Drift(Drift(field=self.field, density=self.density), stream)
