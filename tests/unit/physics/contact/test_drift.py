"""How far a contact goes within a tick: as it went in the last one, or with what is round."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.contact.drift import set_drift
from uwserver.physics.contact.solver import Constraints
from uwserver.physics.kernel.arrays import FloatArray

DT = 0.01
POINT = np.array([[0.3, -0.2, 0.5]])


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
