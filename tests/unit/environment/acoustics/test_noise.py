"""Ambient noise: values read off the formulas' sources, and wind from waves."""

from __future__ import annotations

import math

import pytest

from uwserver.environment.acoustics.noise import ambient_db, wind_of


@pytest.mark.parametrize(
    ("frequency_hz", "wind_mps", "shipping", "level"),
    [
        (100e3, 0.0, 0.0, 25.3),  # thermal, -15 + 20 lg 100 = 25 dB, and a little of calm water
        (10e3, 10.0, 0.5, 53.2),  # wind alone: 50 + 7.5 sqrt(10) + 20 - 40 lg 10.4
        (100.0, 0.0, 1.0, 77.2),  # ships alone: 40 + 10 - 26 - 60 lg 0.13
        (10.0, 0.0, 0.0, 80.4),  # turbulence 17 + 60 = 77, and ships 40 - 10 - 52 + 60 lg 25 = 61.9 ...
    ],
)
def test_levels(frequency_hz, wind_mps, shipping, level):
    if frequency_hz == 10.0:
        ships = 40.0 - 10.0 + 26.0 * -2.0 - 60.0 * math.log10(0.04)
        wind = 50.0 - 40.0 - 40.0 * math.log10(0.41)
        level = 10.0 * math.log10(10.0**7.7 + 10.0 ** (0.1 * ships) + 10.0 ** (0.1 * wind))
    assert ambient_db(frequency_hz, wind_mps, shipping) == pytest.approx(level, abs=0.35)


def test_more_wind_and_more_ships_are_louder():
    assert ambient_db(26e3, 15.0) > ambient_db(26e3, 5.0) + 5.0
    assert ambient_db(100.0, 0.0, 1.0) == pytest.approx(ambient_db(100.0, 0.0, 0.0) + 20.0, abs=1.0)


def test_wind_of_a_grown_sea():
    # A significant height of 2.1 m belongs to 10 m/s (0.21 * 100 / 9.81 = 2.14 m).
    assert wind_of(2.14 / 4.0, 9.81) == pytest.approx(10.0, abs=0.01)
    assert wind_of(0.0, 9.81) == 0.0
