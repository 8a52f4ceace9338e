"""CTD: exact when ideal, salinity, lags, air, and the statistics of their errors."""

from __future__ import annotations

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
from uwserver.sensors.water.ctd import practical_salinity


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


@pytest.mark.parametrize(
    ("ratio", "t", "p", "salinity"),
    [(1.0, 15.0, 0.0, 35.0), (1.2, 20.0, 2000.0, 37.245628), (0.65, 5.0, 1500.0, 27.995347)],
)
def test_practical_salinity_gives_the_check_values_of_unesco(ratio, t, p, salinity):
    """Technical Paper 44 (1983); its temperatures are those of IPTS-68, and 4.2914 S/m is the conductivity of standard sea water."""
    assert practical_salinity(4.2914 * ratio, t / 1.00024, p) == pytest.approx(salinity, abs=1e-6)


@pytest.mark.parametrize("conductivity", [-1.0, 0.0, 1e-5])
def test_what_conducts_less_than_fresh_water_has_no_salinity(conductivity):
    assert practical_salinity(conductivity, 12.0, 5.0) == pytest.approx(0.0, abs=1e-15)


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
