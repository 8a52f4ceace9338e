"""Practical salinity and conductivity against gsw, which has the same formulas, and against each other."""

from __future__ import annotations

import gsw
import numpy as np
import pytest

from uwserver.environment.salinity import STANDARD, conductivity_of, practical_salinity
from uwserver.physics.kernel.compiled import entry

salinity_in, conductivity_in = practical_salinity.made(), conductivity_of.made()


@entry
def each(salinity, conductivity, temperature, pressure, out):
    """Salinity of each conductivity, and conductivity of each salinity."""
    for k in range(len(out)):
        out[k, 0] = salinity_in(conductivity[k], temperature[k], pressure[k])
        out[k, 1] = conductivity_in(salinity[k], temperature[k], pressure[k])


def both(salinity, conductivity, temperature, pressure):
    out = np.empty((len(salinity), 2))
    each(salinity, conductivity, temperature, pressure, out)
    return out.T


def waters(low, high, coldest=-2.0, warmest=40.0, n=20_000):
    """Salinities, temperatures (degC) and sea pressures (dbar), the corners among them."""
    rng = np.random.default_rng(7)
    lowest, highest = np.array([low, coldest, 0.0]), np.array([high, warmest, 1e4])
    corners = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T
    return (lowest + np.concatenate([rng.random((n, 3)), corners]) * (highest - lowest)).T


@pytest.mark.parametrize(("low", "high"), [(2.0, 42.0), (0.01, 2.0), (1.99, 2.01), (42.0, 60.0)])
def test_salinity_is_that_of_gsw(low, high):
    salinity, t, p = waters(low, high)
    conductivity = 0.1 * gsw.C_from_SP(salinity, t, p)
    found, _ = both(salinity, conductivity, t, p)
    np.testing.assert_allclose(found, gsw.SP_from_C(10.0 * conductivity, t, p), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize(
    ("low", "high", "within"), [(2.01, 42.0, 1e-12), (0.01, 1.99, 1e-12), (0.0, 0.01, 5e-11), (1.99, 2.01, 1e-11)]
)
def test_conductivity_is_that_of_gsw(low, high, within):
    """For what the first guess of gsw was made, from which it goes a step and a half; that ends short of the root near 0 and the bend at 2."""
    salinity, t, p = waters(low, high, warmest=35.0)
    _, found = both(salinity, np.zeros(len(salinity)), t, p)
    np.testing.assert_allclose(found, 0.1 * gsw.C_from_SP(salinity, t, p), rtol=within, atol=0.0)


@pytest.mark.parametrize(("low", "high"), [(2.0, 42.0), (0.01, 2.0), (0.0, 0.01), (42.0, 60.0)])
def test_one_is_the_inverse_of_the_other(low, high):
    salinity, t, p = waters(low, high)
    _, conductivity = both(salinity, np.zeros(len(salinity)), t, p)
    back, _ = both(salinity, conductivity, t, p)
    np.testing.assert_allclose(back, salinity, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("temperature", [-2.0, 0.0, 15.0, 40.0])
def test_both_scales_meet_at_2(temperature):
    conductivity = conductivity_of(2.0, temperature, 100.0)
    below, above = (practical_salinity(conductivity * (1.0 + e), temperature, 100.0) for e in (-1e-12, 1e-12))
    assert below == pytest.approx(2.0, abs=1e-11)
    assert above == pytest.approx(2.0, abs=1e-11)
    assert below < above


@pytest.mark.parametrize(
    ("ratio", "t", "p", "salinity"),
    [(1.0, 15.0, 0.0, 35.0), (1.2, 20.0, 2000.0, 37.245628), (0.65, 5.0, 1500.0, 27.995347)],
)
def test_practical_salinity_gives_the_check_values_of_unesco(ratio, t, p, salinity):
    """Technical Paper 44 (1983); its temperatures are those of IPTS-68."""
    assert practical_salinity(STANDARD * ratio, t / 1.00024, p) == pytest.approx(salinity, abs=1e-6)


@pytest.mark.parametrize(
    ("conductivity", "pressure"),
    [(-1.0, 5.0), (-1e-9, 0.0), (0.0, 5.0), (1e-6, 1e4), (1e-5, -10.0), (3.0, -1e5)],
)
def test_what_conducts_less_than_fresh_water_or_is_no_water_has_no_salinity(conductivity, pressure):
    assert np.nan_to_num(gsw.SP_from_C(10.0 * conductivity, 12.0, pressure)) == 0.0
    assert practical_salinity(conductivity, 12.0, pressure) == 0.0
