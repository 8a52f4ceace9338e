"""The tables `world` and `environment`: limits and defaults, and the density with which forces act."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from uwserver.environment.column import ConstantColumn
from uwserver.scenario.world.tables import SEA_WATER_KGPM3, Clock, Environment, WorldTable


def test_defaults() -> None:
    world = WorldTable()
    assert (world.rate_hz, world.epoch_utc, world.origin_lat_deg) == (240.0, "2026-01-01T00:00:00Z", UNSET)
    assert world.clock == Clock(mode="realtime", speed=1.0, lockstep_timeout_s=10.0, on_loss="wait")
    assert (world.clock.max_speed, world.clock.paused, world.clock.lockstep_clients) == (UNSET, False, ())


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"rate_hz": 0.5}, "rate_hz: expected a number from 1 to 10000, found 0.5"),
        ({"rate_hz": 10001}, "rate_hz: expected a number from 1 to 10000, found 10001"),
        ({"origin_lat_deg": 90}, "origin_lat_deg: expected a number from -89.9 to 89.9, found 90"),
        ({"epoch_utc": 2026}, "epoch_utc: expected a string, found 2026"),
        ({"clock": {"mode": "fast"}}, 'clock.mode: expected one of "freerun", "lockstep", "realtime", found the string "fast"'),
        ({"clock": {"speed": 0}}, "clock.speed: expected a number greater than 0, found 0"),
        ({"clock": {"lockstep_timeout_s": -1}}, "clock.lockstep_timeout_s: expected a number of at least 0, found -1"),
        ({"clock": {"lockstep_clients": [""]}}, 'clock.lockstep_clients[0]: expected a string that is not empty, found the string ""'),
        ({"clock": {"on_loss": "panic"}}, 'clock.on_loss: expected one of "continue", "pause", "wait", found the string "panic"'),
    ],
)  # fmt: skip
def test_limits(keys: dict[str, Any], line: str, tree_of, report) -> None:
    assert tree_of(keys, WorldTable).value is None
    assert report.lines == [line]


def test_defaults_are_sea_water_at_rest() -> None:
    water = Environment()
    assert (water.density, water.gravity, water.temperature_degc) == (SEA_WATER_KGPM3, 9.81, 10.0)
    assert water.atmospheric_pressure_pa == 101_325.0
    assert water.current.velocity_ned_mps == (0.0, 0.0, 0.0)
    assert water.currents == {}
    assert water.water is water.waves is UNSET


@pytest.mark.parametrize(
    ("keys", "density"),
    [
        ({"density_kgpm3": 700.0}, 700.0),
        ({"water": ConstantColumn(temperature_degc=4.0, salinity_psu=0.0)}, 999.97),
        ({"water": ConstantColumn(temperature_degc=15.0, salinity_psu=35.0)}, 1025.97),
        ({"water": ConstantColumn(hydrostatics="uniform")}, SEA_WATER_KGPM3),
        ({"water": ConstantColumn(), "density_kgpm3": 1000.0}, 1000.0),
    ],
)
def test_the_density_is_given_or_that_of_the_water_at_the_surface(keys: dict[str, Any], density: float) -> None:
    """Pure water at 4 degC and standard sea water at 15 degC, as tables have them (UNESCO 1981)."""
    assert Environment(**keys).density == pytest.approx(density, abs=0.02)


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"density_kgpm3": 499}, "density_kgpm3: expected a number from 500 to 1500, found 499"),
        ({"gravity_mps2": 31}, "gravity_mps2: expected a number from 0 to 30, found 31"),
        ({"temperature_degc": -6}, "temperature_degc: expected a number from -5 to 60, found -6"),
        ({"atmospheric_pressure_pa": -1}, "atmospheric_pressure_pa: expected a number of at least 0, found -1"),
        ({"surface_level_m": 21}, "surface_level_m: expected a number from -20 to 20, found 21"),
        ({"water": {"kind": "constant", "salinity_psu": 43}}, "water.salinity_psu: expected a number from 0 to 42, found 43"),
        ({"currents": {"a": {"kind": "profile", "depth_m": [0], "velocity_ned_mps": []}}}, "currents.a.depth_m: expected an array of at least 2 (a number each), found an array of 1"),
        ({"currents": {"a": {"kind": "gauss_markov", "sigma_ned_mps": [0, 0, -1], "tau_s": 1}}}, "currents.a.sigma_ned_mps[2]: expected a number of at least 0, found -1"),
    ],
)  # fmt: skip
def test_limits_of_the_environment(keys: dict[str, Any], line: str, tree_of, report) -> None:
    assert tree_of(keys, Environment).value is None
    assert report.lines[0] == line
