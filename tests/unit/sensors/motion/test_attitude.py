"""AHRS and gyrocompass: exact when ideal, the statistics of their errors, magnetic north and settling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import (
    EARTH,
    at,
    started,
)

from uwserver.frames import quat_from_rpy
from uwserver.sensors import (
    AttitudeConfig,
    Pose,
)
from uwserver.units import deg, rad


def test_ideal_attitude_equals_the_truth(scope):
    config = AttitudeConfig(rate_hz=10, ideal=True, tilt_sigma_deg=3.0, heading_turn_on_deg=5.0, settling_s=9.0)
    reading = started(config, mount=Pose()).sense(at(scope, 0.0, q_NB=quat_from_rpy(0.1, 0.2, -0.5)))
    assert reading.valid
    assert reading.values[0] == quat_from_rpy(0.1, 0.2, -0.5)
    assert reading.values[1] == pytest.approx(2 * math.pi - 0.5, abs=1e-9)


def test_magnetic_heading_is_less_by_the_declination(scope):
    config = AttitudeConfig(rate_hz=10, north="magnetic")
    reading = started(config, mount=Pose()).sense(at(scope, 0.0, q_NB=quat_from_rpy(0, 0, 1.0)))
    assert reading.values[1] == pytest.approx(1.0 - EARTH.declination, abs=1e-9)


@pytest.mark.parametrize(("secant", "factor"), [(False, 1.0), (True, 1.0 / math.cos(rad(63.43)))])
def test_heading_errors_and_the_secant_of_the_latitude(scope, secant, factor):
    config = AttitudeConfig(
        rate_hz=10, heading_sigma_deg=0.3, heading_turn_on_deg=0.4, tilt_sigma_deg=0.2, secant_latitude=secant
    )
    instant = at(scope, 0.0, q_NB=quat_from_rpy(0, 0, 1.0))
    readings = [started(config, seed, mount=Pose()).sense(instant).values for seed in range(3000)]
    heading = np.array([r[1] for r in readings]) - 1.0
    assert deg(heading.std()) == pytest.approx(0.5 * factor, rel=0.05)
    tilt = [2.0 * math.hypot(r[0][1], r[0][2]) for r in readings]
    assert deg(math.sqrt(np.mean(np.square(tilt)) / 2)) == pytest.approx(0.2, rel=0.05)


def test_a_gyrocompass_settles_first(scope):
    config = AttitudeConfig(rate_hz=10, settling_s=300.0)
    assert started(config).sense(at(scope, 299.9)).values == [(None,) * 4, None]
    assert started(config).sense(at(scope, 300.0)).valid
