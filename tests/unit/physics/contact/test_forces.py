"""What holds, as a force on both bodies over the tick."""

from __future__ import annotations

import numpy as np

from uwserver.physics.contact.forces import apply_forces, clear_contact
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
