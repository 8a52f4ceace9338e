"""Beams of a line array against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

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
    angles = at + np.linspace(-3.0, 3.0, 6001) * width
    power = array.pattern(taper, array.elements(taper, width), np.array([at]), angles)[0] ** 2
    assert half_power(angles, power) == pytest.approx(width / math.cos(at), rel=0.02)


@pytest.mark.parametrize("taper", ["none", "cosine"])
def test_first_side_lobe(taper: Taper) -> None:
    power = array.pattern(taper, 100, np.zeros(1), np.arcsin(np.linspace(0.0, 0.5, 20001)))[0] ** 2
    rises = np.flatnonzero(np.diff(power) > 0.0)
    assert 10.0 * np.log10(power[rises[0] :].max()) == pytest.approx(FIRST_SIDE_LOBE[taper], abs=0.3)


def test_all_side_lobes_of_hamming_are_below_42_db() -> None:
    off = np.linspace(0.0, 1.0, 40001)
    power = array.response("hamming", 150, off) ** 2
    outside = power[off > 4.0 / 150]
    assert 10.0 * np.log10(outside.max()) == pytest.approx(-42.7, abs=0.5)


WEIGHTS: dict[Taper, Callable[[np.ndarray], np.ndarray]] = {
    "none": np.ones_like,
    "cosine": lambda x: np.sin(math.pi * x),
    "hamming": lambda x: 0.54 - 0.46 * np.cos(2.0 * math.pi * x),
}
"""By place in the array, from 0 to 1."""


@pytest.mark.parametrize("taper", ["none", "cosine", "hamming"])
@pytest.mark.parametrize("elements", [2, 3, 64, 65, 1001, array.MOST_ELEMENTS])
def test_response_is_the_sum_over_the_elements(taper: Taper, elements: int) -> None:
    """At all angles, those among them at which a term of the closed form is zero over zero, or nearly so."""
    weight = WEIGHTS[taper]((np.arange(elements) + 0.5) / elements)
    weight /= weight.sum()
    poles = (np.array([[-2.0], [0.0], [2.0]]) + np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / elements).ravel()
    near = [poles + by for by in (-1e-6, -1e-8, -1e-9, -1e-10, 0.0, 1e-12, 1e-9, 1e-7)]
    off = np.concatenate([np.linspace(-2.0, 2.0, 41), *near])
    place = np.arange(elements) - 0.5 * (elements - 1)
    summed = (weight[:, None] * np.exp(1j * math.pi * place[:, None] * off[None, :])).sum(axis=0)
    assert np.allclose(array.response(taper, elements, off), summed.real, rtol=0.0, atol=1e-9)
    assert np.allclose(summed.imag, 0.0, atol=1e-9)


def test_a_pattern_costs_the_same_however_long_the_array(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sines are counted: with a term for each element, a valid sonar took minutes to load."""
    counted: list[int] = []

    def counting(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def call(x: Any) -> Any:
            counted.append(np.size(x))
            return function(x)

        return call

    for name in ("sin", "cos"):
        monkeypatch.setattr(np, name, counting(getattr(np, name)))
    beams, columns = np.linspace(-1.0, 1.0, 50), np.linspace(-1.1, 1.1, 600)
    array.pattern("hamming", 2000, beams, columns)
    assert sum(counted) < 8 * 50 * 600


def test_absurd_widths_are_bounded() -> None:
    assert array.elements("none", 3.0) == 2
    assert array.elements("hamming", 1e-9) == array.MOST_ELEMENTS


@pytest.mark.parametrize("taper", ["none", "cosine", "hamming"])
@pytest.mark.parametrize("elements", [2, 3, 20, 21, 100])
def test_the_difference_of_both_halves_is_the_sum_over_the_elements(taper: Taper, elements: int) -> None:
    """Between grating lobes; with the response it gives the phase of each half."""
    place = np.arange(elements) - 0.5 * (elements - 1)
    x = np.pi * place / elements
    weight = {"none": np.ones(elements), "cosine": np.cos(x), "hamming": 0.54 + 0.46 * np.cos(2.0 * x)}[taper]
    off = np.linspace(-1.7, 1.7, 35)
    right, left = place > 0.0, place < 0.0
    waves = weight * np.exp(1j * np.pi * np.outer(off, place))
    middle = waves[:, place == 0.0].sum(axis=1) / 2.0
    both = np.stack([waves[:, half].sum(axis=1) + middle for half in (right, left)]) / weight.sum()
    assert array.response(taper, elements, off) == pytest.approx((both[0] + both[1]).real, abs=1e-9)
    assert array.difference(taper, elements, off) == pytest.approx((both[0] - both[1]).imag, abs=1e-9)
    assert array.difference(taper, elements, np.zeros(1))[0] == pytest.approx(0.0, abs=1e-12)
