"""A thruster from command to wrench: force table, demand, lag, inflow, and the surface; faults that hold it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.params import ForceTable, Lag, ThrusterParams, lag_row, table_row, thruster_row
from uwserver.physics.dynamics.scratch import EXTRA, NU_R, UP
from uwserver.physics.dynamics.thruster import (
    MOST_INFLOW,
    advance_lag,
    lagged,
    set_demand,
    table_force,
    thrust,
    ventilated,
)
from uwserver.physics.kernel.layout import FREE, SCRATCH, STUCK, STUCK_AT

TABLE = ForceTable(
    (12.0, 16.0), (((-1.0, -30.0), (-0.1, 0.0), (0.1, 0.0), (1.0, 40.0)), ((-1.0, -50.0), (-0.1, 0.0), (0.1, 0.0), (1.0, 60.0)))
)  # fmt: skip
PARAMS = ThrusterParams("t", (0.1, 0.2, 0.0), (1.0, 0.0, 0.0), TABLE, 16.0, Lag(), disc_radius=0.05)
TABLES = table_row(TABLE)


def thruster(command: float = 0.0, **changes: Any) -> Any:
    row = thruster_row(PARAMS, 0, 0)[0]
    row["command"], row["fresh"] = command, 1
    for name, value in changes.items():
        row[name] = value
    return row


@pytest.mark.parametrize(
    ("u", "volts", "force"),
    [
        (1.0, 16.0, 60.0), (-1.0, 16.0, -50.0), (0.0, 16.0, 0.0), (0.05, 14.0, 0.0), (0.55, 12.0, 20.0),
        (0.55, 14.0, 25.0), (1.0, 9.0, 40.0), (1.0, 20.0, 60.0), (2.0, 16.0, 60.0), (-7.0, 12.0, -30.0),
    ],
)  # fmt: skip
def test_the_table_is_linear_between_its_points_and_constant_beyond(u: float, volts: float, force: float) -> None:
    assert table_force(TABLES[0], u, volts) == pytest.approx(force)


def test_a_table_of_one_voltage_serves_all() -> None:
    one = table_row(ForceTable((12.0,), (TABLE.curves[0],)))[0]
    assert {table_force(one, 1.0, volts) for volts in (5.0, 12.0, 30.0)} == {40.0}


def test_a_demand_is_computed_when_something_new_was_set() -> None:
    row = thruster(0.55)
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(30.0)
    assert row["fresh"] == 0
    row["command"] = 1.0  # nobody said so
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(30.0)


@pytest.mark.parametrize(("force", "demand"), [(25.0, 25.0), (99.0, 0.8 * 60.0), (-99.0, -0.8 * 50.0)])
def test_a_command_by_force_is_held_to_what_the_installed_thruster_can(force: float, demand: float) -> None:
    row = thruster(force, by_force=1, installed=0.8)
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(demand)


def test_installed_thrust_is_part_of_the_table_s() -> None:
    row = thruster(1.0, installed=0.9)
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(54.0)


def test_a_stuck_thruster_keeps_its_demand_and_remembers_that_a_command_waits() -> None:
    row = thruster(0.55)
    set_demand(row, TABLES)
    row["stuck"], row["command"], row["fresh"] = STUCK, 1.0, 1
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(30.0)
    row["stuck"] = FREE
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(60.0)


def test_a_thruster_stuck_at_a_command_follows_its_voltage_alone() -> None:
    row = thruster(1.0, stuck=STUCK_AT, stuck_u=0.55)
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(30.0)
    row["voltage"] = 12.0
    set_demand(row, TABLES)
    assert row["demand"] == pytest.approx(20.0)
    assert row["fresh"] == 1


def test_the_lag_goes_by_half_sub_steps_and_efficiency_scales_what_comes_out() -> None:
    lag = lag_row(Lag.first_order(0.2), 0.1)[0]
    row = thruster(demand=10.0, efficiency=0.5)
    assert lagged(row, lag) == 0.0
    assert advance_lag(row, lag, 0) == pytest.approx(5.0 * (1.0 - np.exp(-0.25)))
    assert advance_lag(row, lag, 1) == pytest.approx(5.0 * (1.0 - np.exp(-0.375)))
    assert lagged(row, lag) == pytest.approx(5.0 * (1.0 - np.exp(-0.375)))


def wrench(
    row: Any, force: float, nu_r: Any = (0.0,) * 6, depth: float = 10.0, near: bool = False, mount: Any = None
) -> Any:
    work = np.zeros(SCRATCH["work"].shape)
    work[NU_R], work[UP, :3] = nu_r, (0.0, 0.0, -1.0)
    work[EXTRA, :3] = (0.0, 0.0, 0.0) if mount is None else mount
    return thrust(row, force, depth, near, mount is not None, work) * row["per_force"]


def test_the_wrench_is_the_force_at_its_mount() -> None:
    np.testing.assert_allclose(wrench(thruster(), 10.0), [10.0, 0.0, 0.0, 0.0, 0.0, -2.0])


def test_the_reaction_of_the_screw_is_about_its_axis() -> None:
    row = thruster_row(replace(PARAMS, torque_per_force=0.03), 0, 0)[0]
    np.testing.assert_allclose(wrench(row, 10.0), [10.0, 0.0, 0.0, 0.3, 0.0, -2.0])


@pytest.mark.parametrize("force", [16.0, -16.0])
def test_inflow_takes_from_a_thrust_ahead_and_adds_astern(force: float) -> None:
    """k sqrt(|T0|) V_a, with the speed of the mount: surge, and yaw times its arm to starboard."""
    row = thruster(inflow=2.0)
    va = 0.5 - 0.2 * 1.5
    found = wrench(row, force, (0.5, 9.0, 9.0, 9.0, 0.0, 1.5))
    assert found[0] == pytest.approx(force - 2.0 * 4.0 * va)


def test_a_disc_half_out_of_the_water_has_half_its_thrust() -> None:
    assert wrench(thruster(), 10.0, depth=0.0, near=True)[0] == pytest.approx(5.0)
    assert wrench(thruster(), 10.0, depth=1.0, near=True)[0] == pytest.approx(10.0)
    assert wrench(thruster(), 10.0, depth=-1.0, near=True)[0] == 0.0
    assert wrench(thruster(), 10.0, depth=-1.0, near=False)[0] == pytest.approx(10.0)


def test_no_force_asks_for_nothing() -> None:
    np.testing.assert_array_equal(wrench(thruster(inflow=2.0), 0.0, (1.0,) * 6), 0.0)


@pytest.mark.parametrize("force", [16.0, 1e-6, -16.0])
def test_inflow_takes_the_whole_thrust_at_most_and_gives_twice_of_it(force: float) -> None:
    """However fast the water: what a stopped propeller drags is of the hull's damping, or of `drag`."""
    row = thruster(inflow=2.0)
    with_it, against = (wrench(row, force, (np.sign(force) * speed, *[0.0] * 5))[0] for speed in (50.0, -50.0))
    assert with_it == 0.0
    assert against == pytest.approx(MOST_INFLOW * force)
    slow = wrench(row, force, (np.copysign(1e-5, force), *[0.0] * 5))[0]
    assert 0.0 < slow / force < 1.0


def test_thrust_falls_with_the_inflow_and_nowhere_jumps() -> None:
    row = thruster(inflow=2.0, drag=3.0)
    speeds = np.linspace(-4.0, 4.0, 801)
    for force in (16.0, 0.5, 0.0, -0.5, -16.0):
        along = np.array([wrench(row, force, (u, *[0.0] * 5))[0] for u in speeds])
        assert (np.diff(along) <= 1e-12).all()
        assert np.abs(np.diff(along)).max() < 0.01 * (2.0 * np.sqrt(abs(force)) + 2.0 * 3.0 * 4.0) + 1e-9
    forces = np.linspace(-1.0, 1.0, 801)
    for u in (-1.5, 1.5):
        along = np.array([wrench(row, force, (u, *[0.0] * 5))[0] for force in forces])
        assert (np.diff(along) >= -1e-12).all()
        assert np.abs(np.diff(along)).max() < 0.02


@pytest.mark.parametrize("u", [1.5, -1.5])
def test_a_stopped_one_drags_by_the_square_of_the_speed_along_its_axis(u: float) -> None:
    """Also where the mount moves as the body turns; and no longer than it is in the water."""
    row = thruster(drag=3.0)
    found = wrench(row, 0.0, (u, 9.0, 9.0, 9.0, 9.0, 0.0))
    np.testing.assert_allclose(found, [-3.0 * u * abs(u), 0.0, 0.0, 0.0, 0.0, 0.2 * 3.0 * u * abs(u)])
    assert wrench(row, 0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 2.0))[0] == pytest.approx(3.0 * 0.4**2)
    assert wrench(row, 0.0, (u, *[0.0] * 5), depth=-1.0, near=True)[0] == 0.0


def test_a_ventilating_propeller_loses_thrust_before_it_comes_out() -> None:
    """The curve joins 1 at 1.3 radii and 0 at half a radius above the water; at the surface a third is left (Smogeli 2006)."""
    np.testing.assert_allclose([ventilated(h) for h in (2.0, 1.3, 0.0, -0.6)], [1.0, 1.0, 0.325, 0.0], atol=1e-4)
    assert ventilated(1.2999) == pytest.approx(1.0, abs=1e-3)
    assert ventilated(0.5) == pytest.approx(1.0 - 0.675 * (1.0 - 0.769 * 0.5) ** 1.258)
    falling = [ventilated(h) for h in np.linspace(1.4, -0.5, 50)]
    assert all(a >= b for a, b in pairwise(falling))
    for row, part in ((thruster(), 1.0), (thruster(ventilates=1), ventilated(1.0))):
        assert wrench(row, 10.0, depth=0.05, near=True)[0] == pytest.approx(10.0 * part)


def test_only_a_thruster_that_ventilates_reaches_beyond_its_disc() -> None:
    assert replace(PARAMS, ventilates=True).reach - PARAMS.reach == pytest.approx(0.3 * PARAMS.disc_radius)


def test_a_stream_across_the_axis_takes_thrust() -> None:
    """exp(-c V_t^2), at the mount; along the axis it takes none."""
    row = thruster(cross_loss=0.4)
    assert wrench(row, 10.0, (3.0, 0.0, 0.0, 0.0, 0.0, 0.0))[0] == pytest.approx(10.0)
    # yawing at 0.5 rad/s moves the mount (0.1, 0.2, 0) by (-0.1, 0.05)
    moving = (1.0, 2.0, 0.5, 0.0, 0.0, 0.5)
    assert wrench(row, 10.0, moving)[0] == pytest.approx(10.0 * np.exp(-0.4 * (2.05**2 + 0.5**2)))
    assert wrench(thruster(), 10.0, moving)[0] == 10.0


def test_the_velocity_of_the_mount_counts_where_it_is_given() -> None:
    """Along a hull in waves the water differs from place to place."""
    row, elsewhere = thruster(inflow=1.0, cross_loss=0.4), (9.0,) * 6
    expected = 10.0 * np.exp(-0.4 * 0.25)
    expected -= np.sqrt(expected) * 0.7
    assert wrench(row, 10.0, elsewhere, mount=(0.7, 0.3, 0.4))[0] == pytest.approx(expected)
