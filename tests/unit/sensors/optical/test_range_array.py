"""The range array: the geometry when ideal, noise, losses and the end of its range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.sensors import (
    Pose,
    RangeArrayConfig,
)
from uwserver.testing.fake_geometry import FakeGeometry, Plane


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_ideal_ranges_equal_the_geometry(scope, angle):
    """A wall 6 m north of the origin, seen by a fan of 60 degrees from x = 1 m."""
    wall = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))])
    config = RangeArrayConfig(rate_hz=10, beams=7, field_of_view_deg=60, max_range_m=20, sigma_m=1.0, ideal=True)
    sensor = config.build(Pose())
    valid, (ranges,) = sensor.measure(replace(scope(q_NB=quat_from_rpy(0, 0, angle)), geometry=wall))
    assert valid
    for k, found in enumerate(ranges):
        bearing = math.radians(-30 + 10 * k) + angle
        assert found == pytest.approx(5.0 / math.cos(bearing), abs=1e-9)


def test_ranges_err_get_lost_and_end(scope):
    wall = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))])
    sensor = RangeArrayConfig(rate_hz=10, beams=400, max_range_m=20, sigma_m=0.02, loss_probability=0.1).build(Pose())
    instant = replace(scope(), geometry=wall)
    found = [r for _ in range(50) for r in sensor.measure(instant)[1][0]]
    seen = [r for r in found if r is not None]
    assert len(seen) / len(found) == pytest.approx(0.9, abs=0.01)
    assert np.mean(seen) == pytest.approx(5.0, abs=1e-3)
    assert np.std(seen) == pytest.approx(0.02, rel=0.03)
    sensor.change({"max_range_m": 4.0})
    assert set(sensor.measure(instant)[1][0]) == {None}
    assert not sensor.measure(replace(instant, p_NB=(0.0, 0.0, -1.0)))[0]
