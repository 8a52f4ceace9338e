"""What external bodies show."""

from __future__ import annotations

import math

import pytest

from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy
from uwserver.sensors.base import Scope
from uwserver.world.external.ports import Difference, ExternalState
from uwserver.world.external.pose_source import LivePoses
from uwserver.world.external.track import AT_REST, TrackPose

WATER = Water(1025.0, 9.81, 12.0, 101_325.0, (0.0, 0.0, 0.0))
NOWHERE = (0.0, 0.0, -1_001_000.0)


class Other:
    """Another body."""

    def __init__(self, p, q=(1.0, 0.0, 0.0, 0.0)) -> None:
        self.p_NB, self.q_NB, self.nu = p, q, (0.0,) * 6


def scope(p, q=(1.0, 0.0, 0.0, 0.0), **others) -> Scope:
    return Scope(200_000_000, p, q, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), WATER, vehicles=others)


def test_difference_of_two_poses():
    sensor = Difference("b")
    b = Other((1.0, 1.0, 1.0), quat_from_rpy(0, 0, math.pi - 0.1))
    valid, (p, distance, horizontal, heading, angle) = sensor.measure(
        scope((4.0, 5.0, 1.5), quat_from_rpy(0, 0, -math.pi + 0.2), b=b)
    )
    assert valid
    assert p == (3.0, 4.0, 0.5)
    assert (horizontal, distance) == pytest.approx((5.0, math.hypot(5.0, 0.5)))
    assert heading == pytest.approx(0.3)
    assert angle == pytest.approx(0.3)


@pytest.mark.parametrize("others", [{}, {"b": Other(NOWHERE)}])
def test_no_difference_from_what_is_not_there(others):
    valid, values = Difference("b").measure(scope((0.0, 0.0, 0.0), **others))
    assert not valid
    assert values[1] is None
    assert not Difference("b").measure(scope(NOWHERE, b=Other((0, 0, 0))))[0]


def test_state_tells_the_age_also_when_it_is_nowhere():
    live = LivePoses(lambda: 100_000_000, TrackPose((0, 0, 0), (1, 0, 0, 0), AT_REST, 0.0))
    sensor = ExternalState(live)
    assert sensor.measure(scope(NOWHERE)) == (False, [(None,) * 3, (None,) * 4, (None,) * 3, (None,) * 3, None, 0])
    live.apply(((1.0, 2.0, 3.0), None, None, None, None))
    valid, values = sensor.measure(scope((1.0, 2.0, 3.0)))
    assert valid
    assert values[0] == (1.0, 2.0, 3.0)
    assert values[4:] == [pytest.approx(0.1), 1]
