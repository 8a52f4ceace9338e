"""The range array: the geometry when ideal, noise, losses and the end of its range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_rig import MOUNT, started

from uwserver.frames import multiply, quat_from_rpy, rotate
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


WALL = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0)), Plane((0.0, -9.0, 0.0), (0.0, 1.0, 0.0))])


def ranges_of(config, p, q, geometry):
    """In plain Python."""
    half = math.radians(config.field_of_view_deg) / 2.0
    angles = np.linspace(-half, half, config.beams) if config.beams > 1 else [0.0]
    rays = np.array([rotate(multiply(q, MOUNT.q), (math.cos(a), math.sin(a), 0.0)) for a in angles])
    start = np.array(p) + rotate(q, MOUNT.p)
    found = geometry.raycast(np.broadcast_to(start, rays.shape).copy(), rays, config.max_range_m).distance
    return [r if config.min_range_m <= r <= config.max_range_m else None for r in found.tolist()]


@pytest.mark.parametrize("beams", [1, 2, 301])
@pytest.mark.parametrize("field_of_view_deg", [90.0, 360.0])
def test_without_errors_each_ray_tells_what_it_meets(scope, beams, field_of_view_deg):
    config = RangeArrayConfig(
        rate_hz=10, beams=beams, field_of_view_deg=field_of_view_deg, min_range_m=4.0, max_range_m=12.0
    )
    for p, rpy in (((1.0, 2.0, 5.0), (0.1, -0.2, -0.4)), ((-2.0, -4.0, 8.0), (0.0, 0.3, -2.0))):
        q = quat_from_rpy(*rpy)
        valid, (found,) = started(config, mount=MOUNT).measure(replace(scope(p_NB=p, q_NB=q), geometry=WALL))
        expected = ranges_of(config, p, q, WALL)
        assert valid
        assert [r is None for r in found] == [r is None for r in expected]
        assert [r for r in found if r] == pytest.approx([r for r in expected if r], rel=1e-12)
        assert beams < 3 or (None in expected and any(expected))


@pytest.mark.parametrize("medium", ["water", "any"])
def test_in_air_it_sees_where_its_medium_is_any(scope, medium):
    sensor = started(RangeArrayConfig(rate_hz=10, beams=2, medium=medium), mount=Pose())
    instant = replace(scope(p_NB=(1.0, 0.0, -1.0)), geometry=WALL)
    assert sensor.measure(instant) == ((True, [(5.0, 5.0)]) if medium == "any" else (False, [(None, None)]))


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
