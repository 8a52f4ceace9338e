"""Motion capture: the pose of the markers, while the cameras can see them."""

from __future__ import annotations

import math

import pytest

from uwserver.frames import quat_from_rpy
from uwserver.sensors import MotionCaptureConfig, Pose


def measured(scope, mount):
    return MotionCaptureConfig(rate_hz=30).build(mount).measure(scope)


def test_pose_of_the_origin_is_truth(scope):
    q = quat_from_rpy(0.1, 0.2, 0.3)
    valid, (p_NS, q_NS) = measured(scope(q_NB=q), Pose())
    assert valid
    assert p_NS == pytest.approx((1.0, 2.0, 5.0), abs=1e-12)
    assert q_NS == pytest.approx(q, abs=1e-12)


def test_markers_stand_where_they_are_mounted(scope):
    heading_east = scope(q_NB=quat_from_rpy(0, 0, math.pi / 2))
    valid, (p_NS, q_NS) = measured(heading_east, Pose((0.3, 0.1, -0.2), quat_from_rpy(0, 0, math.pi / 2)))
    assert valid
    assert p_NS == pytest.approx((0.9, 2.3, 4.8), abs=1e-12)
    assert q_NS == pytest.approx(quat_from_rpy(0, 0, math.pi), abs=1e-12)


@pytest.mark.parametrize(("z", "seen"), [(0.19, False), (0.21, True), (-1.0, False)])
def test_above_the_surface_they_are_not_seen(scope, z, seen):
    valid, values = measured(scope(p_NB=(0, 0, z)), Pose((0, 0, -0.2)))
    assert valid is seen
    if not seen:
        assert values == [(None,) * 3, (None,) * 4]
