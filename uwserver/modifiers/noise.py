"""Random errors: white noise, first-order Gauss-Markov noise, outliers."""

from __future__ import annotations

import math

from uwserver.modifiers.base import NEVER, Measurement, Memory, Modifier, ModifierTable, Number, Stream, Time, shifted
from uwserver.table import Name, NonNegative, Positive, Probability
from uwserver.units import NANOSECONDS


class WhiteNoise(ModifierTable, tag="white_noise", kw_only=True, frozen=True):
    """Independent normal error of each component. Give `sigma` (per sample, in the field's unit) or `density` (unit/sqrt(Hz), as data sheets
    do; sigma = density sqrt(rate)); with both they add in variance."""

    field: Name
    sigma: NonNegative = 0.0
    density: NonNegative = 0.0

    def build(self, stream: Stream) -> _White:
        """The modifier; ValueError as `Stream.index`."""
        return _White(self, stream)


class _White(Modifier):
    def __init__(self, config: WhiteNoise, stream: Stream) -> None:
        super().__init__(stream)
        self._config = config
        self._index = stream.index(config.field)
        self._size = stream.fields[self._index].size

    def apply(self, reading: Measurement) -> None:
        c = self._config
        sigma = math.sqrt(c.sigma**2 + c.density**2 / self.stream.dt)
        draws = self.stream.rng.normal(0.0, sigma, self._size).tolist()
        reading.values[self._index] = shifted(reading.values[self._index], draws)


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


class _GaussMarkov(Modifier):
    memory: Correlated

    def __init__(self, config: GaussMarkov, stream: Stream) -> None:
        super().__init__(stream)
        self._config = config
        self._index = stream.index(config.field)
        start = stream.rng.normal(0.0, config.sigma, stream.fields[self._index].size).tolist()
        self.memory = Correlated(error=tuple(start))

    def apply(self, reading: Measurement) -> None:
        c, m = self._config, self.memory
        decay = math.exp(-reading.since(m.last, self.stream.dt) / c.tau_s)
        scale = c.sigma * math.sqrt(1.0 - decay * decay)
        draws = self.stream.rng.standard_normal(len(m.error)).tolist()
        m.last = reading.t_ns / NANOSECONDS
        m.error = tuple([decay * e + scale * d for e, d in zip(m.error, draws, strict=True)])
        reading.values[self._index] = shifted(reading.values[self._index], m.error)


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


class _Outlier(Modifier):
    def __init__(self, config: Outlier, stream: Stream) -> None:
        super().__init__(stream)
        self._config = config
        self._index = stream.index(config.field)
        self._size = stream.fields[self._index].size

    def apply(self, reading: Measurement) -> None:
        c, rng = self._config, self.stream.rng
        if rng.random() >= c.probability:
            return
        draws = rng.normal(0.0, c.sigma, self._size).tolist()
        errors = [abs(e) for e in draws] if c.one_sided else draws
        reading.values[self._index] = shifted(reading.values[self._index], errors)
