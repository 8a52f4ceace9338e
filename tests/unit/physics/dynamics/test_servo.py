"""A servo's exact motion: straight at its rate, exponential near its goal, and the same in one step or many."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.servo import advance_servo
from uwserver.physics.kernel.layout import SERVO


def servo(command: float, value: float = 0.0, rate: float = math.inf, tau: float = 0.0, limit: float = 10.0) -> Any:
    row = np.zeros(1, SERVO)
    row["command"], row["value"], row["rate"], row["tau"] = command, value, rate, tau
    row["low"], row["high"] = -limit, limit
    return row[0]


def test_without_rate_and_lag_it_is_there_at_once() -> None:
    row = servo(0.7)
    assert advance_servo(row, 1e-3) == 0.7
    assert row["value"] == 0.7


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_rate_alone_is_a_straight_line_to_the_command(sign: float) -> None:
    row = servo(sign * 1.0, rate=2.0)
    assert [advance_servo(row, 0.2) for _ in range(4)] == pytest.approx([sign * x for x in (0.4, 0.8, 1.0, 1.0)])


def test_a_lag_alone_is_an_exponential() -> None:
    row = servo(2.0, value=1.0, tau=0.5)
    assert advance_servo(row, 0.3) == pytest.approx(2.0 - math.exp(-0.6), rel=1e-14)


def test_rate_and_lag_join_where_the_error_is_rate_times_tau() -> None:
    """From 0 to 1 at 2/s with 0.1 s: straight for 0.4 s until 0.2 is left, exponential from there, with the same slope."""
    assert advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.4) == pytest.approx(0.8, rel=1e-14)
    assert advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.5) == pytest.approx(1.0 - 0.2 * math.exp(-1.0), rel=1e-14)
    before, after = (advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.4 + d) for d in (-1e-6, 1e-6))
    assert after - before == pytest.approx(2.0 * 2e-6, rel=1e-4)


@pytest.mark.parametrize(("rate", "tau"), [(math.inf, 0.3), (0.7, 0.0), (0.7, 0.3), (5.0, 0.01)])
def test_many_steps_are_one(rate: float, tau: float) -> None:
    whole, cut = servo(1.0, value=-1.0, rate=rate, tau=tau), servo(1.0, value=-1.0, rate=rate, tau=tau)
    for _ in range(50):
        advance_servo(cut, 0.01)
    assert advance_servo(whole, 0.5) == pytest.approx(cut["value"], abs=1e-12)


@pytest.mark.parametrize(("command", "limit"), [(50.0, 3.0), (-50.0, -3.0)])
def test_it_goes_no_farther_than_its_limits(command: float, limit: float) -> None:
    assert advance_servo(servo(command, limit=3.0), 1.0) == limit


def test_no_rate_is_stuck() -> None:
    row = servo(1.0, value=0.25, rate=0.0, tau=0.1)
    for _ in range(5):
        assert advance_servo(row, 0.5) == 0.25


def test_at_its_goal_it_stays_there() -> None:
    assert advance_servo(servo(0.3, value=0.3, rate=1.0, tau=0.1), 10.0) == 0.3
