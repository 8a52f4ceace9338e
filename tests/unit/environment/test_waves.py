"""Spectra, dispersion and linear theory of the waves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.water import Sea, Water
from uwserver.environment.waves import WavesConfig, spectral_shape, wave_number, wave_rows
from uwserver.physics.kernel import layout as rows_of
from uwserver.physics.kernel.layout import PROFILE_SIZE, SeaRows

G = 9.81


def waves(seed: int = 1, direction: float = 0.0, **keys) -> np.ndarray:
    config = WavesConfig(**{"significant_height_m": 2.0, "peak_period_s": 8.0, **keys})
    return wave_rows(config, direction, G, np.random.default_rng(seed))


def moving(rows: np.ndarray) -> Sea:
    return Sea(SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), rows))


def shape(config: WavesConfig, omega: np.ndarray) -> np.ndarray:
    return np.array([spectral_shape(config, w) for w in omega.tolist()])


def single(amplitude: float = 0.5, omega: float = 0.8, depth: float = math.inf) -> np.ndarray:
    k = wave_number(omega, G, depth)
    return np.array([[k, 0.0, k, omega, amplitude, 0.0, depth]])


def test_dispersion():
    for omega in (0.3, 0.8, 2.0, 5.0):
        assert wave_number(omega, G, math.inf) == pytest.approx(omega**2 / G, rel=1e-14)
        for depth in (0.5, 5.0, 50.0, 5000.0):
            k = wave_number(omega, G, depth)
            assert G * k * math.tanh(k * depth) == pytest.approx(omega**2, rel=1e-12)
    assert wave_number(0.01, G, 2.0) == pytest.approx(0.01 / math.sqrt(G * 2.0), rel=1e-4)  # shallow


@pytest.mark.parametrize("spectrum", ["jonswap", "pierson_moskowitz"])
@pytest.mark.parametrize("components", [1, 17, 200])
def test_variance_of_the_elevation_is_that_of_the_significant_height(spectrum, components):
    rows = waves(spectrum=spectrum, components=components, spreading=10.0)
    assert len(rows) == components
    assert 0.5 * (rows[:, rows_of.WAVE_AMPLITUDE] ** 2).sum() == pytest.approx((2.0 / 4.0) ** 2, rel=1e-12)


def test_elevation_in_time_has_four_standard_deviations_of_the_significant_height():
    water = moving(waves(components=300))
    eta = np.array([water.elevation(10.0, -20.0, t) for t in np.arange(0.0, 6000.0, 0.7)])
    assert 4.0 * eta.std() == pytest.approx(2.0, rel=0.06)
    assert abs(eta.mean()) < 0.02


@pytest.mark.parametrize("spectrum", ["jonswap", "pierson_moskowitz"])
def test_components_share_the_energy_as_the_spectrum_says(spectrum):
    config = WavesConfig(spectrum=spectrum, significant_height_m=1.0, peak_period_s=8.0, components=1000)
    omega = wave_rows(config, 0.0, G, np.random.default_rng(5))[:, rows_of.WAVE_OMEGA]
    grid = np.linspace(0.5, 5.0, 4001) * 2.0 * math.pi / 8.0
    energy = np.cumsum(shape(config, grid))
    for part in (0.1, 0.5, 0.9):
        assert np.quantile(omega, part) == pytest.approx(np.interp(part, energy / energy[-1], grid), rel=2e-3)
    assert grid[np.argmax(shape(config, grid))] == pytest.approx(2.0 * math.pi / 8.0, rel=1e-3)


def test_pierson_moskowitz_against_its_closed_forms():
    """m0 = A / (4 B) and the mean frequency m1 / m0 = Gamma(3/4) B^(1/4) of A w^-5 exp(-B w^-4), B = 5/4 wp^4."""
    config = WavesConfig(spectrum="pierson_moskowitz", significant_height_m=1.0, peak_period_s=2.0 * math.pi)
    w = np.linspace(0.2, 60.0, 400_001)
    S = shape(config, w)
    assert np.trapezoid(S, w) == pytest.approx(1.0 / 5.0, rel=1e-6)
    assert np.trapezoid(w * S, w) / np.trapezoid(S, w) == pytest.approx(math.gamma(0.75) * 1.25**0.25, rel=1e-3)


def test_jonswap_peak_is_gamma_times_higher():
    w = 2.0 * math.pi / 8.0
    sharp = WavesConfig(significant_height_m=1.0, peak_period_s=8.0, peakedness=5.0)
    flat = WavesConfig(significant_height_m=1.0, peak_period_s=8.0, spectrum="pierson_moskowitz")
    assert spectral_shape(sharp, w) / spectral_shape(flat, w) == pytest.approx(5.0)


def test_directions_follow_cos_2s():
    """The first circular moment of cos^2s(a / 2) is s / (s + 1) (Longuet-Higgins et al. 1963)."""
    for s in (1.0, 5.0, 25.0):
        rows = waves(components=2000, direction=0.7, spreading=s)
        angle = np.arctan2(rows[:, rows_of.WAVE_KY], rows[:, rows_of.WAVE_KX])
        mean = np.exp(1j * angle).mean()
        assert abs(mean) == pytest.approx(s / (s + 1.0), rel=1e-3)
        assert np.angle(mean) == pytest.approx(0.7, abs=2e-3)
        assert abs(np.corrcoef(angle, rows[:, rows_of.WAVE_OMEGA])[0, 1]) < 0.1
    rows = waves(direction=0.7)
    assert np.arctan2(rows[:, rows_of.WAVE_KY], rows[:, rows_of.WAVE_KX]) == pytest.approx(0.7)


def test_waves_go_where_they_are_told():
    """A crest seen at x = 0 is at x = c t later, c = g / omega."""
    water = moving(single(omega=0.8))
    assert water.elevation(0.0, 0.0, 0.0) == pytest.approx(0.5)
    assert water.elevation(G / 0.8 * 1.7, 5.0, 1.7) == pytest.approx(0.5)


def test_orbital_velocity_decays_with_depth():
    water, k = moving(single(0.5, 0.8)), 0.8**2 / G
    for z in (0.0, 2.0, 30.0):
        assert water.velocity((0.0, 0.0, z), 0.0) == pytest.approx((0.5 * 0.8 * math.exp(-k * z), 0.0, 0.0), abs=1e-15)
        quarter = 0.5 * math.pi / 0.8  # the crest has passed: the water sinks
        assert water.velocity((0.0, 0.0, z), quarter)[2] == pytest.approx(0.5 * 0.8 * math.exp(-k * z), rel=1e-12)
    assert water.velocity((0.0, 0.0, -0.4), 0.0) == water.velocity((0.0, 0.0, 0.0), 0.0)


def test_shallow_water_moves_alike_at_all_depths():
    h, omega = 1.0, 0.1
    water = moving(single(0.05, omega, h))
    top, bottom = water.velocity((0.0, 0.0, 0.0), 0.0), water.velocity((0.0, 0.0, h), 0.0)
    assert top[0] == pytest.approx(0.05 * math.sqrt(G / h), rel=1e-2)
    assert bottom[0] == pytest.approx(top[0], rel=1e-2)


def pressure_of(rows: np.ndarray) -> Water:
    return Water(1025.0, G, 10.0, 101_325.0, (0.0, 0.0, 0.0), moving(rows))


def test_pressure_amplitude_decays_with_depth():
    water, k = pressure_of(single(0.5, 0.8)), 0.8**2 / G
    for z in (3.0, 20.0):
        crest, trough = water.pressure((0.0, 0.0, z), 0.0), water.pressure((0.0, 0.0, z), math.pi / 0.8)
        assert 0.5 * (crest - trough) == pytest.approx(1025.0 * G * 0.5 * math.exp(-k * z), rel=1e-9)
        assert 0.5 * (crest + trough) == pytest.approx(101_325.0 + 1025.0 * G * z, rel=1e-12)


def test_pressure_on_the_bottom_of_finite_water():
    h = 10.0
    rows = single(0.5, 0.8, h)
    k = rows[0, rows_of.WAVE_K]
    gauge = pressure_of(rows).pressure((0.0, 0.0, h), 0.0) - 101_325.0 - 1025.0 * G * h
    assert gauge == pytest.approx(1025.0 * G * 0.5 / math.cosh(k * h), rel=1e-9)


def test_pressure_is_atmospheric_at_the_surface_and_above():
    water = pressure_of(single(0.5, 0.8))
    assert water.elevation(0.0, 0.0, 0.0) == 0.5
    assert water.pressure((0.0, 0.0, -0.5), 0.0) == pytest.approx(101_325.0)
    assert water.pressure((0.0, 0.0, -0.3), 0.0) == pytest.approx(101_325.0 + 1025.0 * G * 0.2)
    assert water.pressure((0.0, 0.0, -2.0), 0.0) == 101_325.0
    assert water.pressure((0.0, 0.0, 0.1), math.pi / 0.8) == 101_325.0  # trough


def test_same_seed_same_sea():
    assert waves(4, spreading=3.0).tobytes() == waves(4, spreading=3.0).tobytes()
    assert waves(4).tobytes() != waves(5).tobytes()
