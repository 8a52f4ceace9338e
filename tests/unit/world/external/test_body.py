"""Bodies that follow poses, without a world: where they are, where they are when their pose is not known, and what their ports measure."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.water import Water
from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import NOWHERE_M
from uwserver.sensors.base import Scope
from uwserver.world.external.body import Difference, External, ExternalState, is_nowhere, led_params
from uwserver.world.external.pose_source import LivePoses
from uwserver.world.external.track import AT_REST, TrackPose


class Told:
    """A source that says what the test says."""

    pose: TrackPose | None = None

    def at(self, t_ns: int) -> TrackPose | None:
        return self.pose

    def age_s(self, t_ns: int) -> float | None:
        return None

    def count(self, t_ns: int) -> int:
        return 0


POSE = TrackPose((1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 0.0), (1.0, 0, 0, 0, 0, 0.5), 0.0)


def external(ghost: bool) -> tuple[External, Hydrodynamics, Told]:
    hydro, told = Hydrodynamics((led_params(), led_params()), 0.01), Told()
    return External("x", hydro, 1, told, ghost), hydro, told


def test_it_stands_where_its_source_says():
    part, hydro, told = external(ghost=False)
    told.pose = POSE
    part.after(1, 10, [])
    assert hydro.state[1].tolist() == [1, 2, 3, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0.5]
    assert hydro.bodies["retired"].tolist() == [0, 0]
    assert (hydro.state[0, :3] == 0.0).all()


def test_nobody_meets_it_where_it_is_when_nobody_knows():
    part, hydro, told = external(ghost=False)
    told.pose = POSE
    part.follow_source(0)
    told.pose = None
    part.follow_source(10)
    assert is_nowhere(tuple(hydro.state[1, :3]))
    assert hydro.state[1, 2] < -NOWHERE_M
    assert (hydro.state[1, 7:] == 0.0).all()
    other = External("y", hydro, 0, told, False)
    other.follow_source(10)
    assert np.linalg.norm(hydro.state[1, :3] - hydro.state[0, :3]) >= 1e3
    told.pose = POSE
    part.follow_source(20)
    assert not is_nowhere(tuple(hydro.state[1, :3]))
    assert hydro.bodies["retired"][1] == 0


def test_the_kernel_moves_no_ghost():
    part, hydro, told = external(ghost=True)
    told.pose = POSE
    part.follow_source(0)
    before = hydro.state[1].copy()
    hydro.advance(0.0)
    assert (hydro.state[1] == before).all()


def test_within_a_tick_a_solid_one_goes_on_at_its_velocity():
    part, hydro, told = external(ghost=False)
    told.pose = POSE._replace(q_NB=(1.0, 0.0, 0.0, 0.0), nu=(1.0, 0, 0, 0, 0, 0))
    part.follow_source(0)
    hydro.advance(0.0)
    assert np.allclose(hydro.state[1, :3], [1.01, 2.0, 3.0], atol=1e-12)


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
