"""The kernel's own elimination against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.kernel.linear import solve


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
