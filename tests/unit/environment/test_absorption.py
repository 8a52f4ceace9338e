"""Absorption against values computed elsewhere and against an independent formula."""

from __future__ import annotations

import math

import pytest

from uwserver.environment.absorption import absorption

# dB/km; Francois and Garrison 1982 as two public implementations have it (SonarDocsBuilder, jfa-octave).
SEA = {10: 1.01, 25: 5.23, 115: 34.9, 375: 87, 700: 205, 750: 230, 1000: 377, 1200: 525, 2100: 1525}
LAKE = {10: 0.033, 25: 0.20, 115: 4.2, 375: 44, 700: 152, 750: 175, 1000: 311, 1200: 447, 2100: 1370}


@pytest.mark.parametrize(("kilohertz", "expected"), SEA.items())
def test_sea(kilohertz, expected):
    assert absorption(kilohertz * 1e3, 8.0, 35.0, 50.0) * 1e3 == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("kilohertz", "expected"), LAKE.items())
def test_lake(kilohertz, expected):
    assert absorption(kilohertz * 1e3, 10.0, 0.05, 50.0, 7.0) * 1e3 == pytest.approx(expected, rel=0.02)


def ainslie_mccolm(f: float, t: float, s: float, z: float, ph: float) -> float:
    """J. Acoust. Soc. Am. 103 (1998), dB/km; f in kHz, z in km. Claims 10 % of Francois and Garrison in the ranges of its validity."""
    f1 = 0.78 * math.sqrt(s / 35.0) * math.exp(t / 26.0)
    f2 = 42.0 * math.exp(t / 17.0)
    boric = 0.106 * f1 * f * f / (f1 * f1 + f * f) * math.exp((ph - 8.0) / 0.56)
    sulphate = 0.52 * (1.0 + t / 43.0) * (s / 35.0) * f2 * f * f / (f2 * f2 + f * f) * math.exp(-z / 6.0)
    return boric + sulphate + 0.00049 * f * f * math.exp(-(t / 27.0 + z / 17.0))


# Its four ranges: (pH, salinity, temperature, depth in km), each varied about standard water.
@pytest.mark.parametrize("ph", [7.7, 8.3])
@pytest.mark.parametrize("kilohertz", [1, 3, 10, 30, 100, 300, 1000])
@pytest.mark.parametrize(
    ("t", "s", "z"), [(10, 35, 0.0), (10, 35, 1.0), (-1, 35, 0.0), (20, 35, 0.0), (4, 34, 3.0), (10, 30, 0.0)]
)
def test_ainslie_and_mccolm_agree(kilohertz, t, s, z, ph):
    mine = absorption(kilohertz * 1e3, t, s, z * 1e3, ph) * 1e3
    assert mine == pytest.approx(ainslie_mccolm(kilohertz, t, s, z, ph), rel=0.10)


def test_above_the_surface_it_is_that_of_the_surface():
    assert absorption(2e5, 10.0, 35.0, -5.0) == absorption(2e5, 10.0, 35.0, 0.0)
