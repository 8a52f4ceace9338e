"""Allocation against closed forms: known layouts of thrusters, limits, thrust curves turned round, fins and a shaft."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest

from uwserver.autopilot.allocation import (
    SLOW_MPS,
    FinEffect,
    Shaft,
    Thrust,
    allocate_fins,
    allocate_thrusters,
    allocate_wrench,
    command_for,
    controllable,
    curve_points,
    fin_allocation,
    shaft_speed,
    shaft_thrust,
    thruster_allocation,
    wrench_allocation,
)
from uwserver.autopilot.rows import SPEC

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
    """Newtons of each thruster, and the wrench made."""
    made = allocate_thrusters(allocation.devices, tuple(map(float, tau)))
    return allocation.devices["force"].tolist(), made


def test_surge_is_shared_by_the_four_and_signed_by_their_axes():
    found, made = forces(thruster_allocation([(vectored(), False)]), (10.0, 0, 0, 0, 0, 0))
    share = 10.0 / (4.0 * math.cos(math.pi / 4))
    assert found == pytest.approx([-share, -share, share, share, 0, 0], abs=1e-4)
    assert made == pytest.approx((10.0, 0, 0, 0, 0, 0), abs=1e-4)


def test_heave_is_shared_by_the_two_and_roll_by_their_difference():
    allocation = thruster_allocation([(vectored(), False)])
    assert forces(allocation, (0, 0, 8.0, 0, 0, 0))[0] == pytest.approx([0, 0, 0, 0, 4, 4], abs=1e-4)
    assert forces(allocation, (0, 0, 0, 0.44, 0, 0))[0] == pytest.approx([0, 0, 0, 0, 2, -2], abs=1e-4)


def test_yaw_takes_the_arm_of_the_diagonal():
    arm = (0.15 + 0.1) / math.sqrt(2.0)
    found, _ = forces(thruster_allocation([(vectored(), False)]), (0, 0, 0, 0, 0, 1.0))
    assert np.abs(found[:4]) == pytest.approx([1.0 / (4.0 * arm)] * 4, abs=1e-4)


def test_an_axis_that_follows_from_another_is_left_alone():
    """Low thrusters pitch the vehicle when they push it: pitch cannot be chosen, and surge must not suffer from it."""
    allocation = thruster_allocation([(vectored(z=0.085), False)])
    assert allocation.axes == (0, 1, 2, 3, 5)
    _, made = forces(allocation, (10.0, 3.0, 5.0, 0.2, 1.0, 0.5))
    assert made[:4] == pytest.approx((10.0, 3.0, 5.0, 0.2), abs=1e-3)
    assert made[5] == pytest.approx(0.5, abs=1e-3)
    assert made[4] == pytest.approx(0.85, abs=1e-3)


def test_the_cheapest_of_all_forces_is_chosen():
    """Nothing that makes no wrench is added: the forces have no part in the null space of the columns."""
    thrusters = vectored()
    found, _ = forces(thruster_allocation([(thrusters, False)]), (5.0, -2.0, 3.0, 0.1, 0.0, 0.4))
    columns = np.array([t.column for t in thrusters]).T
    null = np.linalg.svd(columns)[2][np.linalg.matrix_rank(columns) :]
    assert null @ np.array(found) == pytest.approx(np.zeros(len(null)), abs=1e-4)


def test_a_stronger_thruster_takes_more():
    twice = ((-1.0, -40.0), (0.0, 0.0), (1.0, 40.0))
    pair = [thrust((0, 0, 0), (1, 0, 0)), thrust((0, 0, 0), (1, 0, 0), twice)]
    found, _ = forces(thruster_allocation([(pair, False)]), (15.0, 0, 0, 0, 0, 0))
    # The least sum of (f / limit)^2: forces as 1 to 4.
    assert found == pytest.approx((3.0, 12.0), abs=1e-4)


def test_at_the_limit_heave_and_attitude_keep_their_share():
    found, made = forces(thruster_allocation([(vectored(), False)]), (300.0, 100.0, 20.0, 0.3, 0, 1.0))
    assert max(np.abs(found)) == pytest.approx(20.0, abs=1e-6)
    assert (made[2], made[3], made[5]) == pytest.approx((20.0, 0.3, 1.0), abs=1e-3)
    assert made[0] / made[1] == pytest.approx(3.0, abs=1e-3)
    assert 0.0 < made[0] < 300.0


def test_too_much_of_an_important_axis_alone_is_scaled():
    found, made = forces(thruster_allocation([(vectored(), False)]), (10.0, 0, 100.0, 0, 0, 0))
    assert found[4:] == pytest.approx([20.0, 20.0])
    assert made[2] == pytest.approx(40.0)
    # The four others have nothing to do with it.
    assert made[0] == pytest.approx(10.0, abs=1e-3)


def test_reach_is_what_one_axis_can_have_alone():
    allocation = thruster_allocation([(vectored(), False)])
    assert allocation.reach[0] == pytest.approx(80.0 * math.cos(math.pi / 4), rel=1e-3)
    assert allocation.reach[2] == pytest.approx(40.0, rel=1e-3)
    assert allocation.reach[4] == 0.0


def test_devices_stand_in_the_order_of_the_actuators_that_say_what_they_take():
    four, two = vectored()[:4], vectored()[4:]
    allocation = thruster_allocation([(four, False), (two, True)])
    found, _ = forces(allocation, (0, 0, 8.0, 0, 0, 0))
    assert found == pytest.approx((0, 0, 0, 0, 4.0, 4.0), abs=1e-4)
    assert allocation.devices["by_force"].tolist() == [0, 0, 0, 0, 1, 1]
    steep = ((-1.0, -40.0), (0.0, 0.0), (0.5, 10.0), (1.0, 40.0))
    allocation = thruster_allocation([([thrust((0, 0, 0), (1, 0, 0)), thrust((0, 0, 0), (1, 0, 0), steep)], False)])
    assert [u_of(allocation, k, 10.0) for k in range(2)] == [0.5, 0.5]
    assert [u_of(allocation, k, -20.0) for k in range(2)] == [-1.0, -0.5]


def test_axes_of_shapes():
    assert controllable(np.array([[1.0, 1.0], [0, 0], [0, 0], [0, 0], [0, 0], [0.3, -0.3]])) == (0, 5)
    assert controllable(np.eye(6)) == (0, 1, 2, 3, 4, 5)


def u_of(allocation, k, force):
    """The command by which a device makes a force."""
    d = allocation.devices[k]
    return command_for(allocation.curves, d["curve_first"], d["astern"], d["ahead"], force)


# -- thrust curves ---------------------------------------------------------------------------------------------------------------------


def u_for(table, force):
    points, astern, ahead = curve_points(table)
    return command_for(points, 0, astern, ahead, force)


DEAD = ((-1.0, -30.0), (-0.5, -10.0), (-0.1, 0.0), (0.1, 0.0), (0.6, 15.0), (1.0, 40.0))


@pytest.mark.parametrize("force", [-30.0, -17.0, -10.0, -0.5, 0.7, 15.0, 33.0, 40.0])
def test_a_curve_turned_round_gives_the_force_again(force):
    u = u_for(DEAD, force)
    us, fs = zip(*DEAD, strict=True)
    assert np.interp(u, us, fs) == pytest.approx(force)


def test_a_curve_at_its_ends():
    assert u_for(DEAD, 0.0) == 0.0
    assert u_for(DEAD, 100.0) == 1.0
    assert u_for(DEAD, -100.0) == -1.0
    assert 0.1 < u_for(DEAD, 1e-3) < 0.11
    assert -0.11 < u_for(DEAD, -1e-3) < -0.1


# -- wrench, fins and shaft --------------------------------------------------------------------------------------------------------------


def test_a_wrench_is_cut_axis_by_axis():
    allocation = wrench_allocation((10.0, 10.0, 10.0, 1.0, 1.0, 1.0))
    made = allocate_wrench(allocation.devices, (20.0, -5.0, -20.0, 0.5, -2.0, 0.0))
    assert allocation.devices["force"].tolist() == [10.0, -5.0, -10.0, 0.5, -1.0, 0.0]
    assert made == (10.0, -5.0, -10.0, 0.5, -1.0, 0.0)


SHAFT = Shaft(a=0.45, b=0.4, strength=0.4, advance=0.9, diameter=0.14, astern=0.8, limit=160.0)


@pytest.mark.parametrize("u", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("force", [-20.0, 0.5, 5.0, 40.0])
def test_a_shaft_turned_round_gives_the_thrust_again(force, u):
    assert shaft_thrust(SHAFT, shaft_speed(SHAFT, force, u), u) == pytest.approx(force)


def test_a_shaft_stands_still_without_demand_and_has_a_limit():
    assert shaft_speed(SHAFT, 0.0, 2.0) == 0.0
    assert shaft_speed(SHAFT, 1e6, 0.0) == 160.0
    assert shaft_speed(SHAFT, -1e6, 0.0) == -160.0


def angles(allocation, tau, speed):
    """Fins' angles and shafts' speeds, and the wrench made."""
    spec = np.zeros(1, SPEC)[0]
    spec["shaft"] = astuple(SHAFT)
    made = allocate_fins(spec, allocation.devices, tuple(map(float, tau)), speed)
    return allocation.devices["force"].tolist(), made


def fins(limit=0.25):
    plane = FinEffect((0, 0, -5.0, 0, -4.0, 0), limit)
    rudder = FinEffect((0, -3.5, 0, 0, 0, 2.8), limit)
    return fin_allocation([rudder, plane], SHAFT)


@pytest.mark.parametrize("u", [0.5, 1.0, 2.0])
def test_fins_turn_by_moment_over_effect_and_speed_squared(u):
    given, made = angles(fins(), (0, 0, 0, 0, 0.2 * u * u, 0.1 * u * u), u)
    assert given[0] == pytest.approx(0.1 / 2.8, rel=1e-4)
    assert given[1] == pytest.approx(-0.2 / 4.0, rel=1e-4)
    assert made[4:] == pytest.approx((0.2 * u * u, 0.1 * u * u), rel=1e-4)


def test_fins_keep_their_limits_and_pitch_goes_first():
    given, made = angles(fins(), (0, 0, 0, 0, 100.0, 0.5), 1.0)
    assert given[1] == pytest.approx(-0.25)
    assert made[4] == pytest.approx(1.0)
    assert abs(given[0]) <= 0.25


def test_slow_fins_are_not_thrown_about():
    at_rest, _ = angles(fins(), (0, 0, 0, 0, 0.01, 0.0), 0.0)
    slow, _ = angles(fins(), (0, 0, 0, 0, 0.01, 0.0), SLOW_MPS)
    assert at_rest == slow


def test_a_cross_of_four_fins_controls_roll_too():
    cross = [
        FinEffect((0, -2.0, 0, 0.08, 0, 0.8), 0.5),
        FinEffect((0, -2.0, 0, -0.08, 0, 0.8), 0.5),
        FinEffect((0, 0, -2.0, 0.08, -0.8, 0), 0.5),
        FinEffect((0, 0, -2.0, -0.08, -0.8, 0), 0.5),
    ]
    allocation = fin_allocation(cross, SHAFT)
    assert allocation.axes == (0, 3, 4, 5)
    given, made = angles(allocation, (0, 0, 0, 0.016, 0, 0), 1.0)
    assert made[3:] == pytest.approx((0.016, 0, 0), abs=1e-4)
    assert given[:4] == pytest.approx((0.05, -0.05, 0.05, -0.05), rel=1e-3)
