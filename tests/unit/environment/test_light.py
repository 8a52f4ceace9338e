"""What waters do with light: the table keeps what the types mean, and physics that no water breaks."""

from __future__ import annotations

from itertools import pairwise
from typing import get_args

import pytest

from uwserver.environment.light import WATER_TYPES, WaterType

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
