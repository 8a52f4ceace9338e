"""What the subscriptions of a port take, one by one (`test_fanout` has more of it) and together."""

from __future__ import annotations

import pytest
from uwserver_adapters.native import shares
from uwserver_adapters.native.shares import Share, Subscription, Taken

from uwserver.ports.decimation import Decimation


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def taken(told: list[str]) -> Taken:
    return Taken(lambda: told.append("less"))


def share(taken: Taken, rate_hz: float | None) -> Share:
    return Share(Subscription(1, "p", rate_hz, None, "ring"), taken)


def test_all_is_taken_until_the_first_sample_has_come(taken: Taken, told: list[str]) -> None:
    """Before that nobody knows from where the intervals count."""
    slow = share(taken, 10.0)
    assert (taken.decimations, told) == ((), [])
    assert slow.passes(40)
    assert (taken.decimations, told) == ((Decimation(10.0, 40),), ["less"])


def test_one_that_takes_all_takes_it_for_the_others(taken: Taken) -> None:
    slow, whole = share(taken, 10.0), share(taken, None)
    assert slow.passes(0)
    assert whole.passes(0)
    assert taken.decimations == ()
    whole.end()
    assert taken.decimations == (Decimation(10.0, 0),)


def test_different_rates_are_told_together_and_alike_once(taken: Taken) -> None:
    slow, slower, same = share(taken, 10.0), share(taken, 1.0), share(taken, 10.0)
    for each in (slow, slower, same):
        each.passes(7)
    assert set(taken.decimations) == {Decimation(10.0, 7), Decimation(1.0, 7)}
    slow.end()
    assert len(taken.decimations) == 2, "one of them still counts its intervals from there"
    same.end()
    assert taken.decimations == (Decimation(1.0, 7),)


def test_who_begins_anew_takes_all_until_then(taken: Taken) -> None:
    slow = share(taken, 10.0)
    slow.passes(0)
    slow.restart()
    assert taken.decimations == ()
    slow.passes(30)
    assert taken.decimations == (Decimation(10.0, 30),)


def test_where_time_goes_back_all_is_taken_from_then_on(taken: Taken, told: list[str]) -> None:
    """Its intervals begin anew each time, of which the world cannot be told in time."""
    slow = share(taken, 10.0)
    times = (5_000_000_000, 1_000_000_000, 1_050_000_000, 1_100_000_000)
    assert [slow.passes(t) for t in times] == [True, True, False, True]
    assert (taken.decimations, len(told)) == ((), 1)
    slow.restart()
    slow.passes(0)
    assert taken.decimations == (Decimation(10.0, 0),)
    slow.end()
    assert taken.decimations == ()


def test_of_many_different_ones_all_samples_are_made(taken: Taken) -> None:
    for k in range(shares.MOST_DECIMATIONS + 1):
        assert len(taken.decimations) == k
        share(taken, 10.0).passes(k)
    assert taken.decimations == ()
