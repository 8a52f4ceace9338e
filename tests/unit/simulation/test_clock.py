"""Absolute deadlines, overload, lateness and the lockstep barrier, on mocked time. Also of uwserver.testing.mock_time."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from uwserver.simulation.clock import BUCKETS_S, OVERLOAD_NS, Barrier, Lateness, Pace, SystemTime
from uwserver.testing.mock_time import MockTime
from uwserver.units import NANOSECONDS

TICK = NANOSECONDS // 250


def run(pace: Pace, ticks: int, start: int = 0) -> list[int]:
    never = threading.Event()
    return [pace.wait(k * TICK, never) for k in range(start, start + ticks)]


def test_deadlines_do_not_drift_when_each_tick_costs_time():
    time = MockTime()
    pace = Pace(time)
    never = threading.Event()
    for k in range(10_000):
        assert pace.wait(k * TICK, never) == 0
        time.pass_time(0.003)
    assert time.now_ns() == pytest.approx(9999 * TICK + 3e6, abs=10)


def test_lateness_is_what_is_missing_and_later_ticks_catch_up():
    time = MockTime()
    pace = Pace(time)
    run(pace, 1)
    time.pass_time(0.010)
    assert run(pace, 1, 1) == [6_000_000]
    assert run(pace, 1, 2) == [2_000_000]
    assert run(pace, 1, 3) == [0]
    assert pace.overruns == 0


def test_a_stopped_process_does_not_catch_up_in_a_burst():
    time = MockTime()
    pace = Pace(time)
    run(pace, 1)
    time.pass_time(5.0)
    late = run(pace, 1, 1)[0]
    assert late > OVERLOAD_NS
    assert pace.overruns == 1
    before = time.now_ns()
    run(pace, 250, 2)
    assert time.now_ns() - before == pytest.approx(NANOSECONDS, rel=1e-6)


@pytest.mark.parametrize("speed", [0.1, 1.0, 20.0])
def test_speed_scales_wall_time(speed: float):
    time = MockTime()
    run(Pace(time, speed), 1001)
    assert time.now_ns() == pytest.approx(1000 * TICK / speed, rel=1e-6)


def test_release_starts_anew_from_now():
    time = MockTime()
    pace = Pace(time)
    run(pace, 10)
    time.pass_time(60.0)
    pace.release()
    assert run(pace, 1, 10) == [0]
    assert pace.overruns == 0


def test_a_post_ends_a_long_wait_at_once_and_a_short_one_never():
    post = threading.Event()
    post.set()
    time = MockTime()
    pace = Pace(time, speed=0.001)
    pace.anchor(0)
    assert pace.wait(NANOSECONDS, post) is None
    assert time.waits == []
    pace = Pace(time)
    pace.anchor(0)
    assert pace.wait(TICK, post) == 0


def test_system_time_wakes_early_from_a_long_wait():
    wake = threading.Event()
    threading.Timer(0.05, wake.set).start()
    time = SystemTime()
    start = time.now_ns()
    time.wait(30.0, wake)
    assert time.now_ns() - start < 20 * NANOSECONDS


def test_barrier_opens_only_when_every_client_granted():
    barrier = Barrier(["a", "b"])
    assert barrier.missing(0) == ["a", "b"]
    assert barrier.grant("a", 2, 0) == 2
    assert barrier.missing(0) == ["b"]
    barrier.grant("b", 1, 0)
    assert barrier.missing(0) == []
    assert barrier.missing(1) == ["b"]


def test_grants_add_up_but_not_into_the_past():
    barrier = Barrier(["a"])
    barrier.grant("a", 2, 0)
    assert barrier.grant("a", 3, 0) == 5
    assert barrier.grant("a", 1, 100) == 101


def test_excused_clients_return_with_a_grant_or_a_join():
    barrier = Barrier(["a", "b"])
    barrier.grant("a", 10, 0)
    barrier.excuse(["b"])
    assert barrier.missing(0) == []
    barrier.join("b")
    assert barrier.missing(0) == ["b"]
    assert barrier.absent() == ["a"]
    barrier.leave("b")
    assert barrier.absent() == ["a", "b"]


def test_restart_takes_grants_back():
    barrier = Barrier(["a"])
    barrier.grant("a", 1000, 0)
    barrier.restart(5)
    assert barrier.missing(5) == ["a"]


def test_absent_are_those_whose_last_connection_left():
    barrier = Barrier(["a"])
    assert barrier.absent() == ["a"]
    barrier.join("a")
    barrier.join("a")
    barrier.leave("a")
    assert barrier.absent() == []
    barrier.leave("a")
    assert barrier.absent() == ["a"]


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
