"""GPS: exact when ideal, fixes lost and found again, and the size and memory of its errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_rig import (
    EARTH,
    MOUNT,
    Q,
    at,
    started,
)

from uwserver.environment.earth import north_east
from uwserver.environment.water import Sea
from uwserver.frames import rotate
from uwserver.physics.kernel.layout import (
    PROFILE_SIZE,
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_OMEGA,
    WAVE_PHASE,
    WAVE_SIZE,
    SeaRows,
)  # fmt: skip
from uwserver.sensors import (
    GpsConfig,
)


def test_ideal_gps_equals_the_truth(scope):
    instant = at(scope, 3.0, p_NB=(1200.0, -300.0, -0.5), q_NB=Q, v_NB_B=(1.0, 2.0, 3.0), w_NB_B=(0.1, 0.2, 0.3))
    reading = started(GpsConfig(rate_hz=5, ideal=True, horizontal_sigma_m=9.0, hot_fix_s=9.0, cold_fix_s=9.0)).sense(
        instant
    )
    x, y, z = instant.position(MOUNT.p)
    north, east = north_east(np.array(reading.values[0]), np.array(reading.values[1]), EARTH.latitude, EARTH.longitude)
    assert reading.valid
    assert (float(north), float(east), -reading.values[2]) == pytest.approx((x, y, z), abs=1e-6)
    cross = np.cross((0.1, 0.2, 0.3), MOUNT.p)
    assert reading.values[3] == pytest.approx(rotate(Q, tuple(np.add((1.0, 2.0, 3.0), cross))), abs=1e-9)
    assert reading.values[7:] == [12, 3]


def test_no_fix_under_water_and_none_for_a_while_after(scope):
    gps = started(GpsConfig(rate_hz=5, hot_fix_s=2.0, cold_fix_s=10.0, cold_after_s=100.0))
    up, down = {"p_NB": (0.0, 0.0, -1.0)}, {"p_NB": (0.0, 0.0, 2.0)}

    def fixes(start, end, where):
        times = np.arange(start, end, 0.2)
        return [t for t in times if gps.sense(at(scope, t, **where)).valid]

    assert min(fixes(0.0, 20.0, up)) == pytest.approx(10.0)  # cold start
    assert not fixes(20.0, 30.0, down)
    assert min(fixes(30.0, 40.0, up)) == pytest.approx(32.0)  # hot
    assert not fixes(40.0, 200.0, down)
    assert min(fixes(200.0, 220.0, up)) == pytest.approx(210.0)  # too long away
    reading = gps.sense(at(scope, 221.0, **down))
    assert reading.values == [None, None, None, (None,) * 3, None, None, None, 0, 0]


def test_a_wave_over_the_antenna_ends_the_fix(scope, water):
    # A swell so long that it is everywhere alike: its elevation is 0 at 0.5 s, and 1 m at 1.5 s.
    swell = np.zeros((1, WAVE_SIZE))
    swell[0, [WAVE_K, WAVE_KX, WAVE_OMEGA, WAVE_AMPLITUDE]] = 1e-9, 1e-9, math.pi / 2, 1.0
    swell[0, [WAVE_PHASE, WAVE_DEPTH]] = 0.75 * math.pi, math.inf
    gps = started(GpsConfig(rate_hz=5))
    high = replace(water, sea=Sea(SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), swell)))
    assert gps.sense(at(scope, 0.5, p_NB=(0.0, 0.0, -0.5), water=high)).valid
    assert not gps.sense(at(scope, 1.5, p_NB=(0.0, 0.0, -0.5), water=high)).valid


def test_satellites_are_a_setting(scope):
    gps = started(GpsConfig(rate_hz=5))
    gps.change({"satellites": 3})
    assert not gps.sense(at(scope, 0.0, p_NB=(0.0, 0.0, -1.0))).valid


def test_gps_errors_have_their_size_and_their_memory(scope):
    """Over 40 seeds: standard deviation of the correlated part, and its decay over one correlation time."""
    config = GpsConfig(rate_hz=1, horizontal_sigma_m=2.0, vertical_sigma_m=3.0, tau_s=50.0, velocity_sigma_mps=0.1)
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, -1.0))
    tracks, speeds = [], []
    for seed in range(40):
        gps = started(config, seed, dt=10.0)
        readings = [gps.sense(instant).values for _ in range(100)]
        north, east = north_east(
            np.array([r[0] for r in readings]), np.array([r[1] for r in readings]), EARTH.latitude, EARTH.longitude
        )
        x, y, z = instant.position(MOUNT.p)
        tracks.append([north - x, east - y, np.array([r[2] for r in readings]) + z])
        speeds.append([r[3] for r in readings])
    errors = np.array(tracks)
    assert errors[:, :2].std() == pytest.approx(2.0, rel=0.06)
    assert errors[:, 2].std() == pytest.approx(3.0, rel=0.08)
    assert np.std(speeds) == pytest.approx(0.1, rel=0.02)
    lag = (errors[:, :2, 5:] * errors[:, :2, :-5]).mean() / errors[:, :2].var()
    assert lag == pytest.approx(math.exp(-1.0), abs=0.06)
