"""CTD: exact when ideal, salinity, lags, air, and the statistics of their errors."""

from __future__ import annotations

import math

import gsw
import numpy as np
import pytest
from sensor_rig import (
    SEA,
    at,
    started,
)

from uwserver.environment.column import ConstantColumn, TableColumn, WaterColumn
from uwserver.environment.water import Water
from uwserver.sensors import (
    CtdConfig,
    Pose,
)


@pytest.mark.parametrize("z", [1.0, 13.7, 19.0, 500.0])
def test_an_ideal_one_equals_the_truth(scope, z):
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, z), water=SEA)
    ctd = CtdConfig(rate_hz=16, ideal=True, temperature_lag_s=9.0, temperature_accuracy_degc=1.0)
    conductivity, temperature, pressure, salinity = started(ctd, mount=Pose()).sense(instant).values
    assert temperature == SEA.temperature_at(z)
    assert pressure == SEA.pressure((0.0, 0.0, z), 0.0)
    assert salinity == pytest.approx(SEA.salinity_at(z), abs=1e-9)
    sea = (pressure - SEA.atmospheric_pressure) / 1e4
    assert conductivity == pytest.approx(0.1 * gsw.C_from_SP(SEA.salinity_at(z), temperature, sea), abs=1e-9)


def expected(water, depths, config):
    """What a CTD without random errors tells at one depth (m) after the other, by gsw and in plain Python."""
    told, t, c = [], None, None
    for z in depths:
        pressure = water.pressure((0.0, 0.0, z), 0.0)
        sea = (pressure - water.atmospheric_pressure) / 1e4
        t_now, c_now = water.temperature_at(z), 0.1 * gsw.C_from_SP(water.salinity_at(z), water.temperature_at(z), sea)
        if t is None:
            t, c = t_now, c_now
        else:
            t += (t_now - t) * (1.0 - math.exp(-1.0 / config.rate_hz / config.temperature_lag_s))
            c += (c_now - c) * (1.0 - math.exp(-1.0 / config.rate_hz / config.conductivity_lag_s))
        told.append((c, t, pressure, gsw.SP_from_C(10.0 * c, t, sea)))
    return np.array(told)


def test_without_errors_it_is_what_gsw_gives_of_lagged_water(scope):
    config = CtdConfig(rate_hz=16, temperature_lag_s=0.5, conductivity_lag_s=0.05)
    depths = np.linspace(2.0, 25.0, 60).tolist()
    ctd = started(config, mount=Pose())
    found = [ctd.sense(at(scope, k / 16, p_NB=(0.0, 0.0, z), water=SEA)).values for k, z in enumerate(depths)]
    np.testing.assert_allclose(found, expected(SEA, depths, config), rtol=1e-12, atol=0.0)


def test_out_of_the_air_it_begins_anew(scope):
    """What it had before is no part of what it tells."""
    config = CtdConfig(rate_hz=16, temperature_lag_s=5.0, conductivity_lag_s=5.0)
    ctd = started(config, mount=Pose())
    for z in (30.0, -2.0):
        ctd.sense(at(scope, 0.0, p_NB=(0.0, 0.0, z), water=SEA))
    assert ctd.memory.wet == 0
    assert ctd.sense(at(scope, 0.0, p_NB=(0.0, 0.0, 5.0), water=SEA)).values[1] == SEA.temperature_at(5.0)
    assert ctd.memory.wet == 1


def test_fresh_water_does_not_conduct(scope):
    fresh = Water(
        1000.0,
        9.81,
        12.0,
        101_325.0,
        (0.0, 0.0, 0.0),
        given=WaterColumn(ConstantColumn(salinity_psu=0.0), 9.81, 1000.0),
    )
    conductivity, _, _, salinity = started(CtdConfig(rate_hz=16)).sense(at(scope, 0.0, water=fresh)).values
    assert (conductivity, salinity) == pytest.approx((0.0, 0.0), abs=1e-15)


def test_lags_make_a_spike_of_salinity(scope):
    """Falling through a thermocline with a thermistor slower than the cell: temperature reads too warm, salinity too fresh."""
    fast = TableColumn(depth_m=(0.0, 10.0, 12.0, 50.0), temperature_degc=(18, 18, 8, 8), salinity_psu=(34, 34, 34, 34))
    water = Water(1025.0, 9.81, 18.0, 101_325.0, (0, 0, 0), given=WaterColumn(fast, 9.81, 1025.0))
    ctd = started(CtdConfig(rate_hz=16, temperature_lag_s=0.5, conductivity_lag_s=0.05), mount=Pose())
    salinity = [ctd.sense(at(scope, k / 16, p_NB=(0.0, 0.0, 9.0 + k / 16), water=water)).values[3] for k in range(160)]
    assert min(salinity) < 33.0
    assert salinity[0] == pytest.approx(34.0, abs=1e-3)
    assert salinity[-1] == pytest.approx(34.0, abs=0.01)


def test_in_air_there_is_no_water_to_measure(scope):
    assert not started(CtdConfig(rate_hz=16)).sense(at(scope, 0.0, p_NB=(0.0, 0.0, -2.0))).valid


def test_ctd_statistics(scope):
    config = CtdConfig(rate_hz=16, temperature_accuracy_degc=0.01, temperature_sigma_degc=0.002, pressure_sigma_Pa=50.0)
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, 5.0), water=SEA)
    biases, spread = [], []
    for seed in range(400, 800):
        ctd = started(config, seed, mount=Pose())
        values = np.array([ctd.sense(instant).values for _ in range(50)])
        biases.append(values[:, 1].mean() - 18.0)
        spread.append(values.var(axis=0, ddof=1))
    assert np.std(biases) == pytest.approx(0.01, rel=0.08)
    assert np.sqrt(np.mean(spread, axis=0))[[1, 2]] == pytest.approx([0.002, 50.0], rel=0.03)
