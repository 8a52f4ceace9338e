"""Impulses as a change of velocity or as a force over the tick."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.contact.forces import Struck, apply_impulses, clear_contact
from uwserver.physics.contact.solver import Constraints, add_response, set_axes, set_jacobians, set_responses
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import BODY

DT = 0.01
POINT = np.array([[0.3, -0.2, 0.5]])


@pytest.fixture
def state() -> FloatArray:
    """Of five bodies, of which rows 3 and 1 touch."""
    rows = np.random.default_rng(21).normal(size=(5, 13))
    rows[:, 3:7] = [quat_from_rpy(*angles) for angles in np.random.default_rng(22).uniform(-1.0, 1.0, (5, 3))]
    return rows


def struck_of(state: FloatArray, impulse: tuple[float, float, float], bounced: bool, two: bool = True) -> Struck:
    constraints = Constraints(
        np.array([0]), np.array([1 if two else -1]), np.array([0]), np.array([0, 1]), np.empty((1, 3, 3)), np.zeros((1, 4, 3, 6)), np.empty((1, 2))
    )  # fmt: skip
    bodies = np.array([3, 1])
    start = state[bodies].copy()
    set_axes(np.array([0.6, 0.0, -0.8]), constraints.axes[0])
    set_jacobians(constraints, start, POINT, np.empty((3, 3)))
    M_inv = np.array([np.diag([0.5] * 6), np.diag([0.1] * 6)])
    set_responses(constraints, M_inv)
    return Struck(bodies, start, M_inv, constraints, np.array([impulse]), np.array([bounced]), np.zeros((2, 6)))


IMPULSE = (2.0, 0.3, -0.5)


def test_a_hit_that_bounces_changes_the_velocities_at_once(state: FloatArray) -> None:
    rows, before = np.zeros(5, BODY), state.copy()
    struck = struck_of(state, IMPULSE, True)
    apply_impulses(rows, struck, POINT, state, DT)
    expected = np.zeros((2, 6))
    add_response(struck.constraints.rows, 0, np.array(IMPULSE), 0, 1, expected)
    np.testing.assert_allclose(state[[3, 1], 7:] - before[[3, 1], 7:], expected, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(state[[0, 2, 4]], before[[0, 2, 4]])
    np.testing.assert_array_equal(state[:, :7], before[:, :7])
    assert not rows["in_contact"].any()


def test_what_holds_is_a_force_over_the_tick_on_both_bodies(state: FloatArray) -> None:
    rows, before = np.zeros(5, BODY), state.copy()
    struck = struck_of(state, IMPULSE, False)
    apply_impulses(rows, struck, POINT, state, DT)
    np.testing.assert_array_equal(state, before)
    assert rows["in_contact"].tolist() == [0, 1, 0, 1, 0]
    force = np.array(IMPULSE) @ struck.constraints.axes[0] / DT
    for row, sign in ((3, 1.0), (1, -1.0)):
        wrench = rows["contact"][row]
        np.testing.assert_allclose(wrench[:3], sign * force, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(wrench[3:], np.cross(POINT[0] - state[row, :3], sign * force), rtol=0.0, atol=1e-10)
        # In B it is what the Jacobian makes of the impulse.
        R, block = np.array(matrix(state[row, 3:7])), 0 if row == 3 else 1
        generalised = np.array(IMPULSE) @ struck.constraints.rows[0, block] / DT
        np.testing.assert_allclose(
            np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]]), generalised, rtol=0.0, atol=1e-10
        )


def test_the_ground_needs_no_row(state: FloatArray) -> None:
    rows = np.zeros(5, BODY)
    apply_impulses(rows, struck_of(state, IMPULSE, False, two=False), POINT, state, DT)
    assert rows["in_contact"].tolist() == [0, 0, 0, 1, 0]


def test_forces_of_several_contacts_add_up_until_they_are_cleared(state: FloatArray) -> None:
    rows = np.zeros(5, BODY)
    struck = struck_of(state, IMPULSE, False)
    apply_impulses(rows, struck, POINT, state, DT)
    once = rows["contact"].copy()
    apply_impulses(rows, struck, POINT, state, DT)
    np.testing.assert_allclose(rows["contact"], 2.0 * once, rtol=1e-14, atol=0.0)
    clear_contact(rows[3])
    assert not rows["contact"][3].any()
    assert rows["in_contact"].tolist() == [0, 1, 0, 0, 0]


def test_a_contact_without_impulse_does_nothing(state: FloatArray) -> None:
    for bounced in (False, True):
        rows, before = np.zeros(5, BODY), state.copy()
        apply_impulses(rows, struck_of(state, (0.0, 0.0, 0.0), bounced), POINT, state, DT)
        np.testing.assert_array_equal(state, before)
        assert not rows["contact"].any()
