"""Turns of both versions become pairs of values."""

from __future__ import annotations

import pytest
from uwserver_bench.against.pairs import Kind, Pairs, Unable, in_turns
from uwserver_bench.processes import BenchFailed

TICK, LOAD = Kind("ticks", "a tick", "us"), Kind("loading", "a load", "ms")


def test_both_sides_are_first_equally_often_and_a_steady_drift_cancels() -> None:
    for pair in range(4):
        time, found = 0.0, {"ours": 0.0, "theirs": 0.0}
        for side in in_turns(pair):
            found[side] += time
            time += 1.0
        assert found["ours"] == found["theirs"]
    assert {in_turns(0)[0], in_turns(1)[0]} == {"ours", "theirs"}


def test_the_mean_of_the_turns_is_the_value_of_a_pair() -> None:
    pairs, costs = Pairs(), iter([1.0, 10.0, 20.0, 3.0])
    pairs.measure(TICK, in_turns(0), lambda side: next(costs))
    (figure,) = pairs.figures({"ticks": 0})
    assert (figure.ours, figure.theirs) == ((2.0,), (15.0,))


def test_figures_come_in_the_order_of_their_groups() -> None:
    pairs = Pairs()
    for kind in (TICK, LOAD):
        pairs.measure(kind, ("ours", "theirs"), lambda side: 1.0)
    assert [figure.group for figure in pairs.figures({"loading": 0, "ticks": 1})] == ["loading", "ticks"]


def test_what_their_version_cannot_do_is_left_out_and_told() -> None:
    pairs, asked = Pairs(), []

    def cost(side: str) -> float:
        asked.append(side)
        if side == "theirs":
            raise Unable('unknown key "sonar"')
        return 1.0

    for pair in range(3):
        pairs.measure(TICK, in_turns(pair), cost)
    (figure,) = pairs.figures({"ticks": 0})
    assert figure.verdict == "absent"
    assert 'unknown key "sonar"' in figure.note
    assert asked == ["ours", "theirs"], "it is asked once"


def test_what_our_version_cannot_do_ends_the_comparison() -> None:
    def cost(side: str) -> float:
        raise Unable("broken")

    with pytest.raises(BenchFailed, match=r"a tick.*broken"):
        Pairs().measure(TICK, ("ours", "theirs"), cost)


def test_only_what_is_asked_for_is_measured() -> None:
    pairs, asked = Pairs("TICK"), []
    for kind in (TICK, LOAD):
        pairs.measure(kind, ("ours", "theirs"), lambda side, kind=kind: asked.append(kind.name) or 1.0)
    assert set(asked) == {"a tick"}


def test_what_is_left_out_is_told_with_its_reason() -> None:
    pairs = Pairs()
    pairs.measure(TICK, ("ours", "theirs"), lambda side: 1.0)
    pairs.leave_out(TICK, "zenoh is not installed on both sides")
    pairs.measure(TICK, ("ours", "theirs"), lambda side: 1.0)
    (figure,) = pairs.figures({"ticks": 0})
    assert figure.verdict == "absent"
    assert figure.note == "zenoh is not installed on both sides"
    assert pairs.left_out(TICK)
    assert not pairs.left_out(LOAD)
