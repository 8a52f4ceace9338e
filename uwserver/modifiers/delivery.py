"""Errors of delivery: latency with jitter, loss, wrong order, and a wrong time stamp."""

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
    """The device delivers `latency_s` after it measured, plus a normal error of `jitter_s`, never before. The sample keeps the time at
    which it was true."""

    latency_s: NonNegative
    jitter_s: NonNegative = 0.0

    def build(self, stream: Stream) -> _Delay:
        return _Delay(self, stream)


class _Delay(Operation):
    code = DELAY

    def __init__(self, config: Delay, stream: Stream) -> None:
        super().__init__(stream, parameters=(config.latency_s, config.jitter_s))


@compiled
def delay(op: Any, reading: Any) -> None:
    """Parameters: latency, jitter."""
    seconds = op.p[0]
    if op.p[1] > 0.0:
        error, _ = normals(op.key, reading.number, SAMPLE, 0)
        seconds = max(0.0, seconds + op.p[1] * error)
    reading.delay_ns += rounded_ns(seconds)


class Dropout(ModifierTable, tag="dropout", kw_only=True, frozen=True):
    """Each sample is lost with `probability`; its sequence number is not given again, so the receiver sees the gap."""

    probability: Probability

    def build(self, stream: Stream) -> _Dropout:
        return _Dropout(self, stream)


class _Dropout(Operation):
    code = DROPOUT

    def __init__(self, config: Dropout, stream: Stream) -> None:
        super().__init__(stream, parameters=(config.probability,))


@compiled
def dropout(op: Any, reading: Any) -> None:
    """Parameters: probability."""
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance < op.p[0]:
        reading.dropped = 1


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


class _Reorder(Operation):
    code = REORDER

    def __init__(self, config: Reorder, stream: Stream) -> None:
        super().__init__(stream, parameters=(config.probability, config.behind), memory=Last())


@compiled
def reorder(op: Any, numbers: Array, reading: Any, dt: float) -> None:
    """Parameters: probability, by how many; remembers `Last`."""
    interval = max(dt, since(reading, numbers[op.memory], dt))
    numbers[op.memory] = reading.t_ns / 1e9
    chance, _ = uniforms(op.key, reading.number, SAMPLE, 0)
    if chance < op.p[0]:
        # Between the last that overtakes it and the next.
        reading.delay_ns += rounded_ns((op.p[1] + 0.5) * interval)


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


class _ClockDrift(Operation):
    code = CLOCK_DRIFT

    def __init__(self, config: ClockDrift, stream: Stream) -> None:
        offset, drift = draw_normals(stream.key, 2).tolist()
        ahead = config.offset_s + config.offset_sigma_s * offset
        start = ClockError(offset=ahead, drift=config.drift + config.drift_sigma * drift)
        super().__init__(stream, parameters=(config.walk_sqrts,), memory=start)


@compiled
def clock_drift(op: Any, numbers: Array, reading: Any, dt: float) -> None:
    """Parameters: density of the walk; remembers `ClockError`."""
    t, m = reading.t_ns / 1e9, op.memory
    if op.p[0] > 0.0:
        step, _ = normals(op.key, reading.number, SAMPLE, 0)
        numbers[m + 1] += op.p[0] * math.sqrt(since(reading, numbers[m], dt)) * step
    numbers[m] = t
    reading.stamp_ns += rounded_ns(numbers[m + 1] + numbers[m + 2] * t)
