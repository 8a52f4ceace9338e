"""Currents and waves of a scenario as a body of water: what adds up, what moves, and what random numbers it takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.environment.water import Water
from uwserver.physics.kernel.layout import WAVE_AMPLITUDE, WAVE_K, WAVE_KX, WAVE_KY
from uwserver.scenario.world.sea import water_of
from uwserver.scenario.world.tables import Environment

RATE = 100.0
DRIFT = {"kind": "gauss_markov", "sigma_ned_mps": [0.2, 0.1, 0.0], "tau_s": 5.0, "interval_s": 0.1}
LAYERS = {"kind": "profile", "depth_m": [0.0, 10.0], "velocity_ned_mps": [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]}
WAVES = {"spectrum": "jonswap", "significant_height_m": 1.0, "peak_period_s": 8.0, "direction_deg": 0.0}


class Streams:
    """Random streams by path, which remembers who asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def __call__(self, path: str) -> np.random.Generator:
        self.asked.append(path)
        return np.random.default_rng(list(path.encode()))


@pytest.fixture
def streams() -> Streams:
    return Streams()


@pytest.fixture
def made(streams: Streams) -> Callable[..., Water]:
    return lambda **keys: water_of(msgspec.convert(keys, Environment), RATE, streams)


def test_still_water_has_no_sea(made, streams: Streams) -> None:
    water = made(density_kgpm3=1000, temperature_degc=4, gravity_mps2=9.8, atmospheric_pressure_pa=100_000)
    assert water.sea is None
    assert (water.density, water.temperature, water.gravity, water.atmospheric_pressure) == (1000, 4, 9.8, 100_000)
    assert water.velocity((0.0, 0.0, 5.0), 0.0) == (0.0, 0.0, 0.0)
    assert streams.asked == []


def test_uniform_currents_add_up_without_a_sea(made) -> None:
    tide = {"kind": "uniform", "velocity_ned_mps": [0.2, 0.0, 0.1]}
    wind = {"kind": "uniform", "velocity_ned_mps": [0.0, -0.3, 0.0]}
    water = made(current={"velocity_ned_mps": [1.0, 1.0, 0.0]}, currents={"tide": tide, "wind": wind})
    assert water.sea is None
    assert water.current == pytest.approx((1.2, 0.7, 0.1))


def test_profiles_become_pieces_one_after_the_other(made) -> None:
    deeper = {"kind": "profile", "depth_m": [5.0, 6.0, 7.0], "velocity_ned_mps": [[0, 1, 0], [0, 2, 0], [0, 3, 0]]}
    water = made(currents={"layers": LAYERS, "deeper": deeper})
    assert water.sea is not None
    assert len(water.sea.rows.profiles) == 3 + 4
    assert water.velocity((0.0, 0.0, 5.0), 0.0) == pytest.approx((0.5, 1.0, 0.0))
    assert water.velocity((0.0, 0.0, 99.0), 0.0) == pytest.approx((0.0, 3.0, 0.0))


def test_a_drift_takes_the_stream_of_its_path(made, streams: Streams) -> None:
    water = made(currents={"eddies": DRIFT, "more": DRIFT})
    assert streams.asked == ["environment/currents/eddies", "environment/currents/more"]
    assert water.sea is not None
    first, second = water.sea.drifts
    assert first.ticks == 10
    assert not np.array_equal(first.ends, second.ends)
    again = made(currents={"more": DRIFT})
    assert again.sea is not None
    assert np.array_equal(again.sea.drifts[0].ends, second.ends), "another drift before it must not matter"


def test_the_sea_moves_with_its_ticks(made) -> None:
    water = made(currents={"eddies": DRIFT})
    sea = water.sea
    assert sea is not None
    sea.hold(0, 0.0, water.current)
    begun = sea.rows.uniform.copy()
    sea.draw(1)
    sea.hold(1, 1.0 / RATE, water.current)
    assert sea.rows.uniform[:3] == pytest.approx(begun[:3] + begun[3:6] / RATE, abs=1e-15)


def test_waves_take_their_own_stream_and_direction(made, streams: Streams) -> None:
    north, east = (made(waves={**WAVES, "direction_deg": angle}) for angle in (0.0, 90.0))
    assert streams.asked == ["environment/waves"] * 2
    assert north.sea is not None
    assert east.sea is not None
    assert len(north.sea.rows.waves) == len(east.sea.rows.waves) > 10
    k, kx, ky = (north.sea.rows.waves[:, i] for i in (WAVE_K, WAVE_KX, WAVE_KY))
    assert kx == pytest.approx(k)
    assert ky == pytest.approx(np.zeros(len(k)), abs=1e-12)
    assert east.sea.rows.waves[:, WAVE_KY] == pytest.approx(east.sea.rows.waves[:, WAVE_K])


def test_the_significant_height_is_that_of_the_table(made) -> None:
    """Hs is four standard deviations of the surface, sqrt of half the sum of squared amplitudes."""
    water = made(waves=WAVES)
    assert water.sea is not None
    amplitudes = water.sea.rows.waves[:, WAVE_AMPLITUDE]
    assert 4.0 * np.sqrt(0.5 * (amplitudes**2).sum()) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("level", [1.5, -2.0])
def test_the_tide_lifts_surface_and_pressure_everywhere(made, level: float) -> None:
    still, high = made(density_kgpm3=1000), made(density_kgpm3=1000, surface_level_m=level)
    for place in ((0.0, 0.0, 10.0), (5000.0, -700.0, 10.0)):
        assert high.elevation(place[0], place[1], 3.0) == pytest.approx(level, abs=1e-6)
        more = high.pressure(place, 3.0) - still.pressure(place, 3.0)
        assert more == pytest.approx(1000 * 9.81 * level, rel=1e-3)
    assert high.velocity((0.0, 0.0, 1.0), 0.0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_tide_and_waves_add_up(made) -> None:
    waves, both = made(waves=WAVES), made(waves=WAVES, surface_level_m=1.0)
    assert both.elevation(3.0, 4.0, 0.0) == pytest.approx(waves.elevation(3.0, 4.0, 0.0) + 1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("keys", "density"),
    [
        ({}, 1025.0),
        ({"density_kgpm3": 998.0}, 998.0),
        ({"water": {"kind": "constant", "temperature_degc": 10, "salinity_psu": 35}}, 1026.95),
        ({"water": {"kind": "constant", "temperature_degc": 10, "salinity_psu": 0}}, 999.7),
        ({"water": {"kind": "constant", "hydrostatics": "uniform"}}, 1025.0),
        ({"water": {"kind": "constant"}, "density_kgpm3": 1028.0}, 1028.0),
    ],
)
def test_the_density_of_forces(made, keys: dict[str, Any], density: float) -> None:
    """Given, that of the water at the surface (TEOS-10), or sea water's."""
    water = made(**keys)
    assert water.density == pytest.approx(density, abs=0.05)
    assert (water.given is not None) == ("water" in keys)
