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

from uwserver.environment.earth import EARTH_RATE, Earth
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
    readings = [started(config, seed, mount=Pose()).sense(instant).values for seed in range(1000)]
    heading = np.array([r[1] for r in readings]) - 1.0
    assert deg(heading.std()) == pytest.approx(0.5 * factor, rel=0.11)
    tilt = [2.0 * math.hypot(r[0][1], r[0][2]) for r in readings]
    assert deg(math.sqrt(np.mean(np.square(tilt)) / 2)) == pytest.approx(0.2, rel=0.08)


def test_a_gyrocompass_settles_first(scope):
    config = AttitudeConfig(rate_hz=10, settling_s=300.0)
    assert started(config).sense(at(scope, 299.9)).values == [(None,) * 4, None]
    assert started(config).sense(at(scope, 300.0)).valid


@pytest.mark.parametrize(("told", "turns"), [(False, True), (False, False), (True, True)])
@pytest.mark.parametrize(("latitude_deg", "north_mps"), [(60.0, 2.0), (-40.0, -5.0), (0.0, 1.0)])
def test_a_gyrocompass_that_is_not_told_its_speed(scope, told, turns, latitude_deg, north_mps):
    """It is wrong by the speed north over the Earth's own to the east (Bowditch, ch. 6): half a degree at 2 m/s and 60 degrees north."""
    config = AttitudeConfig(rate_hz=10, secant_latitude=True, told_speed=told)
    moving = scope(
        earth=Earth(rad(latitude_deg), 0.0, rotating=turns), q_NB=quat_from_rpy(0, 0, 1.0),
        v_NB_B=(north_mps * math.cos(1.0), -north_mps * math.sin(1.0), 0.0),
    )  # fmt: skip
    heading = started(config, mount=Pose()).sense(moving).values[1]
    across = 6.378e6 * math.cos(rad(latitude_deg)) * EARTH_RATE
    expected = 0.0 if told or not turns else math.atan(north_mps / across)
    assert heading - 1.0 == pytest.approx(expected, rel=0.01, abs=1e-9)
