"""The Wageningen B4-70 in four quadrants against other publications of it, and against what no propeller can do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.dynamics.appendage_params import quadrant_coefficients
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.vehicle.wageningen import b4_70

PITCH_RATIOS = (0.5, 0.65, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4)
LAMMEREN = """
0.0254 0 0.0025 0, 0.1782 -0.7478 0.0267 -0.1108, 0.0147 -0.0138 0.0016 0.0002, 0.0281 0.1008 0.0066 0.0165, -0.0163 -0.0113 -0.0022 -0.0021,
-0.0530 0.0472 -0.0078 0.0085, 0.0006 0.0107 0.0002 0.0009, 0.0368 -0.0090 0.0061 -0.0031, -0.0025 -0.0078 -0.0016 -0.0010,
-0.0177 0.0239 -0.0033 0.0043, 0.0027 0.0081 0.0012 0.0012, 0.0214 -0.0001 0.0031 0.0001, -0.0025 -0.0032 -0.0013 -0.0008,
0.0012 0.0093 0.0014 0.0015, 0.0051 0.0016 0.0009 0.0002, 0.0078 -0.0066 0.0001 -0.0017, -0.0038 -0.0006 -0.0008 0.0005,
0.0035 0.0051 0.0013 0.0012, 0.0053 -0.0006 0.0012 -0.0005, 0.0022 -0.0082 -0.0001 -0.0015, -0.0028 -0.0006 -0.0007 0.0002
"""
"""van Lammeren, van Manen and Oosterveld (1969), B4-70, P/D = 1: A_T, B_T, A_Q, B_Q of k = 0 .. 20."""
OPEN_WATER = {
    0.5: ([0.1990, 0.1379, 0.0623], [0.0179, 0.0139, 0.0088]),
    0.8: ([0.3542, 0.2906, 0.2123, 0.1234], [0.0434, 0.0368, 0.0285, 0.0188]),
    1.0: ([0.4547, 0.3919, 0.3142, 0.2256, 0.1297], [0.0675, 0.0594, 0.0492, 0.0373, 0.0240]),
    1.2: ([0.5455, 0.4862, 0.4115, 0.3251, 0.2310], [0.0963, 0.0869, 0.0751, 0.0612, 0.0458]),
    1.4: ([0.6244, 0.5717, 0.5025, 0.4206, 0.3299], [0.1283, 0.1179, 0.1048, 0.0895, 0.0723]),
}
"""Pitch ratio: K_T and K_Q at J = 0, 0.2, .. of the B-series polynomials for 4 blades and area ratio 0.7; Oosterveld and van Oossanen (1975)."""

AHEAD, STOPPED, ASTERN = 0.0, 0.5 * math.pi, math.pi


def coefficients(pitch_ratio: float, beta: FloatArray | list[float]) -> FloatArray:
    """C_T* and C_Q* (2, n)."""
    return quadrant_coefficients(b4_70(pitch_ratio), np.array(beta))


def open_water(pitch_ratio: float, J: FloatArray) -> FloatArray:
    """K_T and K_Q (2, n)."""
    return math.pi / 8.0 * (J**2 + (0.7 * math.pi) ** 2) * coefficients(pitch_ratio, np.arctan2(J, 0.7 * math.pi))


def test_all_quadrants_are_those_of_the_first_publication() -> None:
    series = np.array([row.split() for row in LAMMEREN.split(",")], float)
    beta = np.linspace(-math.pi, math.pi, 73)
    thrust, torque = np.abs(quadrant_coefficients(tuple(map(tuple, series.tolist())), beta) - coefficients(1.0, beta))
    assert thrust.max() < 0.025
    assert thrust.mean() < 0.006
    assert torque.max() < 0.008


@pytest.mark.parametrize("pitch_ratio", OPEN_WATER)
def test_the_first_quadrant_is_the_open_water_curve_of_the_series(pitch_ratio: float) -> None:
    expected = np.array(OPEN_WATER[pitch_ratio])
    found = open_water(pitch_ratio, 0.2 * np.arange(expected.shape[1]))
    assert np.abs(found - expected)[0].max() < (0.012 if pitch_ratio <= 1.0 else 0.04)
    assert np.abs(found - expected)[1].max() < 0.003


def test_between_two_pitch_ratios_it_is_what_was_measured_there() -> None:
    """Of 0.8 and 1.2 the mean, against 1.0."""
    beta = np.linspace(-math.pi, math.pi, 73)
    between = 0.5 * (coefficients(0.8, beta) + coefficients(1.2, beta))
    assert np.abs(between - coefficients(1.0, beta))[0].max() < 0.07
    np.testing.assert_allclose(
        0.5 * (coefficients(0.8, beta) + coefficients(1.0, beta)), coefficients(0.9, beta), atol=1e-12
    )


def test_each_term_has_four_coefficients_and_is_finite() -> None:
    for pitch_ratio in PITCH_RATIOS:
        series = np.array(b4_70(pitch_ratio))
        assert series.shape == (31, 4)
        assert np.isfinite(series).all()
        assert np.abs(series[:, :2]).max() < 1.0


@pytest.mark.parametrize("pitch_ratio", PITCH_RATIOS)
def test_signs_in_the_four_quadrants(pitch_ratio: float) -> None:
    """Ahead it pushes and takes torque; stopped it drags; crash-back brakes harder; astern it pulls, less than ahead; crash-ahead pushes."""
    (ahead, stopped, back, astern, against), (q_ahead, q_stopped, q_back, q_astern, q_against) = coefficients(
        pitch_ratio, [AHEAD, STOPPED, 0.75 * math.pi, ASTERN, -0.25 * math.pi]
    )
    assert ahead > 0.0 > astern > -ahead
    assert q_ahead > 0.0 > q_astern
    assert stopped < 0.0
    assert q_stopped < 0.0  # the water would turn it ahead
    assert back < astern
    assert q_back < 0.0
    assert against > ahead
    assert q_against > 0.0


@pytest.mark.parametrize("pitch_ratio", PITCH_RATIOS)
def test_a_stopped_one_drags_as_a_disc_of_its_blades(pitch_ratio: float) -> None:
    """Blades cover 0.7 of the disc and stand slanted: 0.6 to 0.95 of the dynamic pressure on the disc, in both directions."""
    ahead, backward = coefficients(pitch_ratio, [STOPPED, -STOPPED])[0]
    assert -0.95 < ahead < -0.6
    assert 0.55 < backward < 0.95


@pytest.mark.parametrize("pitch_ratio", PITCH_RATIOS)
def test_without_thrust_the_advance_is_about_the_pitch(pitch_ratio: float) -> None:
    J = np.linspace(0.0, 2.0, 201)
    assert J[np.argmax(open_water(pitch_ratio, J)[0] < 0.0)] == pytest.approx(pitch_ratio + 0.06, abs=0.08)


@pytest.mark.parametrize("pitch_ratio", PITCH_RATIOS)
def test_no_quadrant_gives_more_power_than_it_takes(pitch_ratio: float) -> None:
    """Q 2 pi n - T V_a is what is lost in the water, also of a windmill: with V_t = 0.7 pi n D it goes as C_Q* cos / 0.35 - C_T* sin."""
    beta = np.linspace(-math.pi, math.pi, 1441)
    thrust, torque = coefficients(pitch_ratio, beta)
    assert (np.cos(beta) / 0.35 * torque - np.sin(beta) * thrust).min() > 0.0
