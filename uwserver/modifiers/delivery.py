"""Errors of delivery: latency with jitter, loss, wrong order, and wrong time stamps."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import Meta

from uwserver.modifiers.base import NEVER, Memory, ModifierTable, Stream, Time
from uwserver.modifiers.operations import Operation, rounded_ns, since
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, draw_normals, normals, uniforms
from uwserver.table import NonNegative, Probability

DELAY, DROPOUT, REORDER, CLOCK_DRIFT = 10, 11, 12, 13
"""Codes of the operations."""


class Delay(ModifierTable, tag="delay", kw_only=True, frozen=True):
    """The device delivers `latency_s` after the measurement, with a normal error of `jitter_s`, but never before it. The sample keeps the time of the
    measurement."""

    latency_s: NonNegative
    jitter_s: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier."""
        return Operation(DELAY, stream, parameters=(self.latency_s, self.jitter_s))


@compiled
def delay(op: Any, reading: Any) -> None:
    """Add the latency. Parameters: latency, jitter."""
    seconds = op.p[0]
    if op.p[1] > 0.0:
        error, _ = normals(op.key, reading.number, SAMPLE, 0)
        seconds = max(0.0, seconds + op.p[1] * error)
    reading.delay_ns += rounded_ns(seconds)


class Dropout(ModifierTable, tag="dropout", kw_only=True, frozen=True):
    """Each sample is lost with `probability`. No other sample gets its sequence number, so the receiver sees the gap."""

    probability: Probability

    def build(self, stream: Stream) -> Operation:
        """Return the modifier."""
        return Operation(DROPOUT, stream, parameters=(self.probability,))


@compiled
def dropout(op: Any, reading: Any) -> None:
    """Mark lost readings. Parameters: probability."""
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance < op.p[0]:
        reading.dropped = 1


class Reorder(ModifierTable, tag="reorder", kw_only=True, frozen=True):
    """With `probability` a sample arrives too late, behind the next `behind` samples, as over a network with several routes. The sequence
    number shows it."""

    probability: Probability
    behind: Annotated[int, Meta(ge=1, le=1000)] = 1

    def build(self, stream: Stream) -> Operation:
        """Return the modifier."""
        return Operation(REORDER, stream, parameters=(self.probability, self.behind), memory=Last())


class Last(Memory):
    """The previous reading.

    Attributes:
        last: its time, s.
    """

    last: Time = NEVER


@compiled
def reorder(op: Any, numbers: Array, reading: Any, dt: float) -> None:
    """Delay late readings. Parameters: probability, how many samples overtake; remembers `Last`."""
    interval = max(dt, since(reading, numbers[op.memory], dt))
    numbers[op.memory] = reading.t_ns / 1e9
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance < op.p[0]:
        # It arrives halfway between the last sample that overtakes it and the one after that.
        reading.delay_ns += rounded_ns((op.p[1] + 0.5) * interval)


class ClockDrift(ModifierTable, tag="clock_drift", kw_only=True, frozen=True):
    """The device stamps its samples (`t_ns`) with its own clock. The time of delivery (`t_sent_ns`) stays true.

    Attributes:
        offset_s: by which the clock is ahead at t = 0.
        offset_sigma_s: standard deviation of a further offset that is drawn once.
        drift: seconds that the clock gains in a second (1e-6 is 1 ppm).
        drift_sigma: standard deviation of a further drift that is drawn once.
        walk_sqrts: density of a random walk of the clock, s/sqrt(s).
    """

    offset_s: float = 0.0
    offset_sigma_s: NonNegative = 0.0
    drift: float = 0.0
    drift_sigma: NonNegative = 0.0
    walk_sqrts: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier."""
        offset, drift = draw_normals(stream.key, 2).tolist()
        ahead = self.offset_s + self.offset_sigma_s * offset
        start = ClockError(offset=ahead, drift=self.drift + self.drift_sigma * drift)
        return Operation(CLOCK_DRIFT, stream, parameters=(self.walk_sqrts,), memory=start)


class ClockError(Last):
    """How wrong the clock of the device is.

    Attributes:
        offset: by which the clock is ahead, with the random walk and without the drift, s.
        drift: seconds that the clock gains in a second.
    """

    offset: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    drift: Annotated[float, Meta(ge=-1, le=1)] = 0.0


@compiled
def clock_drift(op: Any, numbers: Array, reading: Any, dt: float) -> None:
    """Add the error of the clock to the time stamp. Parameters: density of the random walk; remembers `ClockError`."""
    t, m = reading.t_ns / 1e9, op.memory
    if op.p[0] > 0.0:
        step, _ = normals(op.key, reading.number, SAMPLE, 0)
        numbers[m + 1] += op.p[0] * math.sqrt(since(reading, numbers[m], dt)) * step
    numbers[m] = t
    reading.stamp_ns += rounded_ns(numbers[m + 1] + numbers[m + 2] * t)
