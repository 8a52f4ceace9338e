"""Rotations, velocities through the water and kinetic energy of rows of states."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy, rotate
from uwserver.physics.dynamics.energy import kinetic_energy, relative_velocities, rotations
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import BODY

RPY = ((0.1, -0.2, 0.3), (2.0, 0.4, -1.0), (0.0, 0.0, 0.0))


@pytest.fixture
def state() -> FloatArray:
    rows = np.random.default_rng(3).normal(size=(3, 13))
    rows[:, 3:7] = [quat_from_rpy(*angles) for angles in RPY]
    return rows


def test_rotations_turn_as_their_quaternions_do(state: FloatArray) -> None:
    v = (0.3, -0.5, 0.7)
    for R, angles in zip(rotations(state), RPY, strict=True):
        np.testing.assert_allclose(R @ v, rotate(quat_from_rpy(*angles), v), rtol=0.0, atol=1e-15)


def test_the_norm_of_a_quaternion_does_not_count(state: FloatArray) -> None:
    longer = state.copy()
    longer[:, 3:7] *= [[1e-3], [2.0], [1e5]]
    np.testing.assert_allclose(rotations(longer), rotations(state), rtol=0.0, atol=1e-14)


def test_no_rows_have_no_rotations() -> None:
    assert rotations(np.zeros((0, 13))).shape == (0, 3, 3)


def test_the_current_is_taken_from_the_linear_velocity_alone(state: FloatArray) -> None:
    current = np.array([[0.5, 0.1, 0.0]] * 3)
    nu_r = relative_velocities(state, current)
    np.testing.assert_array_equal(nu_r[:, 3:], state[:, 10:])
    for R, row, nu in zip(rotations(state), nu_r, state[:, 7:], strict=True):
        np.testing.assert_allclose(R @ (nu[:3] - row[:3]), current[0], rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(relative_velocities(state, np.zeros((3, 3))), state[:, 7:])


def test_the_body_has_the_energy_of_its_way_over_ground_and_its_water_that_through_the_water() -> None:
    bodies, state = np.zeros(2, BODY), np.zeros((2, 13))
    bodies["M_RB"], bodies["M_A"] = np.diag([4.0] * 6), np.diag([2.0] * 6)
    state[:, 3] = 1.0
    state[0, 7], state[1, 12] = 3.0, 2.0
    energy = kinetic_energy(bodies, state, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(energy, [0.5 * (4.0 * 9.0 + 2.0 * 4.0), 0.5 * 6.0 * 4.0])


def test_coupled_inertia_counts_twice() -> None:
    bodies, state = np.zeros(1, BODY), np.zeros((1, 13))
    M = np.zeros((6, 6))
    M[1, 5] = M[5, 1] = 0.7
    bodies["M_A"] = M
    state[0, 3] = 1.0
    state[0, 8], state[0, 12] = 2.0, 3.0
    assert kinetic_energy(bodies, state, np.zeros((1, 3)))[0] == pytest.approx(0.7 * 2.0 * 3.0)
