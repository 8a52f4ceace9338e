"""What waters do with light: the table keeps what the types mean, and physics that no water breaks."""

from __future__ import annotations

from itertools import pairwise
from typing import get_args

import numpy as np
import pytest

from uwserver.environment.light import ASYMMETRY, WATER_TYPES, WaterType

OPEN, COASTAL = ("I", "IA", "IB", "II", "III"), ("1C", "3C", "5C", "7C", "9C")


def test_every_type_is_there() -> None:
    assert tuple(WATER_TYPES) == get_args(WaterType) == (*OPEN, *COASTAL)


@pytest.mark.parametrize("name", WATER_TYPES)
def test_a_beam_fades_faster_than_daylight_and_is_not_only_scattered(name: WaterType) -> None:
    """c >= K_d, as daylight keeps what is scattered forward; a = c - b > 0. In the clearest water they are equal but for the rounding."""
    light = WATER_TYPES[name]
    for c, b, k in zip(*light, strict=True):
        assert c > b > 0.0
        assert c > 0.65 * k


@pytest.mark.parametrize("types", [OPEN, COASTAL])
def test_each_type_is_murkier_than_the_one_before(types: tuple[WaterType, ...]) -> None:
    for clear, murky in pairwise(types):
        for less, more in zip(WATER_TYPES[clear], WATER_TYPES[murky], strict=True):
            assert all(a < b for a, b in zip(less, more, strict=True) if a != b)


def test_the_open_sea_is_blue_and_the_coast_is_green() -> None:
    for name in OPEN[:4]:
        red, green, blue = WATER_TYPES[name].veil()
        assert red < green < blue == 1.0
    for name in COASTAL[1:]:
        red, green, blue = WATER_TYPES[name].veil()
        assert green == 1.0 > max(red, blue)


def arriving(a: float, b: float, far: float, photons: int = 40_000) -> float:
    """Part of the light of a lamp in all directions that goes out through a sphere about it, photon by photon."""
    rng, g = np.random.default_rng(1), ASYMMETRY
    p, d, weight, out = np.zeros((photons, 3)), rng.normal(size=(photons, 3)), np.ones(photons), 0.0
    d /= np.linalg.norm(d, axis=1)[:, None]
    while len(weight):
        free = rng.exponential(1.0 / b, len(weight))
        along = (p * d).sum(1)
        square = along * along - (p * p).sum(1) + far * far
        leaves = -along + np.sqrt(np.maximum(square, 0.0))
        crosses = (square > 0.0) & (leaves > 0.0) & (leaves < free)
        out += float((weight[crosses] * np.exp(-a * leaves[crosses])).sum())
        p, weight = p + free[:, None] * d, weight * np.exp(-a * free)
        kept = (weight > 1e-3) & ((p * p).sum(1) < (3.0 * far) ** 2)
        p, d, weight = p[kept], d[kept], weight[kept]
        x, turn = rng.random(len(weight)), rng.uniform(0.0, 2.0 * np.pi, len(weight))
        mu = (1.0 + g * g - ((1.0 - g * g) / (1.0 - g + 2.0 * g * x)) ** 2) / (2.0 * g)
        u = np.cross(d, np.where(np.abs(d[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
        u /= np.linalg.norm(u, axis=1)[:, None]
        side = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(d, u)
        d = np.sqrt(1.0 - mu * mu)[:, None] * side + mu[:, None] * d
    return out / photons


@pytest.mark.parametrize("name", ["II", "1C"])
def test_light_of_a_lamp_that_is_scattered_forward_still_arrives(name: WaterType) -> None:
    light = WATER_TYPES[name]
    c, b = light.attenuation[1], light.scattering[1]
    assert np.exp(-3.0 * light.dimming()[1]) == pytest.approx(arriving(c - b, b, 3.0), rel=0.12)
