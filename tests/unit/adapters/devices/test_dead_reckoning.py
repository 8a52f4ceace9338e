"""Positions in closed form: straight lines, turned frames, gaps."""

from __future__ import annotations

import math

import pytest
from devices_rig import S
from uwserver_adapters.devices.dead_reckoning import DeadReckoning

from uwserver.frames import quat_from_rpy


def run(reckoning: DeadReckoning, yaw: float, v: tuple[float, float, float], start: int, count: int) -> None:
    """`count` pings at 10 Hz from a time on (in tenths of seconds), the attitude with each."""
    for i in range(start, start + count):
        reckoning.see_attitude(i * S // 10, quat_from_rpy(0.0, 0.0, yaw))
        reckoning.see_velocity(i * S // 10, v, 0.01)


def test_a_straight_line_is_along_the_heading_of_the_start():
    reckoning = DeadReckoning()
    run(reckoning, 2.0, (1.0, 0.5, 0.25), 0, 101)
    assert reckoning.position() == pytest.approx((10.0, 5.0, 2.5))
    assert reckoning.variance == pytest.approx(100 * (0.01 * 0.1) ** 2)


def test_after_a_right_angle_forward_is_along_y():
    reckoning = DeadReckoning()
    run(reckoning, 0.7, (1.0, 0.0, 0.0), 0, 1)
    run(reckoning, 0.7 + math.pi / 2, (1.0, 0.0, 0.0), 1, 100)
    x, y, _ = reckoning.position()
    assert (x, y) == pytest.approx((0.05, 9.95))  # of the step in which it turns, half is forward
    assert reckoning.attitude()[2] == pytest.approx(math.pi / 2)


def test_a_reset_begins_at_zero_with_the_present_heading():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 0, 50)
    run(reckoning, math.pi / 2, (1.0, 0.0, 0.0), 50, 1)
    reckoning.reset()
    assert reckoning.position() == (0.0, 0.0, 0.0)
    run(reckoning, math.pi / 2, (1.0, 0.0, 0.0), 51, 11)
    assert reckoning.position() == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)


def test_a_gap_is_not_counted_and_the_position_stands():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 0, 11)
    reckoning.see_attitude(60 * S, quat_from_rpy(0.0, 0.0, 0.0))
    assert not reckoning.is_tracking
    assert reckoning.position()[0] == pytest.approx(1.0)
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 600, 11)
    assert reckoning.position()[0] == pytest.approx(2.0)


def test_a_late_ping_is_turned_by_the_attitude_of_its_own_time():
    reckoning = DeadReckoning()
    for i in range(20):
        reckoning.see_attitude(i * S // 100, quat_from_rpy(0.0, 0.0, 0.0))
    reckoning.see_attitude(20 * S // 100, quat_from_rpy(0.0, 0.0, math.pi / 2))
    reckoning.see_velocity(0, (1.0, 0.0, 0.0), 0.0)
    reckoning.see_velocity(S // 10, (1.0, 0.0, 0.0), 0.0)
    # 0.1 s between the pings, and 0.1 s since the last.
    assert reckoning.position() == pytest.approx((0.2, 0.0, 0.0))


def test_between_pings_the_position_goes_on():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (2.0, 0.0, 0.0), 0, 2)
    reckoning.see_attitude(6 * S // 10, quat_from_rpy(0.0, 0.0, 0.0))
    assert reckoning.position()[0] == pytest.approx(1.2)
