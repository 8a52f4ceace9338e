"""The Earth about the origin of N: geodetic coordinates, magnetic field, gravity and rotation. Also of uwserver.adapter.earth."""

from __future__ import annotations

import math

import gsw
import numpy as np
import pytest
from sensor_rig import (
    EARTH,
)

from uwserver.environment.earth import (
    EARTH_RATE,
    GRAVITY_GROWTH,
    Earth,
    latitude_longitude,
    normal_gravity,
    north_east,
    turns_of_level,
)
from uwserver.scenario.world.earth import magnetic_about
from uwserver.units import deg, rad


def test_the_magnetic_field_is_that_of_the_model():
    """D 5.257 deg and F 52 282.5 nT at 63.43 N 10.40 E in 2026.5; 5.31 deg by the IGRF."""
    at_origin = EARTH.magnetic[0]
    assert deg(EARTH.declination) == pytest.approx(5.257, abs=0.001)
    assert math.hypot(*at_origin) == pytest.approx(52_282.5e-9, abs=0.1e-9)
    there = magnetic_about(*latitude_longitude(8000.0, -6000.0, EARTH.latitude, EARTH.longitude), 2026.5)[0]
    assert EARTH.magnetic_field((8000.0, -6000.0, 0.0)) == pytest.approx(there, abs=60e-9)


def test_gravity_on_the_ellipsoid():
    """At the equator and the poles the values of WGS 84 (NIMA TR8350.2, table 3.4), between them TEOS-10's series for GRS 80, which is as round."""
    assert normal_gravity(0.0) == 9.7803253359
    assert normal_gravity(rad(90.0)) == pytest.approx(9.8321849378, abs=1e-9)
    for latitude in (-75.0, -30.0, 12.3, 45.0, 63.4):
        assert normal_gravity(rad(latitude)) == pytest.approx(float(gsw.grav(latitude, 0.0)), abs=3e-6)


def test_gravity_grows_with_depth_as_in_the_ocean():
    for depth in (100.0, 6000.0):
        pressure = float(gsw.p_from_z(-depth, 45.0))
        grown = float(gsw.grav(45.0, pressure)) / float(gsw.grav(45.0, 0.0))
        assert 1.0 + GRAVITY_GROWTH * depth == pytest.approx(grown, abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 45.0, 80.0])
@pytest.mark.parametrize("p", [(0.0, 0.0, 0.0), (9000.0, 0.0, 0.0), (0.0, 7000.0, 0.0), (-4000.0, -3000.0, 50.0)])
def test_the_rate_of_the_earth_as_felt_at_a_place(latitude_deg, p):
    """Its vertical part is that of the place's own latitude, and it is always whole."""
    earth = Earth(rad(latitude_deg), 0.3, rotating=True)
    felt, _ = turns_of_level(earth.rate, earth.curvature, p, (0.0, 0.0, 0.0))
    latitude = earth.geodetic(p)[0]
    assert np.linalg.norm(felt) == pytest.approx(EARTH_RATE, rel=3e-6)
    assert felt[2] == pytest.approx(-EARTH_RATE * math.sin(latitude), abs=2e-5 * EARTH_RATE)


def test_north_of_the_map_is_not_north_of_the_place():
    """East of the origin, meridians close in on the left in the north: by the change of longitude times the sine of the latitude."""
    earth = Earth(rad(60.0), 0.0, rotating=True)
    felt, _ = turns_of_level(earth.rate, earth.curvature, (0.0, 5000.0, 0.0), (0.0, 0.0, 0.0))
    convergence = earth.geodetic((0.0, 5000.0, 0.0))[1] * math.sin(earth.latitude)
    assert math.atan2(felt[1], felt[0]) == pytest.approx(-convergence, rel=1e-5)


@pytest.mark.parametrize(
    ("v", "about"), [((2.0, 0.0, 0.0), (0, -1, 0)), ((0.0, 2.0, 0.0), (1, 0, 0)), ((0.0, 0.0, 2.0), (0, 0, 0))]
)
def test_who_moves_over_a_round_earth_turns(v, about):
    """By the change of latitude to the north; to the east by the radius of the prime vertical."""
    earth = Earth(rad(50.0), 0.0, rotating=True)
    _, turn = turns_of_level(earth.rate, earth.curvature, (0.0, 0.0, 0.0), v)
    ahead = earth.geodetic((v[0] * 1e3, v[1] * 1e3, 0.0))
    angle = max(ahead[0] - earth.latitude, ahead[1] * math.cos(earth.latitude)) / 1e3
    assert turn == pytest.approx(angle * np.array(about), abs=1e-11)


def test_an_earth_that_does_not_turn():
    earth = Earth(rad(50.0), 0.0)
    assert turns_of_level(earth.rate, earth.curvature, (1e3, 2e3, 3.0), (1.0, 2.0, 3.0)) == ((0.0,) * 3, (0.0,) * 3)


@pytest.mark.parametrize("place", [(0.0, 0.0), (3000.0, -4000.0), (-250_000.0, 180_000.0)])
@pytest.mark.parametrize("origin", [(63.43, 10.40), (0.0, 179.9), (-45.0, -170.0)])
def test_geodesy_leads_there_and_back(place, origin):
    latitude, longitude = latitude_longitude(*place, rad(origin[0]), rad(origin[1]))
    north, east = north_east(np.array(latitude), np.array(longitude), rad(origin[0]), rad(origin[1]))
    assert (float(north), float(east)) == pytest.approx(place, abs=1e-6)
