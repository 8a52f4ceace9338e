"""Exact transitions of a lag against closed forms, and the matrix exponential against its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.dynamics.lag import Lag, expm
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import LAG_LEVELS

DT = 0.02


def response(lag: Lag, level: int, seconds: float) -> FloatArray:
    """Output at the end of each half sub-step after a unit step, from rest."""
    F, G, C, D = lag.transition(DT)
    x, out = np.zeros(3), []
    for _ in range(round(seconds / (0.5 * DT / 2**level))):
        x = F[level] @ x + G[level]
        out.append(C @ x + D)
    return np.array(out)


@pytest.mark.parametrize("level", range(LAG_LEVELS))
@pytest.mark.parametrize("tau", [0.01, 0.2, 5.0])
def test_a_first_order_lag_is_an_exponential_at_each_number_of_sub_steps(tau: float, level: int) -> None:
    h = 0.5 * DT / 2**level
    found = response(Lag.first_order(tau), level, 0.4)
    t = h * np.arange(1, len(found) + 1)
    np.testing.assert_allclose(found, 1.0 - np.exp(-t / tau), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("tau", [0.0, -1.0])
def test_no_time_constant_is_no_lag(tau: float) -> None:
    lag = Lag.first_order(tau)
    assert lag == Lag()
    np.testing.assert_array_equal(response(lag, 0, 0.1), 1.0)


def test_a_third_order_lag_with_known_poles() -> None:
    """(s + 1)(s + 2)(s + 4) below 8: partial fractions give 1 - 8/3 e^-t + 2 e^-2t - 1/3 e^-4t."""
    lag = Lag((8.0, 0.0, 0.0), (8.0, 14.0, 7.0))
    found = response(lag, 2, 2.0)
    t = 0.5 * DT / 4 * np.arange(1, len(found) + 1)
    exact = 1.0 - 8.0 / 3.0 * np.exp(-t) + 2.0 * np.exp(-2.0 * t) - np.exp(-4.0 * t) / 3.0
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-10)


def test_zeros_of_the_numerator_lead_and_keep_the_gain_at_rest() -> None:
    """With b1 the output begins with a slope, without it with none; both end at b0 / a0."""
    denominator = (8.0, 14.0, 7.0)
    plain, leading = Lag((16.0, 0.0, 0.0), denominator), Lag((16.0, 0.0, 3.0), denominator)
    assert response(leading, 0, 0.1)[0] > 10.0 * response(plain, 0, 0.1)[0]
    for lag in (plain, leading):
        assert response(lag, 0, 30.0)[-1] == pytest.approx(2.0, rel=1e-9)


def test_two_half_sub_steps_of_a_level_are_one_of_the_level_above() -> None:
    F, G, _, _ = Lag((8.0, 1.0, 0.5), (8.0, 14.0, 7.0)).transition(DT)
    for level in range(1, LAG_LEVELS):
        np.testing.assert_allclose(F[level] @ F[level], F[level - 1], rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(F[level] @ G[level] + G[level], G[level - 1], rtol=0.0, atol=1e-13)


def test_the_exponential_of_a_turn_is_a_rotation() -> None:
    for angle in (1e-9, 0.3, 3.0, 40.0):
        c, s = math.cos(angle), math.sin(angle)
        found = expm(np.array([[0.0, -angle], [angle, 0.0]]))
        np.testing.assert_allclose(found, [[c, -s], [s, c]], rtol=0.0, atol=1e-12 * max(1.0, angle))


def test_the_exponential_of_a_nilpotent_matrix_is_its_series() -> None:
    M = np.array([[0.0, 2.0, 1.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(expm(M), np.eye(3) + M + 0.5 * M @ M, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(expm(np.zeros((4, 4))), np.eye(4))
