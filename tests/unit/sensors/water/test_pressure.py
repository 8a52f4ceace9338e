"""Pressure and depth: hydrostatics, what the instrument believes, and where it sits."""

from __future__ import annotations

import math

import pytest

from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy
from uwserver.sensors import Pose, PressureConfig

ATMOSPHERE, WEIGHT = 101_325.0, 1025.0 * 9.81


def pressure(scope, mount=None):
    valid, values = PressureConfig(rate_hz=10).build(mount or Pose()).measure(scope)
    assert valid
    assert values[1] == 12.0
    return values[0]


def depth(scope, mount=None, **believed):
    valid, values = PressureConfig(rate_hz=10, output="depth", **believed).build(mount or Pose()).measure(scope)
    assert valid
    assert values[1] == 12.0
    return values[0]


@pytest.mark.parametrize(("z", "head"), [(0.0, 0.0), (5.0, 5.0), (300.0, 300.0), (-2.0, 0.0)])
def test_pressure_is_hydrostatic_below_and_atmospheric_above(scope, z, head):
    assert pressure(scope(p_NB=(0, 0, z))) == pytest.approx(ATMOSPHERE + WEIGHT * head, rel=1e-12)


@pytest.mark.parametrize(("z", "expected"), [(0.0, 0.0), (5.0, 5.0), (300.0, 300.0), (-2.0, 0.0)])
def test_depth_with_the_right_settings(scope, z, expected):
    assert depth(scope(p_NB=(0, 0, z))) == pytest.approx(expected, abs=1e-9)


def test_an_instrument_set_to_fresh_water_reads_too_deep_in_the_sea(scope):
    assert depth(scope(), assumed_density_kgpm3=1000.0) == pytest.approx(5.0 * 1.025)


def test_an_instrument_zeroed_on_another_day_has_an_offset(scope):
    believed = ATMOSPHERE - 1000.0
    assert depth(scope(), assumed_atmosphere_pa=believed) == pytest.approx(5.0 + 1000.0 / WEIGHT)
    assert depth(scope(p_NB=(0, 0, -1.0)), assumed_atmosphere_pa=believed) == pytest.approx(1000.0 / WEIGHT)
    assert depth(scope(), assumed_atmosphere_pa=0.0) == pytest.approx(5.0 + ATMOSPHERE / WEIGHT)


@pytest.mark.parametrize(
    ("rpy", "mount", "deeper"),
    [
        ((0, 0, 0), (0, 0, 0.2), 0.2),
        ((0, 0, 0), (0.4, 0.3, 0), 0.0),
        ((math.pi / 2, 0, 0), (0, 0.3, 0), 0.3),  # starboard down
        ((-math.pi / 2, 0, 0), (0, 0.3, 0), -0.3),
        ((math.pi / 6, 0, 1.0), (0, 0.3, 0), 0.15),
        ((math.pi, 0, 0), (0, 0, 0.2), -0.2),
        ((0, math.pi / 6, 2.0), (0.4, 0, 0), -0.2),  # bow up
    ],
)
def test_the_depth_is_that_of_the_mount(scope, rpy, mount, deeper):
    tilted = scope(q_NB=quat_from_rpy(*rpy))
    assert depth(tilted, Pose(mount)) == pytest.approx(5.0 + deeper, abs=1e-12)
    assert pressure(tilted, Pose(mount)) == pytest.approx(ATMOSPHERE + WEIGHT * (5.0 + deeper))


def test_turning_the_sensor_in_its_mount_makes_no_difference(scope):
    assert depth(scope(), Pose((0, 0, 0.1), quat_from_rpy(1, 2, 3))) == pytest.approx(5.1)


def test_without_gravity_there_is_no_depth(scope):
    water = Water(1025.0, 0.0, 12.0, ATMOSPHERE, (0, 0, 0))
    assert PressureConfig(rate_hz=10, output="depth").build(Pose()).measure(scope(water=water)) == (False, [None, 12.0])
    assert pressure(scope(water=water)) == ATMOSPHERE
