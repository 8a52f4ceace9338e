"""Sources of poses: tracks in simulation time, and commands that come in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy, rpy_from_quat
from uwserver.ports.checks import checked_command
from uwserver.ports.values import Port
from uwserver.world.external.pose_source import LivePoses, NewestPose, RecordedPoses
from uwserver.world.external.track import AT_REST, PoseTrack, TrackPose

MS = 1_000_000
START = TrackPose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), AT_REST, 0.0)


class Rig:
    """A live source whose time the test sets."""

    def __init__(self, **how) -> None:
        self.t_ns = 0
        self.live = LivePoses(lambda: self.t_ns, START, **how)
        self.port = Port("x/pose", "actuator", "pose", self.live.fields, self.live.doc)

    def tell(self, t_ms: int, **value) -> str:
        self.t_ns = t_ms * MS
        given = checked_command(self.port, value)
        objection = self.live.objection(given)
        if objection is None:
            self.live.apply(given)
        return "" if objection is None else objection.text

    def at(self, t_ms: float):
        return self.live.at(round(t_ms * MS))


def test_nobody_knows_where_it_is_before_the_first_pose():
    assert Rig().at(0) is None
    assert Rig().live.age_s(0) is None
    assert Rig(outside="hold").at(50) == START


def test_it_goes_on_at_the_velocity_that_it_was_told_of():
    """1 m/s forward on a heading of 90 degrees, while it turns by 1 rad/s."""
    rig = Rig()
    q = quat_from_rpy(0.0, 0.0, math.pi / 2)
    assert not rig.tell(1000, p_NB=[5, 5, 5], q_NB=q, v_NB_B=[1, 0, 0], w_NB_B=[0, 0, 1])
    pose = rig.at(1100)
    assert pose.p_NB == pytest.approx((5.0, 5.1, 5.0))
    assert rpy_from_quat(pose.q_NB)[2] == pytest.approx(math.pi / 2 + 0.1)
    assert pose.nu == (1, 0, 0, 0, 0, 1)
    assert pose.age_s == pytest.approx(0.1)


def test_it_stands_when_nothing_newer_comes_and_then_is_gone():
    rig = Rig(predict_s=0.2, max_gap_s=1.0)
    rig.tell(0, p_NB=[0, 0, 0], v_NB_B=[1, 0, 0], w_NB_B=[0, 0, 0])
    assert rig.at(200).p_NB[0] == pytest.approx(0.2)
    assert rig.at(900).p_NB[0] == pytest.approx(0.2)
    assert rig.at(900).nu == AT_REST
    assert rig.at(1001) is None
    assert rig.live.age_s(5000 * MS) == 5.0
    held = Rig(outside="hold")
    held.tell(0, p_NB=[7, 0, 0], v_NB_B=[1, 0, 0])
    assert held.at(9000).p_NB == (7.0, 0.0, 0.0)


def test_velocity_follows_from_two_poses_where_it_is_not_told():
    rig = Rig()
    rig.tell(0, p_NB=[0, 0, 0])
    assert rig.at(0).nu == AT_REST
    rig.tell(100, p_NB=[0, 0.2, 0], q_NB=quat_from_rpy(0, 0, 0.05))
    assert rig.at(100).nu[5] == pytest.approx(0.5)
    assert math.hypot(*rig.at(100).nu[:3]) == pytest.approx(2.0)
    assert rig.at(150).p_NB == pytest.approx((0.0, 0.3, 0.0))


def test_stamps_tell_the_time_between_two_poses_however_they_arrive():
    rig = Rig()
    rig.tell(0, p_NB=[0, 0, 0], stamp=1000.0)
    rig.tell(10, p_NB=[0.1, 0, 0], stamp=1000.1)
    assert rig.at(10).nu[0] == pytest.approx(1.0)


def test_a_jump_is_no_speed():
    rig = Rig()
    rig.tell(0, p_NB=[0, 0, 0])
    rig.tell(10, p_NB=[300, 0, 0])
    assert rig.at(10).nu == AT_REST


def test_attitude_is_normalised_and_kept():
    rig = Rig()
    rig.tell(0, p_NB=[0, 0, 0], q_NB=[0, 0, 0, -5])
    rig.tell(10, p_NB=[0, 0, 0])
    assert rig.live.memory.q_NB == (0, 0, 0, -1)
    assert rig.live.memory.count == 2


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"q_NB": [1, 0, 0, 0]}, "needs p_NB"),
        ({"p_NB": [0, 0, 0], "stamp": 4.9}, "in the order of their stamps"),
    ],
)
def test_a_bad_pose_is_refused_and_changes_nothing(value, text):
    rig = Rig()
    rig.tell(0, p_NB=[1, 1, 1], stamp=5.0)
    before = rig.live.memory
    assert text in rig.tell(10, **value)
    assert rig.live.memory is before


def test_a_sender_whose_clock_begins_anew_leaves_the_stamp_out_once():
    rig = Rig()
    rig.tell(0, p_NB=[1, 1, 1], stamp=5.0)
    assert not rig.tell(10, p_NB=[1, 1, 1])
    assert not rig.tell(20, p_NB=[1, 1, 1], stamp=0.1)


def test_what_it_remembers_is_all_that_it_goes_on_from():
    one, two = Rig(), Rig()
    one.tell(100, p_NB=[1, 2, 3], v_NB_B=[1, 2, 3], stamp=9.0)
    two.live.memory = NewestPose(**{name: getattr(one.live.memory, name) for name in NewestPose.__struct_fields__})
    assert two.at(170) == one.at(170)


def test_a_recorded_track_knows_its_age():
    t = np.array([0, 100, 200]) * MS
    source = RecordedPoses(PoseTrack(t, np.zeros((3, 3)), np.tile([1.0, 0, 0, 0], (3, 1))), "hide", 1.0)
    assert source.age_s(-1) is None
    assert source.age_s(150 * MS) == pytest.approx(0.05)
    assert source.age_s(900 * MS) == pytest.approx(0.7)
    assert [source.count(k * MS) for k in (-1, 0, 150, 500)] == [0, 1, 2, 3]
    assert source.at(150 * MS).age_s == pytest.approx(0.05)
    assert source.at(300 * MS) is None
