"""Requests of one peer are counted in windows of wall time."""

from __future__ import annotations

import pytest

from uwserver.adapter import RateMeter, limits
from uwserver.adapter.limits import TurnTimes


def test_so_many_in_a_window_and_then_a_new_one():
    meter = RateMeter(3, window_s=2.0)
    assert [meter.take(10.0) for _ in range(5)] == [True, True, True, False, False]
    assert meter.is_flooded(11.9)
    assert meter.is_full(11.9)
    assert not meter.is_full(12.0)
    assert not meter.is_flooded(12.0)
    assert meter.take(12.0)
    assert not meter.is_flooded(12.0)
    assert (meter.count, meter.end) == (1, 14.0)


def test_a_window_is_a_second_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(limits, "WINDOW_S", 7.0)
    meter = RateMeter(1)
    meter.take(0.0)
    assert meter.end == 7.0


def test_turns_come_one_after_the_other_with_a_rest_before_each():
    turns = TurnTimes()
    assert [turns.after(10.0, 2.0, 4.0) for _ in range(3)] == [14.0, 20.0, 26.0]
    assert turns.after(31.0, 2.0, 4.0) == 35.0
    assert turns.after(100.0, 2.0, 4.0) == 104.0


def test_one_that_costs_as_much_as_several():
    meter = RateMeter(10)
    assert meter.take(0.0, 9)
    assert not meter.take(0.0, 2)
    assert meter.take(1.0, 10)


def test_it_is_full_one_before_it_is_flooded():
    meter = RateMeter(2, window_s=2.0)
    meter.take(10.0)
    assert not meter.is_full(10.0)
    meter.take(10.0)
    assert meter.is_full(10.0)
    assert not meter.is_flooded(10.0)
