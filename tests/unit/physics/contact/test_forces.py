"""Holding impulses as a force on both bodies over the tick, and how far a contact moves within it."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.contact.forces import apply_forces, clear_contact, set_drift
from uwserver.physics.contact.solver import Constraints, set_axes
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.physics.kernel.layout import BODY

T, DT = 3.0, 0.01
POINT, DRIFT, HOLD = np.array([[0.3, -0.2, 0.5]]), np.array([[0.02, 0.01, -0.03]]), np.array([[2.0, 0.3, -0.5]])
BODIES = np.array([3, 1])
"""Rows of those that touch, of five."""


def constraints_of(two: bool = True) -> Constraints:
    made = Constraints(
        np.array([0]), np.array([1 if two else -1]), np.array([0]), np.array([0, 1]), np.empty((1, 3, 3)), np.zeros((1, 4, 3, 6)), np.empty((1, 2))
    )  # fmt: skip
    set_axes(np.array([0.6, 0.0, -0.8]), made.axes[0])
    return made


def pressed(rows: Records, hold: FloatArray = HOLD, two: bool = True) -> None:
    apply_forces(rows, BODIES, constraints_of(two), POINT, DRIFT, hold, T, DT)


def test_what_holds_is_a_force_over_the_tick_on_both_bodies() -> None:
    rows = np.zeros(5, BODY)
    pressed(rows)
    assert rows["in_contact"].tolist() == [0, 1, 0, 1, 0]
    force = HOLD[0] @ constraints_of().axes[0] / DT
    for row, sign in ((3, 1.0), (1, -1.0)):
        wrench = rows["contact"][row]
        np.testing.assert_allclose(wrench[:3], sign * force, rtol=0.0, atol=1e-12)
        assert wrench[9] == T
        for lapse in (0.0, 0.5 * DT, DT):  # the point goes on, for both alike
            moment = np.cross(POINT[0] + lapse / DT * DRIFT[0], sign * force)
            np.testing.assert_allclose(wrench[3:6] + lapse * wrench[6:9], moment, rtol=0.0, atol=1e-10)


def test_the_ground_needs_no_row() -> None:
    rows = np.zeros(5, BODY)
    pressed(rows, two=False)
    assert rows["in_contact"].tolist() == [0, 0, 0, 1, 0]


def test_forces_of_several_contacts_add_up_until_they_are_cleared() -> None:
    rows = np.zeros(5, BODY)
    pressed(rows)
    once = rows["contact"].copy()
    pressed(rows)
    np.testing.assert_allclose(rows["contact"][:, :9], 2.0 * once[:, :9], rtol=1e-14, atol=0.0)
    clear_contact(rows[3])
    assert not rows["contact"][3].any()
    assert rows["in_contact"].tolist() == [0, 1, 0, 0, 0]


def test_a_contact_without_impulse_does_nothing() -> None:
    rows = np.zeros(5, BODY)
    pressed(rows, 0.0 * HOLD)
    assert not rows["contact"].any()
    assert not rows["in_contact"].any()


def bodies() -> FloatArray:
    """Two states that move and turn, within half a metre of the point."""
    state = np.zeros((2, 13))
    state[:, :3] = [[0.1, 0.0, 0.2], [0.5, -0.4, 0.9]]
    state[:, 3:7] = [quat_from_rpy(0.3, 0.2, 1.0), quat_from_rpy(-0.4, 0.0, 2.0)]
    state[:, 7:] = [[0.5, 0.1, -0.2, 0.3, 1.0, 0.2], [-0.3, 0.2, 0.1, 0.0, 0.4, -0.6]]
    return state


def way(x: FloatArray) -> FloatArray:
    """Of the origin, in N."""
    return DT * np.array(matrix(x[3:7])) @ x[7:10]


def drift_of(old_key: list[int], old_point: FloatArray, two: bool = True) -> FloatArray:
    zero, one = np.zeros(1, np.int64), np.ones(1)
    b = zero + (1 if two else -1)
    contacts = Contacts(zero, b, POINT, np.array([[0.0, 0.0, -1.0]]), 0.0 * one, zero + 7, one, one)
    constraints = Constraints(
        zero, b, zero, np.array([0, 1]), np.empty((1, 3, 3)), np.empty((1, 4, 3, 6)), np.empty((1, 2))
    )
    drift = np.full((1, 3), np.nan)
    set_drift(contacts, constraints, bodies(), np.array(old_key, np.int64), old_point, DT, np.empty((3, 3)), drift)
    return drift[0]


@pytest.mark.parametrize("two", [False, True])
def test_a_new_contact_goes_with_the_bodies_in_the_mean(two: bool) -> None:
    ways = [way(x) for x in bodies()]
    expected = 0.5 * (ways[0] + ways[1]) if two else ways[0]
    for key, point in (([], np.zeros((0, 3))), ([8, 6], POINT.repeat(2, axis=0))):
        np.testing.assert_allclose(drift_of(key, point, two), expected, rtol=0.0, atol=1e-15)


def test_a_known_contact_goes_on_as_it_went() -> None:
    """Wherever it stood among the others, and also if it stood still."""
    for went in ([0.004, -0.003, 0.002], [0.0, 0.0, 0.0]):
        old = np.array([POINT[0] + 9.0, POINT[0] - went, POINT[0] + 8.0])
        np.testing.assert_allclose(drift_of([1, 7, 2], old), went, rtol=0.0, atol=1e-15)


def test_a_contact_that_came_from_farther_than_bodies_move_is_another() -> None:
    """Or its bodies were put elsewhere."""
    new = drift_of([], np.zeros((0, 3)))
    np.testing.assert_array_equal(drift_of([7], POINT - [0.1, 0.0, 0.0]), new)
    np.testing.assert_array_equal(drift_of([7], POINT - [1e9, 0.0, 0.0]), new)
