"""The Earth's magnetic field about the origin of N."""

from __future__ import annotations

import math

import pytest
from sensor_rig import (
    EARTH,
)

from uwserver.environment.geodesy import latitude_longitude
from uwserver.scenario.world.magnetic import magnetic_about
from uwserver.units import deg


def test_the_magnetic_field_is_that_of_the_model():
    """D 5.257 deg and F 52 282.5 nT at 63.43 N 10.40 E in 2026.5; 5.31 deg by the IGRF."""
    at_origin = EARTH.magnetic[0]
    assert deg(EARTH.declination) == pytest.approx(5.257, abs=0.001)
    assert math.hypot(*at_origin) == pytest.approx(52_282.5e-9, abs=0.1e-9)
    there = magnetic_about(*latitude_longitude(8000.0, -6000.0, EARTH.latitude, EARTH.longitude), 2026.5)[0]
    assert EARTH.magnetic_field((8000.0, -6000.0, 0.0)) == pytest.approx(there, abs=60e-9)
