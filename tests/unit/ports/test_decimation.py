"""Intervals of time, in each of which a slow reader takes one sample."""

from __future__ import annotations

import pytest

from uwserver.ports.decimation import ROUNDING_NS, Decimation


@pytest.mark.parametrize(("rate_hz", "t_ns", "interval"), [(10.0, 0, 0), (10.0, 99_998_999, 0), (10.0, 100_000_000, 1)])
def test_intervals_are_counted_from_the_start(rate_hz: float, t_ns: int, interval: int) -> None:
    assert Decimation(rate_hz, 0).interval(t_ns) == interval
    assert Decimation(rate_hz, 7_000_000_123).interval(t_ns + 7_000_000_123) == interval


def test_a_time_that_was_rounded_down_belongs_to_its_interval() -> None:
    third = Decimation(3.0, 0)
    assert [third.interval(k * 1_000_000_000 // 3) for k in range(10)] == list(range(10))
    assert third.interval(1_000_000_000 - ROUNDING_NS) == 3
    assert third.interval(1_000_000_000 - 2 * ROUNDING_NS) == 2


def test_what_is_before_the_start_lies_in_none() -> None:
    assert Decimation(10.0, 1_000_000_000).interval(0) == -10


def test_two_alike_are_one() -> None:
    assert len({Decimation(10.0, 5), Decimation(10.0, 5), Decimation(10.0, 6), Decimation(11.0, 5)}) == 3
