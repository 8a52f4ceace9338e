"""Measures how regularly samples come, for `uwclient hz`. Pure functions."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from uwclient.ports import Sample


@dataclass(frozen=True)
class Rate:
    """Figures of one port. They are None if there are fewer than two instants.

    Attributes:
        port: path of the port.
        samples: number of samples that came.
        sim_hz: rate in simulation time.
        wall_hz: rate of arrivals in wall time.
        sim_jitter_ms: standard deviation of the period in simulation time.
        wall_jitter_ms: standard deviation of the period between arrivals.
        drops: samples that are missing by gaps of `seq`, because they were lost, or left out by a rate limit.
    """

    port: str
    samples: int
    sim_hz: float | None
    wall_hz: float | None
    sim_jitter_ms: float | None
    wall_jitter_ms: float | None
    drops: int


def rate(port: str, arrivals: Sequence[tuple[float, Sample]]) -> Rate:
    """Return the figures of a port's samples, each with its time of arrival on a wall clock, s."""
    sim_hz, sim_jitter_ms = _regularity([sample.time_s for _, sample in arrivals])
    wall_hz, wall_jitter_ms = _regularity([arrival for arrival, _ in arrivals])
    sequence = [sample.seq for _, sample in arrivals]
    # A sequence goes back after a reset or a restart of the server; this is no loss.
    drops = sum(max(later - earlier - 1, 0) for earlier, later in zip(sequence, sequence[1:]))
    return Rate(port, len(arrivals), sim_hz, wall_hz, sim_jitter_ms, wall_jitter_ms, drops)


def _regularity(times_s: Sequence[float]) -> tuple[float | None, float | None]:
    periods = [later - earlier for earlier, later in zip(times_s, times_s[1:])]
    total = sum(periods)
    if not periods or total <= 0:
        return None, None
    return len(periods) / total, statistics.pstdev(periods) * 1e3
