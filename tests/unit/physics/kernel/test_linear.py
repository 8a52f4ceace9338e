"""Elimination against LAPACK, and rotations against `uwserver.frames`."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, multiply
from uwserver.physics.kernel.linear import product, rotation, solve


@pytest.mark.parametrize("columns", [1, 6])
def test_random_systems(columns):
    rng = np.random.default_rng(1)
    for _ in range(200):
        A, B = rng.normal(size=(6, 6)), rng.normal(size=(6, columns))
        X = B.copy()
        solve(A.copy(), X)
        assert np.allclose(X, np.linalg.solve(A, B), rtol=1e-9, atol=1e-9)


def test_it_needs_its_pivots():
    A = np.array([[0.0, 1.0], [1.0, 0.0]])
    X = np.array([[2.0], [3.0]])
    solve(A, X)
    assert X.ravel().tolist() == [3.0, 2.0]


def test_badly_scaled_inertia():
    A = np.diag([5e3, 5e3, 5e3, 0.1, 0.1, 0.1]) + 1e-3
    X = np.eye(6)
    solve(A.copy(), X)
    assert np.allclose(X @ A, np.eye(6), atol=1e-12)


def test_a_singular_matrix_gives_nothing_finite():
    X = np.ones((2, 1))
    with np.errstate(all="ignore"):
        solve(np.zeros((2, 2)), X)
    assert not np.isfinite(X).any()


RNG = np.random.default_rng(4)
QUATERNIONS = [tuple(q / np.linalg.norm(q)) for q in RNG.normal(size=(20, 4))]


@pytest.mark.parametrize("q", QUATERNIONS)
def test_the_matrix_is_that_of_plain_floats(q: tuple[float, ...]) -> None:
    R = np.empty((3, 3))
    rotation(*q, R)
    np.testing.assert_allclose(R, matrix(q), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0.0, atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("scale", [1e-3, 0.5, 2.0, 1e6])
def test_the_norm_of_a_quaternion_does_not_count(scale: float) -> None:
    """A stage of Runge-Kutta is never quite of unit length."""
    q, R, scaled = np.array(QUATERNIONS[0]), np.empty((3, 3)), np.empty((3, 3))
    rotation(*q, R)
    rotation(*(scale * q), scaled)
    np.testing.assert_allclose(scaled, R, rtol=0.0, atol=1e-15)


def test_a_quarter_turn_about_down_brings_ahead_to_starboard() -> None:
    R = np.empty((3, 3))
    rotation(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5), R)
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("k", range(10))
def test_the_product_is_that_of_plain_floats_bit_for_bit(k: int) -> None:
    a, b = QUATERNIONS[k], QUATERNIONS[k + 10]
    assert product(*a, *b) == multiply(a, b)


def test_the_product_does_one_rotation_after_the_other() -> None:
    a, b = QUATERNIONS[:2]
    A, B, AB = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    rotation(*a, A)
    rotation(*b, B)
    rotation(*product(*a, *b), AB)
    np.testing.assert_allclose(AB, A @ B, rtol=0.0, atol=1e-15)
