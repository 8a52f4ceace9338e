"""Tracks: between two poses, outside of them, and what a foreign source may give."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy, rotate, rpy_from_quat
from uwserver.world.external.track import FARTHEST_M, PoseTrack, cleaned, rotation_vector, turned

S = 1_000_000_000


def track(times, positions, yaws=None, speeds=None):
    q = [quat_from_rpy(0.0, 0.0, yaw) for yaw in (yaws or [0.0] * len(times))]
    v = None if speeds is None else np.array(speeds, float)
    return PoseTrack(np.array([round(t * S) for t in times]), np.array(positions, float), np.array(q), v)


def test_a_straight_line_without_velocities():
    pose = track([1.0, 2.0], [(0, 0, 0), (2, -4, 1)]).at(round(1.25 * S))
    assert pose.p_NB == pytest.approx((0.5, -1.0, 0.25))
    assert pose.nu[:3] == pytest.approx((2.0, -4.0, 1.0))
    assert pose.age_s == pytest.approx(0.25)


def test_a_circle_with_velocities_is_met_to_the_fourth_order():
    """Cubic Hermite: error h^4/384 of the fourth derivative. A straight line between points 0.4 rad apart is off by 2 cm a metre."""
    angles = np.arange(0.0, 2.1, 0.4)
    p = [(math.cos(a), math.sin(a), 0.0) for a in angles]
    v = [(-math.sin(a), math.cos(a), 0.0) for a in angles]
    curve = track(angles, p, speeds=v)
    for a in (0.2, 0.77, 1.9):
        pose = curve.at(round(a * S))
        assert math.dist(pose.p_NB, (math.cos(a), math.sin(a), 0.0)) < 0.4**4 / 384 * 1.5
        assert pose.nu[:2] == pytest.approx((-math.sin(a), math.cos(a)), abs=2e-3)


def test_poses_themselves_are_given_back_exactly():
    curve = track([0.0, 0.5, 0.9], [(1, 2, 3), (4, 5, 6), (7, 8, 9)], [0.1, 0.2, 0.3], [(1, 0, 0)] * 3)
    for k, t in enumerate(curve.t_ns):
        pose = curve.at(int(t))
        assert pose.p_NB == tuple(curve.p_NB[k])
        assert pose.q_NB == pytest.approx(tuple(curve.q_NB[k]), abs=1e-15)


def test_the_shorter_way_round_and_either_sign():
    """From 170 to -170 degrees it is 20 degrees over the back, whatever the signs of the quaternions."""
    for sign in (1.0, -1.0):
        curve = track([0.0, 1.0], [(0, 0, 0)] * 2, [math.pi - 0.2, -math.pi + 0.2])
        curve.q_NB[1] *= sign
        pose = curve.at(S // 2)
        assert abs(rpy_from_quat(pose.q_NB)[2]) == pytest.approx(math.pi)
        assert pose.nu[3:] == pytest.approx((0.0, 0.0, 0.4))


def test_velocity_is_told_in_the_body():
    curve = track([0.0, 1.0], [(0, 0, 0), (0, 3, 0)], [math.pi / 2] * 2)
    assert curve.at(S // 2).nu == pytest.approx((3.0, 0, 0, 0, 0, 0), abs=1e-12)


def test_turns_and_their_vectors_are_inverse():
    q = quat_from_rpy(0.3, -1.0, 2.0)
    for turn in ((0.0, 0.0, 0.0), (1e-12, 0.0, 0.0), (0.4, -2.0, 1.0)):
        assert rotation_vector(q, turned(q, turn)) == pytest.approx(turn, abs=1e-15, rel=1e-12)
    assert rotate(turned((1.0, 0.0, 0.0, 0.0), (0, 0, math.pi / 2)), (1, 0, 0)) == pytest.approx((0, 1, 0), abs=1e-15)


@pytest.mark.parametrize(("t", "held"), [(0.5, (0, 0, 0)), (3.5, (2, 0, 0))])
def test_outside_it_is_hidden_or_held(t, held):
    curve = track([1.0, 2.0], [(0, 0, 0), (2, 0, 0)])
    assert curve.at(round(t * S)) is None
    pose = curve.at(round(t * S), outside="hold")
    assert pose.p_NB == held
    assert pose.nu == (0.0,) * 6
    assert pose.age_s == pytest.approx(t - (1.0 if t < 1.0 else 2.0))


def test_the_last_pose_is_still_inside():
    assert track([1.0, 2.0], [(0, 0, 0), (2, 0, 0)]).at(2 * S).p_NB == (2, 0, 0)


def test_a_gap_is_not_bridged():
    curve = track([0.0, 1.5, 2.0], [(0, 0, 0), (3, 0, 0), (4, 0, 0)])
    assert curve.at(S) is None
    assert curve.at(S, "hold").p_NB == (0, 0, 0)
    assert curve.at(S, "hold").age_s == 1.0
    assert curve.at(S, max_gap_s=2.0).p_NB == (2, 0, 0)
    assert curve.at(round(1.75 * S)).p_NB == (3.5, 0, 0)
    assert curve.at(0).p_NB == (0, 0, 0)


def test_a_jump_moves_but_strikes_nothing():
    """An estimator was reset: 300 m in 10 ms are no speed."""
    assert track([0.0, 0.01], [(0, 0, 0), (300, 0, 0)]).at(5_000_000).nu == (0.0,) * 6


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"t_ns": np.array([0, 0])}, "must rise"),
        ({"t_ns": np.array([0.0, 1.0])}, "float64"),
        ({"t_ns": np.array([], np.int64)}, "needs at least one pose"),
        ({"p_NB": np.array([[0, 0, np.nan], [0, 0, 0]])}, "not finite"),
        ({"p_NB": np.array([[0, 0, 2 * FARTHEST_M], [0, 0, 0]])}, "farther"),
        ({"q_NB": np.array([[0.0, 0, 0, 0], [1, 0, 0, 0]])}, "no unit quaternion"),
        ({"q_NB": np.zeros((2, 3))}, "an array of"),
        ({"v_N": np.zeros((3, 3))}, "an array of"),
    ],
)
def test_what_is_no_track_is_refused(change, text):
    given = {"t_ns": np.array([0, S]), "p_NB": np.zeros((2, 3)), "q_NB": np.tile([1.0, 0, 0, 0], (2, 1))}
    with pytest.raises(ValueError, match=text):
        PoseTrack(**{**given, **change})


def test_what_a_foreign_source_gives_is_cleaned_and_told():
    t = np.array([0, 1, 3, 2, 3, 4, 5, 6, 7]) * S
    p = np.zeros((9, 3))
    p[:, 0] = range(9)
    q = np.tile([2.0, 0, 0, 0], (9, 1))
    p[1, 2], p[6, 0] = np.nan, 3e6
    q[5] = 0.0
    clean, remarks = cleaned(t, p, q)
    assert clean.p_NB[:, 0].tolist() == [0, 4, 7, 8]
    assert clean.t_ns.tolist() == [0, 3 * S, 6 * S, 7 * S]
    assert (clean.q_NB == [1.0, 0, 0, 0]).all()
    assert [remark.split(" ", 1)[0] for remark in remarks] == ["1"] * 5
    for what in ("not finite", "no length", "farther", "after a newer one", "same instant"):
        assert sum(what in remark for remark in remarks) == 1


def test_a_good_source_is_taken_as_it_is():
    given = track([0.0, 1.0], [(0, 0, 0), (1, 0, 0)], speeds=[(1, 0, 0)] * 2)
    clean, remarks = cleaned(given.t_ns, given.p_NB, given.q_NB, given.v_N)
    assert remarks == ()
    assert (clean.v_N == given.v_N).all()


def test_no_pose_is_left():
    with pytest.raises(ValueError, match="no pose is left; 2 poses with numbers that are not finite"):
        cleaned(np.array([0, 1]), np.full((2, 3), np.inf), np.ones((2, 4)))
    with pytest.raises(ValueError, match="no pose is left"):
        cleaned(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
