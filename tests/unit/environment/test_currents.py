"""Depth profiles and drifting currents."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.environment.currents import Drift, GaussMarkovConfig, ProfileConfig, profile_rows
from uwserver.environment.water import Sea
from uwserver.physics.kernel.layout import WAVE_SIZE, SeaRows

DEPTHS = (0.0, 5.0, 20.0, 50.0)
SPEEDS = ((0.8, 0.0, 0.0), (0.5, 0.1, 0.0), (0.2, 0.1, 0.0), (0.2, -0.3, 0.01))
STILL = np.zeros((0, WAVE_SIZE))


def water(*profiles: ProfileConfig) -> Sea:
    rows = np.concatenate([profile_rows(profile) for profile in profiles])
    return Sea(SeaRows(np.zeros(7), rows, STILL))


def at(sea: Sea, z: float) -> list[float]:
    return list(sea.velocity((100.0, -3.0, z), 7.0))


@pytest.mark.parametrize("interpolation", ["linear", "pchip"])
def test_a_profile_goes_through_its_table_and_is_constant_outside(interpolation):
    sea = water(ProfileConfig(depth_m=DEPTHS, velocity_ned_mps=SPEEDS, interpolation=interpolation))
    for z, u in zip(DEPTHS, SPEEDS, strict=True):
        assert at(sea, z) == pytest.approx(u, abs=1e-14)
    assert at(sea, -3.0) == pytest.approx(SPEEDS[0])
    assert at(sea, 4000.0) == pytest.approx(SPEEDS[-1])


def test_linear_is_linear():
    sea = water(ProfileConfig(depth_m=DEPTHS, velocity_ned_mps=SPEEDS))
    for z in np.linspace(0.0, 50.0, 101):
        assert at(sea, z) == pytest.approx([np.interp(z, DEPTHS, [u[i] for u in SPEEDS]) for i in range(3)], abs=1e-14)


def test_pchip_does_not_overshoot_and_has_no_kinks():
    sea = water(ProfileConfig(depth_m=DEPTHS, velocity_ned_mps=SPEEDS, interpolation="pchip"))
    z = np.linspace(0.0, 50.0, 2001)
    u = np.array([at(sea, depth) for depth in z])
    assert (np.diff(u[:, 0]) <= 1e-15).all()
    assert u[:, 1].max() <= 0.1 + 1e-15
    slope = np.diff(u, axis=0) / np.diff(z)[:, None]
    assert np.abs(np.diff(slope, axis=0)).max() < 0.002  # a linear profile's slope jumps by 0.04


def test_pchip_is_scipys():
    interpolate = pytest.importorskip("scipy.interpolate")
    sea = water(ProfileConfig(depth_m=DEPTHS, velocity_ned_mps=SPEEDS, interpolation="pchip"))
    reference = interpolate.PchipInterpolator(DEPTHS, np.array(SPEEDS))
    for z in np.linspace(0.0, 49.99, 77):
        assert at(sea, z) == pytest.approx(reference(z), abs=1e-13)


def test_two_knots_of_pchip_are_a_line():
    sea = water(ProfileConfig(depth_m=(0.0, 10.0), velocity_ned_mps=((0, 0, 0), (1, 2, 3)), interpolation="pchip"))
    assert at(sea, 2.5) == pytest.approx([0.25, 0.5, 0.75])


def test_currents_add_up():
    one = ProfileConfig(depth_m=(0.0, 10.0), velocity_ned_mps=((0, 0, 0), (1, 0, 0)))
    two = ProfileConfig(depth_m=(5.0, 7.0), velocity_ned_mps=((0, 1, 0), (0, 3, 0)), interpolation="pchip")
    rows = np.concatenate([profile_rows(one), profile_rows(two)])
    sea = Sea(SeaRows(np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 2.0]), rows, STILL))
    assert sea.velocity((0.0, 0.0, 6.0), 2.5) == pytest.approx((0.6 + 0.1 + 0.5, 2.0 + 0.2, 0.3))


def drift(seed: int, steps: int, tau: float = 2.0, rate: float = 10.0, **keys: float) -> np.ndarray:
    config = GaussMarkovConfig(sigma_ned_mps=(0.3, 0.1, 0.0), tau_s=tau, **keys)
    current = Drift(config.build(), rate, np.random.default_rng(seed))
    velocities = [current.at(0)[0]]
    for tick in range(1, steps):
        current.move(tick)
        velocities.append(current.at(tick)[0])
    return np.array(velocities)


def test_variance_and_correlation_time_of_a_drift_over_seeds():
    """Drawn in each tick: sigma^2 exp(-lag / tau) at every instant, also the first."""
    runs = np.array([drift(seed, 21, interval_s=0.1) for seed in range(4000)])
    for k in (0, 10, 20):
        assert runs[:, k, 0].std() == pytest.approx(0.3, rel=0.04)
        assert runs[:, k, 1].std() == pytest.approx(0.1, rel=0.04)
        assert abs(runs[:, k, 0].mean()) < 0.02
    correlation = (runs[:, 0, 0] * runs[:, 20, 0]).mean() / 0.09
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.05)
    assert abs((runs[:, 0, 0] * runs[:, 0, 1]).mean()) < 0.002
    assert (runs[:, :, 2] == 0.0).all()


def test_between_draws_a_drift_is_linear_and_meets_them():
    coarse = drift(3, 201, tau=20.0, interval_s=2.0)
    assert np.abs(np.diff(coarse, n=2, axis=0)[np.arange(199) % 20 != 19]).max() < 1e-15
    runs = np.array([drift(seed, 41, tau=20.0, interval_s=2.0)[[0, 40]] for seed in range(3000)])
    assert (runs[:, 0, 0] * runs[:, 1, 0]).mean() / 0.09 == pytest.approx(np.exp(-4.0 / 20.0), abs=0.06)


def test_the_sea_tells_the_rate_of_a_drift():
    """What the kernel extrapolates within a tick is what holds at the next one."""
    current = Drift(GaussMarkovConfig(sigma_ned_mps=(0.3, 0.1, 0.2), tau_s=5.0).build(), 20.0, np.random.default_rng(1))
    sea = Sea(SeaRows(np.zeros(7), np.zeros((0, 15)), STILL), [current], 0.05)
    sea.hold(0, 0.0, (1.0, 0.0, 0.0))
    for tick in range(1, 50):
        uniform = sea.rows.uniform.copy()
        sea.draw(tick)
        sea.hold(tick, tick * 0.05, (1.0, 0.0, 0.0))
        assert sea.rows.uniform[:3] == pytest.approx(uniform[:3] + 0.05 * uniform[3:6], abs=1e-14)
    assert np.abs(sea.rows.uniform[:3] - (1.0, 0.0, 0.0)).max() > 1e-3
