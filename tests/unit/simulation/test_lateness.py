"""Histogram and quantiles of the lateness of ticks."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.simulation.lateness import BUCKETS_S, Lateness

MS = 1_000_000


def test_nothing_yet():
    lateness = Lateness()
    assert lateness.quantiles() == {"p50_s": 0.0, "p99_s": 0.0, "max_s": 0.0}
    assert sum(lateness.counts) == 0
    assert lateness.total_s == 0.0


def test_quantiles_against_numpy():
    late = np.random.default_rng(3).integers(0, 5 * MS, 1000)
    lateness = Lateness()
    for ns in late:
        lateness.add(int(ns))
    seconds = late * 1e-9
    assert lateness.quantiles() == pytest.approx(
        {"p50_s": np.percentile(seconds, 50), "p99_s": np.percentile(seconds, 99), "max_s": seconds.max()}
    )
    assert lateness.total_s == pytest.approx(seconds.sum())


@pytest.mark.parametrize(
    ("late_ns", "bucket"),
    [
        (-5, 0),
        (0, 0),
        (10_000, 0),
        (10_001, 1),
        (25_000, 1),
        (MS, 6),
        (MS + 1, 7),
        (250 * MS, 13),
        (250 * MS + 1, 14),
        (10**12, 14),
    ],
)
def test_buckets_hold_what_is_at_most_their_bound(late_ns, bucket):
    lateness = Lateness()
    lateness.add(late_ns)
    assert lateness.counts.index(1) == bucket
    assert sum(lateness.counts) == 1
    assert len(lateness.counts) == len(BUCKETS_S) + 1


def test_bounds_ascend():
    assert list(BUCKETS_S) == sorted(set(BUCKETS_S))


def test_quantiles_forget_and_the_histogram_does_not():
    """A hiccup at the start must not stand in the status for ever, but stays counted."""
    lateness = Lateness()
    lateness.add(1000 * MS)
    for _ in range(8191):
        lateness.add(MS)
    assert lateness.quantiles()["max_s"] == 1.0
    lateness.add(MS)
    assert lateness.quantiles() == pytest.approx({"p50_s": 1e-3, "p99_s": 1e-3, "max_s": 1e-3})
    assert lateness.counts[-1] == 1
    assert sum(lateness.counts) == 8193
