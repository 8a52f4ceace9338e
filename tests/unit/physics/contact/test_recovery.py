"""What a displacement out of another body changes, and what it does not. `test_step.py` has how far it goes."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.contact.recovery import RECOVERY, SLOP, recover
from uwserver.physics.contact.solver import Constraints, set_axes, set_jacobians, set_responses
from uwserver.physics.kernel.arrays import FloatArray

DT = 0.01
POINT = np.array([[0.3, -0.2, 20.5]])


def inertia(seed: int) -> FloatArray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T + 3.0 * np.eye(6)


M = np.array([inertia(1), inertia(2)])


def bodies() -> FloatArray:
    state = np.zeros((2, 13))
    state[:, :3] = [[0.1, 0.0, 20.2], [0.5, -0.4, 20.9]]
    state[:, 3:7] = [quat_from_rpy(0.3, 0.2, 1.0), quat_from_rpy(-0.4, 0.0, 2.0)]
    state[:, 7:] = [[0.5, 0.1, -0.2, 0.3, 1.0, 0.2], [-0.3, 0.2, 0.1, 0.0, 0.4, -0.6]]
    return state


def recovered(gap: float, two: bool) -> FloatArray:
    zero, state, M_inv = np.zeros(1, np.int64), bodies(), np.linalg.inv(M)
    b = zero + (1 if two else -1)
    made = Constraints(zero, b, zero, np.array([0, 1]), np.empty((1, 3, 3)), np.zeros((1, 4, 3, 6)), np.empty((1, 2)))
    set_axes(np.array([0.0, 0.6, -0.8]), made.axes[0])
    set_jacobians(made, state, POINT, made.rows, np.empty((3, 3)))
    set_responses(made, M_inv)
    recover(made, M_inv, np.array([gap]), DT, state)
    return state


def momentum(state: FloatArray) -> FloatArray:
    """Of both bodies, linear and angular about the point, in N."""
    found = np.zeros(6)
    for x, inertia in zip(state, M, strict=True):
        R, h = np.array(matrix(x[3:7])), inertia @ x[7:]
        found[:3] += R @ h[:3]
        found[3:] += R @ h[3:] + np.cross(x[:3] - POINT[0], R @ h[:3])
    return found


@pytest.mark.parametrize("gap", [0.01, -0.5 * SLOP])
def test_what_is_no_deeper_than_the_slop_stays(gap: float) -> None:
    np.testing.assert_array_equal(recovered(gap, True), bodies())


def test_from_the_ground_a_body_is_moved_and_not_pushed() -> None:
    state = recovered(-0.02, False)
    np.testing.assert_array_equal(state[:, 7:], bodies()[:, 7:])
    np.testing.assert_array_equal(state[1], bodies()[1])
    turn = np.array(matrix(state[0, 3:7])) @ np.array(matrix(bodies()[0, 3:7])).T
    at_contact = state[0, :3] + turn @ (POINT[0] - bodies()[0, :3]) - POINT[0]
    assert at_contact @ [0.0, 0.6, -0.8] == pytest.approx(RECOVERY * (0.02 - SLOP), rel=0.01)


def test_bodies_that_touch_nothing_fixed_keep_their_momentum() -> None:
    state = recovered(-0.02, True)
    assert np.abs(state[:, :3] - bodies()[:, :3]).max() > 1e-4
    np.testing.assert_allclose(momentum(state), momentum(bodies()), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(state[:, 3:7], axis=1), 1.0, rtol=0.0, atol=1e-15)
