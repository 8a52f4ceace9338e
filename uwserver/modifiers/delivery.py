"""Errors of delivery: latency with jitter, and loss."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Stream
from uwserver.table import NonNegative, Probability, Table
from uwserver.units import NANOSECONDS


class Delay(Table, tag="delay", tag_field="kind", kw_only=True, frozen=True):
    """The device delivers `latency_s` after it measured, plus a normal error of `jitter_s`, never before. The sample keeps the time at
    which it was true."""

    latency_s: NonNegative
    jitter_s: NonNegative = 0.0

    def build(self, stream: Stream) -> _Delay:
        """The modifier."""
        return _Delay(self, stream)


class _Delay:
    def __init__(self, config: Delay, stream: Stream) -> None:
        self.stream, self.memory = stream, list[float]()
        self._config = config

    def apply(self, reading: Measurement) -> None:
        c = self._config
        delay = c.latency_s
        if c.jitter_s > 0.0:
            delay = max(0.0, delay + self.stream.rng.normal(0.0, c.jitter_s))
        reading.delay_ns += round(delay * NANOSECONDS)


class Dropout(Table, tag="dropout", tag_field="kind", kw_only=True, frozen=True):
    """Each sample is lost with `probability`; its sequence number is not given again, so the receiver sees the gap."""

    probability: Probability

    def build(self, stream: Stream) -> _Dropout:
        """The modifier."""
        return _Dropout(self, stream)


class _Dropout:
    def __init__(self, config: Dropout, stream: Stream) -> None:
        self.stream, self.memory = stream, list[float]()
        self._probability = config.probability

    def apply(self, reading: Measurement) -> None:
        if self.stream.rng.random() < self._probability:
            reading.dropped = True
