"""Lamps: all their light within the half space, cones, and the veil that water sends back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.optical.camera.lamps import LAMP, RANGES, candelas, exponent_of, veil_of


@pytest.mark.parametrize("cone", [0.3, 1.2, 2.36])
def test_all_lumens_go_into_the_half_space_and_half_the_intensity_is_at_the_cone(cone: float) -> None:
    m = exponent_of(cone)
    assert math.cos(0.5 * cone) ** m == pytest.approx(0.5)
    angles = np.linspace(0.0, 0.5 * math.pi, 20001)
    power = 2.0 * math.pi * candelas(1500.0, m) * np.trapezoid(np.cos(angles) ** m * np.sin(angles), angles)
    assert power == pytest.approx(1500.0, rel=1e-3)


def veil(offset: float, scattering: float) -> np.ndarray:
    lamps = np.zeros(1, LAMP)
    lamps["p"], lamps["axis"], lamps["candela"], lamps["exponent"] = (0.0, offset, 0.0), (1.0, 0.0, 0.0), 500.0, 1.0
    n = 32 * 32
    origin, direction = np.zeros((n, 3), np.float32), np.tile(np.array((1.0, 0.0, 0.0), np.float32), (n, 1))
    return veil_of(lamps, (origin, direction), 32, np.full(3, 0.3), np.array((scattering, 0.1, 0.0)))


def test_the_veil_is_the_integral_of_what_is_scattered_back() -> None:
    """A ray beside a lamp, integrated finely by hand; Henyey and Greenstein with g = 0.924."""
    g, s, c = 0.924, 0.3, 0.3
    r = np.linspace(1e-4, 25.0, 400_001)
    far = np.hypot(r, 0.5)
    cosine = r / far
    turn = -cosine
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * turn) ** 1.5)
    expected = np.trapezoid(500.0 * cosine / far**2 * phase * s * np.exp(-c * (r + far)), r)
    got = veil(0.5, s)
    assert got.shape == (3, 3, len(RANGES), 3)
    assert got[1, 1, -1, 0] == pytest.approx(expected, rel=0.03)
    # In proportion to what is scattered, and growing with the range.
    assert got[1, 1, -1, 1] == pytest.approx(got[1, 1, -1, 0] / 3.0)
    assert got[1, 1, -1, 2] == 0.0
    assert (np.diff(got[1, 1, :, 0]) >= 0.0).all()


def test_a_lamp_farther_from_the_lens_makes_less_of_a_veil() -> None:
    assert veil(0.1, 0.3)[1, 1, -1, 0] > 2.0 * veil(0.6, 0.3)[1, 1, -1, 0]
