"""Allocation against closed forms: known layouts of thrusters, limits, thrust curves turned round, fins and a shaft."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.autopilot.allocation import Curve, Thrust, Thrusters, Wrench, controllable
from uwserver.autopilot.fins import SLOW_MPS, FinEffect, FinsAndShaft, Shaft

LINEAR = ((-1.0, -20.0), (0.0, 0.0), (1.0, 20.0))
"""20 N at full command, either way."""


def thrust(r, axis, curve=LINEAR):
    axis = np.array(axis) / np.linalg.norm(axis)
    return Thrust(tuple(np.concatenate([axis, np.cross(r, axis)]).tolist()), curve)


def vectored(z=0.0):
    """Four at the corners of a rectangle, 45 degrees, and two vertical ones, as a BlueROV2; `z` of the four below the origin."""
    return [
        thrust((0.15, 0.1, z), (-1, 1, 0)),
        thrust((0.15, -0.1, z), (-1, -1, 0)),
        thrust((-0.15, 0.1, z), (1, 1, 0)),
        thrust((-0.15, -0.1, z), (1, -1, 0)),
        thrust((0.0, 0.11, 0.0), (0, 0, 1)),
        thrust((0.0, -0.11, 0.0), (0, 0, 1)),
    ]


def forces(allocation, tau):
    """Newtons of each thruster (the curve is linear), and the wrench made."""
    given, made = allocation.allocate(tau, 0.0)
    return [20.0 * u for group in given for u in group[0]], made


def test_surge_is_shared_by_the_four_and_signed_by_their_axes():
    found, made = forces(Thrusters([(vectored(), False)]), (10.0, 0, 0, 0, 0, 0))
    share = 10.0 / (4.0 * math.cos(math.pi / 4))
    assert found == pytest.approx([-share, -share, share, share, 0, 0], abs=1e-4)
    assert made == pytest.approx((10.0, 0, 0, 0, 0, 0), abs=1e-4)


def test_heave_is_shared_by_the_two_and_roll_by_their_difference():
    allocation = Thrusters([(vectored(), False)])
    assert forces(allocation, (0, 0, 8.0, 0, 0, 0))[0] == pytest.approx([0, 0, 0, 0, 4, 4], abs=1e-4)
    assert forces(allocation, (0, 0, 0, 0.44, 0, 0))[0] == pytest.approx([0, 0, 0, 0, 2, -2], abs=1e-4)


def test_yaw_takes_the_arm_of_the_diagonal():
    arm = (0.15 + 0.1) / math.sqrt(2.0)
    found, _ = forces(Thrusters([(vectored(), False)]), (0, 0, 0, 0, 0, 1.0))
    assert np.abs(found[:4]) == pytest.approx([1.0 / (4.0 * arm)] * 4, abs=1e-4)


def test_an_axis_that_follows_from_another_is_left_alone():
    """Low thrusters pitch the vehicle when they push it: pitch cannot be chosen, and surge must not suffer from it."""
    allocation = Thrusters([(vectored(z=0.085), False)])
    assert allocation.axes == (0, 1, 2, 3, 5)
    _, made = forces(allocation, (10.0, 3.0, 5.0, 0.2, 1.0, 0.5))
    assert made[:4] == pytest.approx((10.0, 3.0, 5.0, 0.2), abs=1e-3)
    assert made[5] == pytest.approx(0.5, abs=1e-3)
    assert made[4] == pytest.approx(0.85, abs=1e-3)


def test_the_cheapest_of_all_forces_is_chosen():
    """Nothing that makes no wrench is added: the forces have no part in the null space of the columns."""
    thrusters = vectored()
    found, _ = forces(Thrusters([(thrusters, False)]), (5.0, -2.0, 3.0, 0.1, 0.0, 0.4))
    columns = np.array([t.column for t in thrusters]).T
    null = np.linalg.svd(columns)[2][np.linalg.matrix_rank(columns) :]
    assert null @ np.array(found) == pytest.approx(np.zeros(len(null)), abs=1e-4)


def test_a_stronger_thruster_takes_more():
    twice = ((-1.0, -40.0), (0.0, 0.0), (1.0, 40.0))
    pair = [thrust((0, 0, 0), (1, 0, 0)), thrust((0, 0, 0), (1, 0, 0), twice)]
    given, _ = Thrusters([(pair, False)]).allocate((15.0, 0, 0, 0, 0, 0), 0.0)
    # The least sum of (f / limit)^2: forces as 1 to 4.
    assert (20.0 * given[0][0][0], 40.0 * given[0][0][1]) == pytest.approx((3.0, 12.0), abs=1e-4)


def test_at_the_limit_heave_and_attitude_keep_their_share():
    found, made = forces(Thrusters([(vectored(), False)]), (300.0, 100.0, 20.0, 0.3, 0, 1.0))
    assert max(np.abs(found)) == pytest.approx(20.0, abs=1e-6)
    assert (made[2], made[3], made[5]) == pytest.approx((20.0, 0.3, 1.0), abs=1e-3)
    assert made[0] / made[1] == pytest.approx(3.0, abs=1e-3)
    assert 0.0 < made[0] < 300.0


def test_too_much_of_an_important_axis_alone_is_scaled():
    found, made = forces(Thrusters([(vectored(), False)]), (10.0, 0, 100.0, 0, 0, 0))
    assert found[4:] == pytest.approx([20.0, 20.0])
    assert made[2] == pytest.approx(40.0)
    # The four others have nothing to do with it.
    assert made[0] == pytest.approx(10.0, abs=1e-3)


def test_reach_is_what_one_axis_can_have_alone():
    allocation = Thrusters([(vectored(), False)])
    assert allocation.reach[0] == pytest.approx(80.0 * math.cos(math.pi / 4), rel=1e-3)
    assert allocation.reach[2] == pytest.approx(40.0, rel=1e-3)
    assert allocation.reach[4] == 0.0


def test_several_actuators_get_their_own_part_by_force_if_they_want_it():
    four, two = vectored()[:4], vectored()[4:]
    given, _ = Thrusters([(four, False), (two, True)]).allocate((0, 0, 8.0, 0, 0, 0), 0.0)
    assert given[0][0] == pytest.approx((0, 0, 0, 0), abs=1e-5)
    assert given[1][0] == pytest.approx((4.0, 4.0), abs=1e-4)


def test_axes_of_shapes():
    assert controllable(np.array([[1.0, 1.0], [0, 0], [0, 0], [0, 0], [0, 0], [0.3, -0.3]])) == (0, 5)
    assert controllable(np.eye(6)) == (0, 1, 2, 3, 4, 5)


# -- thrust curves ---------------------------------------------------------------------------------------------------------------------

DEAD = ((-1.0, -30.0), (-0.5, -10.0), (-0.1, 0.0), (0.1, 0.0), (0.6, 15.0), (1.0, 40.0))


@pytest.mark.parametrize("force", [-30.0, -17.0, -10.0, -0.5, 0.7, 15.0, 33.0, 40.0])
def test_a_curve_turned_round_gives_the_force_again(force):
    u = Curve(DEAD).command(force)
    us, fs = zip(*DEAD, strict=True)
    assert np.interp(u, us, fs) == pytest.approx(force)


def test_a_curve_at_its_ends():
    curve = Curve(DEAD)
    assert curve.command(0.0) == 0.0
    assert curve.command(100.0) == 1.0
    assert curve.command(-100.0) == -1.0
    assert 0.1 < curve.command(1e-3) < 0.11
    assert -0.11 < curve.command(-1e-3) < -0.1


# -- wrench, fins and shaft --------------------------------------------------------------------------------------------------------------


def test_a_wrench_is_cut_axis_by_axis():
    given, made = Wrench((10.0, 10.0, 10.0, 1.0, 1.0, 1.0)).allocate((20.0, -5.0, -20.0, 0.5, -2.0, 0.0), 0.0)
    assert given == [((10.0, -5.0, -10.0), (0.5, -1.0, 0.0))]
    assert made == (10.0, -5.0, -10.0, 0.5, -1.0, 0.0)


SHAFT = Shaft(a=0.45, b=0.4, strength=0.4, advance=0.9, diameter=0.14, astern=0.8, limit=160.0)


@pytest.mark.parametrize("u", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("force", [-20.0, 0.5, 5.0, 40.0])
def test_a_shaft_turned_round_gives_the_thrust_again(force, u):
    assert SHAFT.thrust(SHAFT.speed(force, u), u) == pytest.approx(force)


def test_a_shaft_stands_still_without_demand_and_has_a_limit():
    assert SHAFT.speed(0.0, 2.0) == 0.0
    assert SHAFT.speed(1e6, 0.0) == 160.0
    assert SHAFT.speed(-1e6, 0.0) == -160.0


def fins(limit=0.25):
    plane = FinEffect((0, 0, -5.0, 0, -4.0, 0), limit)
    rudder = FinEffect((0, -3.5, 0, 0, 0, 2.8), limit)
    return FinsAndShaft([[rudder], [plane]], SHAFT)


@pytest.mark.parametrize("u", [0.5, 1.0, 2.0])
def test_fins_turn_by_moment_over_effect_and_speed_squared(u):
    given, made = fins().allocate((0, 0, 0, 0, 0.2 * u * u, 0.1 * u * u), u)
    assert given[0][0][0] == pytest.approx(0.1 / 2.8, rel=1e-4)
    assert given[1][0][0] == pytest.approx(-0.2 / 4.0, rel=1e-4)
    assert made[4:] == pytest.approx((0.2 * u * u, 0.1 * u * u), rel=1e-4)


def test_fins_keep_their_limits_and_pitch_goes_first():
    given, made = fins().allocate((0, 0, 0, 0, 100.0, 0.5), 1.0)
    assert given[1][0][0] == pytest.approx(-0.25)
    assert made[4] == pytest.approx(1.0)
    assert abs(given[0][0][0]) <= 0.25


def test_slow_fins_are_not_thrown_about():
    at_rest, _ = fins().allocate((0, 0, 0, 0, 0.01, 0.0), 0.0)
    slow, _ = fins().allocate((0, 0, 0, 0, 0.01, 0.0), SLOW_MPS)
    assert at_rest == slow


def test_a_cross_of_four_fins_controls_roll_too():
    cross = [
        FinEffect((0, -2.0, 0, 0.08, 0, 0.8), 0.5),
        FinEffect((0, -2.0, 0, -0.08, 0, 0.8), 0.5),
        FinEffect((0, 0, -2.0, 0.08, -0.8, 0), 0.5),
        FinEffect((0, 0, -2.0, -0.08, -0.8, 0), 0.5),
    ]
    allocation = FinsAndShaft([cross], SHAFT)
    assert allocation.axes == (0, 3, 4, 5)
    given, made = allocation.allocate((0, 0, 0, 0.016, 0, 0), 1.0)
    assert made[3:] == pytest.approx((0.016, 0, 0), abs=1e-4)
    assert given[0][0] == pytest.approx((0.05, -0.05, 0.05, -0.05), rel=1e-3)
