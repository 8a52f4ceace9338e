"""Shaft speed of thrusters."""

from __future__ import annotations

import math

import pytest
from sensor_rig import (
    THRUSTERS,
    full_speed,
    world_with,
)

from uwserver.sensors import (
    RpmConfig,
)


def test_shaft_speed_is_the_root_of_the_thrust():
    world = world_with(shafts=RpmConfig(rate_hz=20, members=THRUSTERS))
    speeds = full_speed(world, 4.0, "shafts", u=-0.5)[0]
    row = world.hydro.thrusters[0]
    thrust = float(row["demand"]) / float(row["installed"])  # the lag has settled
    assert speeds[0] == pytest.approx(-58.8 * math.sqrt(-thrust), rel=1e-3)
    assert speeds == pytest.approx((speeds[0],) * 8)
