"""Beams of a line array against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging import array
from uwserver.sensors.acoustic.imaging.array import Taper

FIRST_SIDE_LOBE: dict[Taper, float] = {"none": -13.26, "cosine": -23.0}
"""dB, of long arrays (Harris 1978, "On the use of windows", table 1)."""


def half_power(angles: np.ndarray, power: np.ndarray) -> float:
    above = angles[power >= 0.5 * power.max()]
    return float(above[-1] - above[0])


@pytest.mark.parametrize("taper", ["none", "cosine", "hamming"])
@pytest.mark.parametrize("width_deg", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("at_deg", [0.0, 40.0])
def test_width_between_half_power_points(taper: Taper, width_deg: float, at_deg: float) -> None:
    """Ahead as asked for, elsewhere 1 / cos wider; elements are whole, so that it is not exact."""
    width, at = math.radians(width_deg), math.radians(at_deg)
    weight = array.weights(taper, array.elements(taper, width))
    angles = at + np.linspace(-3.0, 3.0, 6001) * width
    power = array.pattern(weight, np.array([at]), angles)[0] ** 2
    assert half_power(angles, power) == pytest.approx(width / math.cos(at), rel=0.02)


@pytest.mark.parametrize("taper", ["none", "cosine"])
def test_first_side_lobe(taper: Taper) -> None:
    weight = array.weights(taper, 100)
    power = array.pattern(weight, np.zeros(1), np.arcsin(np.linspace(0.0, 0.5, 20001)))[0] ** 2
    rises = np.flatnonzero(np.diff(power) > 0.0)
    assert 10.0 * np.log10(power[rises[0] :].max()) == pytest.approx(FIRST_SIDE_LOBE[taper], abs=0.3)


def test_all_side_lobes_of_hamming_are_below_42_db() -> None:
    weight = array.weights("hamming", 150)
    off = np.linspace(0.0, 1.0, 40001)
    power = array.response(weight, off) ** 2
    outside = power[off > 4.0 / 150]
    assert 10.0 * np.log10(outside.max()) == pytest.approx(-42.7, abs=0.5)


@pytest.mark.parametrize("elements", [2, 3, 64, 65])
def test_response_is_the_sum_over_the_elements(elements: int) -> None:
    weight = array.weights("hamming", elements)
    off = np.linspace(-1.5, 1.5, 31)
    place = np.arange(elements) - 0.5 * (elements - 1)
    summed = (weight[:, None] * np.exp(1j * math.pi * place[:, None] * off[None, :])).sum(axis=0)
    assert np.allclose(array.response(weight, off), summed.real, atol=1e-12)
    assert np.allclose(summed.imag, 0.0, atol=1e-12)


def test_absurd_widths_are_bounded() -> None:
    assert array.elements("none", 3.0) == 2
    assert array.elements("hamming", 1e-9) == array.MOST_ELEMENTS
