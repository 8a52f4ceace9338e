"""Errors of delivery: latency with jitter, loss, wrong order, and a wrong time stamp."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import NEVER, Measurement, Memory, Modifier, ModifierTable, Stream, Time
from uwserver.table import NonNegative, Probability
from uwserver.units import NANOSECONDS


class Delay(ModifierTable, tag="delay", kw_only=True, frozen=True):
    """The device delivers `latency_s` after it measured, plus a normal error of `jitter_s`, never before. The sample keeps the time at
    which it was true."""

    latency_s: NonNegative
    jitter_s: NonNegative = 0.0

    def build(self, stream: Stream) -> _Delay:
        return _Delay(self, stream)


class _Delay(Modifier):
    def __init__(self, config: Delay, stream: Stream) -> None:
        super().__init__(stream)
        self._config = config

    def apply(self, reading: Measurement) -> None:
        c = self._config
        delay = c.latency_s
        if c.jitter_s > 0.0:
            delay = max(0.0, delay + self.stream.rng.normal(0.0, c.jitter_s))
        reading.delay_ns += round(delay * NANOSECONDS)


class Dropout(ModifierTable, tag="dropout", kw_only=True, frozen=True):
    """Each sample is lost with `probability`; its sequence number is not given again, so the receiver sees the gap."""

    probability: Probability

    def build(self, stream: Stream) -> _Dropout:
        return _Dropout(self, stream)


class _Dropout(Modifier):
    def __init__(self, config: Dropout, stream: Stream) -> None:
        super().__init__(stream)
        self._probability = config.probability

    def apply(self, reading: Measurement) -> None:
        if self.stream.rng.random() < self._probability:
            reading.dropped = True


class Reorder(ModifierTable, tag="reorder", kw_only=True, frozen=True):
    """With `probability` a sample arrives too late, behind the next `behind` samples, as over a network with several routes. The sequence
    number shows it."""

    probability: Probability
    behind: Annotated[int, Meta(ge=1, le=1000)] = 1

    def build(self, stream: Stream) -> _Reorder:
        return _Reorder(self, stream)


class Last(Memory):
    """Attributes:
    last: time of the reading before, s."""

    last: Time = NEVER


class _Reorder(Modifier):
    memory: Last

    def __init__(self, config: Reorder, stream: Stream) -> None:
        super().__init__(stream)
        self._config, self.memory = config, Last()

    def apply(self, reading: Measurement) -> None:
        dt = self.stream.dt
        interval = max(dt, reading.since(self.memory.last, dt))
        self.memory.last = reading.t_ns / NANOSECONDS
        if self.stream.rng.random() < self._config.probability:
            # Between the last that overtakes it and the next.
            reading.delay_ns += round((self._config.behind + 0.5) * interval * NANOSECONDS)


class ClockDrift(ModifierTable, tag="clock_drift", kw_only=True, frozen=True):
    """The device writes the time of its own clock on its samples (`t_ns`); the time of delivery (`t_sent_ns`) stays true.

    Attributes:
        offset_s: by which the clock is ahead at t = 0.
        offset_sigma_s: standard deviation of one more offset, drawn once.
        drift: seconds gained a second (1e-6 is 1 ppm).
        drift_sigma: standard deviation of more drift, drawn once.
        walk_sqrts: density of a random walk of the clock, s/sqrt(s).
    """

    offset_s: float = 0.0
    offset_sigma_s: NonNegative = 0.0
    drift: float = 0.0
    drift_sigma: NonNegative = 0.0
    walk_sqrts: NonNegative = 0.0

    def build(self, stream: Stream) -> _ClockDrift:
        return _ClockDrift(self, stream)


class ClockError(Last):
    """Attributes:
    offset: by which the clock is ahead, the walk included and the drift not, s.
    drift: seconds gained a second."""

    offset: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    drift: Annotated[float, Meta(ge=-1, le=1)] = 0.0


class _ClockDrift(Modifier):
    memory: ClockError

    def __init__(self, config: ClockDrift, stream: Stream) -> None:
        super().__init__(stream)
        self._walk = config.walk_sqrts
        offset, drift = stream.rng.standard_normal(2).tolist()
        ahead = config.offset_s + config.offset_sigma_s * offset
        self.memory = ClockError(offset=ahead, drift=config.drift + config.drift_sigma * drift)

    def apply(self, reading: Measurement) -> None:
        m, t = self.memory, reading.t_ns / NANOSECONDS
        if self._walk:
            spread = self._walk * math.sqrt(reading.since(m.last, self.stream.dt))
            m.offset += spread * self.stream.rng.standard_normal()
        m.last = t
        reading.stamp_ns += round((m.offset + m.drift * t) * NANOSECONDS)
