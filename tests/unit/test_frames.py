"""Frames: golden vectors in all three angles, an independent implementation, and the swaps there and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwserver import frames
from uwserver.units import deg, rad

HALF_TURN = math.pi
QUARTER = math.pi / 2
H = math.sqrt(0.5)

components = st.floats(-1e3, 1e3)
vectors = st.tuples(components, components, components)
angles = st.floats(-math.pi, math.pi)
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(c / math.hypot(*q) for c in q))
)


def same_rotation(a, b, tolerance=1e-12):
    return min(math.dist(a, b), math.dist(a, [-c for c in b])) < tolerance


def scipy_of(q) -> Rotation:
    w, x, y, z = q
    return Rotation.from_quat([x, y, z, w])


@pytest.mark.parametrize(
    ("rpy", "q"),
    [
        ((0, 0, 0), (1, 0, 0, 0)),
        ((QUARTER, 0, 0), (H, H, 0, 0)),
        ((0, QUARTER, 0), (H, 0, H, 0)),
        ((0, 0, QUARTER), (H, 0, 0, H)),
        ((QUARTER, 0, QUARTER), (0.5, 0.5, 0.5, 0.5)),
        ((0, 0, HALF_TURN), (0, 0, 0, 1)),
    ],
)
def test_quaternion_of_single_turns(rpy, q):
    assert frames.quat_from_rpy(*rpy) == pytest.approx(q, abs=1e-15)


@pytest.mark.parametrize(
    ("rpy", "axis_B", "axis_N"),
    [
        # Heading east: the bow points east, starboard south.
        ((0, 0, QUARTER), (1, 0, 0), (0, 1, 0)),
        ((0, 0, QUARTER), (0, 1, 0), (-1, 0, 0)),
        # Bow up is positive pitch: the bow points up, which is negative in N.
        ((0, QUARTER, 0), (1, 0, 0), (0, 0, -1)),
        ((0, QUARTER, 0), (0, 0, 1), (1, 0, 0)),
        # Starboard down is positive roll.
        ((QUARTER, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((QUARTER, 0, 0), (0, 0, 1), (0, -1, 0)),
        # Order: first yaw, then pitch, then roll, each about the turned axes.
        ((QUARTER, QUARTER, 0), (0, 1, 0), (1, 0, 0)),
        ((0, QUARTER, QUARTER), (0, 0, 1), (0, 1, 0)),
    ],
)
def test_axes_of_a_turned_vehicle(rpy, axis_B, axis_N):
    assert frames.rotate(frames.quat_from_rpy(*rpy), axis_B) == pytest.approx(axis_N, abs=1e-15)


@given(angles, angles, angles)
def test_euler_angles_are_intrinsic_zyx(roll, pitch, yaw):
    assert same_rotation(frames.quat_from_rpy(roll, pitch, yaw), _wxyz(Rotation.from_euler("ZYX", [yaw, pitch, roll])))


def _wxyz(rotation: Rotation):
    x, y, z, w = rotation.as_quat()
    return (w, x, y, z)


@given(quaternions, vectors)
def test_rotate_against_scipy(q, v):
    assert frames.rotate(q, v) == pytest.approx(scipy_of(q).apply(v), rel=1e-12, abs=1e-9)
    assert frames.rotate(frames.conjugate(q), frames.rotate(q, v)) == pytest.approx(v, rel=1e-12, abs=1e-9)


@given(quaternions, quaternions)
def test_multiply_against_scipy(a, b):
    assert same_rotation(frames.multiply(a, b), _wxyz(scipy_of(a) * scipy_of(b)))


@given(quaternions, quaternions, vectors)
def test_a_product_turns_as_its_factors_one_after_the_other(a, b, v):
    once = frames.rotate(frames.multiply(a, b), v)
    assert once == pytest.approx(frames.rotate(a, frames.rotate(b, v)), rel=1e-9, abs=1e-9)


@given(angles, st.floats(-1.57, 1.57), angles)
def test_angles_come_back(roll, pitch, yaw):
    back = frames.rpy_from_quat(frames.quat_from_rpy(roll, pitch, yaw))
    # asin loses digits towards the vertical; the angles of the same turn differ by whole turns only.
    for given_angle, found in zip((roll, pitch, yaw), back, strict=True):
        assert math.remainder(given_angle - found, math.tau) == pytest.approx(0.0, abs=1e-7)


@given(quaternions)
def test_angles_describe_the_same_attitude(q):
    assert same_rotation(q, frames.quat_from_rpy(*frames.rpy_from_quat(q)), 1e-5)


@pytest.mark.parametrize("pitch", [QUARTER, -QUARTER])
@pytest.mark.parametrize("roll", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("yaw", [0.0, 0.3, -3.0])
def test_angles_describe_the_same_attitude_where_they_are_singular(roll, pitch, yaw):
    q = frames.quat_from_rpy(roll, pitch, yaw)
    found = frames.rpy_from_quat(q)
    assert found[0] == 0.0
    assert found[1] == pitch
    assert same_rotation(q, frames.quat_from_rpy(*found), 1e-9)


def test_rounding_beyond_one_does_not_fail():
    assert frames.rpy_from_quat((H * (1 + 1e-12), 0.0, H * (1 + 1e-12), 0.0))[1] == pytest.approx(QUARTER)


@pytest.mark.parametrize(
    ("ned", "enu"), [((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 0, -1)), ((3, 4, 5), (4, 3, -5))]
)
def test_enu_of_ned(ned, enu):
    assert frames.ned_from_enu(enu) == ned
    assert frames.ned_from_enu(ned) == enu


@pytest.mark.parametrize(("frd", "flu"), [((1, 0, 0), (1, 0, 0)), ((0, 1, 0), (0, -1, 0)), ((1, 2, 3), (1, -2, -3))])
def test_flu_of_frd(frd, flu):
    assert frames.frd_from_flu(flu) == frd
    assert frames.frd_from_flu(frd) == flu


@given(vectors)
def test_swaps_lead_back_and_keep_lengths(v):
    for swap in (frames.ned_from_enu, frames.frd_from_flu):
        assert swap(swap(v)) == v
        assert math.hypot(*swap(v)) == pytest.approx(math.hypot(*v))


@given(vectors, vectors)
def test_swaps_are_rotations_not_mirrors(a, b):
    for swap in (frames.ned_from_enu, frames.frd_from_flu):
        assert np.cross(swap(a), swap(b)) == pytest.approx(np.array(swap(np.cross(a, b))), abs=1e-6)


@pytest.mark.parametrize(
    ("rpy_ned", "rpy_enu"),
    [
        # Degrees. Heading north is a yaw of 90 from east; clockwise becomes counter-clockwise; roll stays; bow up becomes negative.
        ((0, 0, 0), (0, 0, 90)),
        ((0, 0, 90), (0, 0, 0)),
        ((0, 0, -90), (0, 0, 180)),
        ((20, 0, 0), (20, 0, 90)),
        ((0, 20, 0), (0, -20, 90)),
        ((10, 20, 30), (10, -20, 60)),
        ((-170, -80, 100), (-170, 80, -10)),
    ],
)
def test_attitude_in_enu_and_flu(rpy_ned, rpy_enu):
    q = frames.attitude_enu_flu(frames.quat_from_rpy(*map(rad, rpy_ned)))
    found = [deg(angle) for angle in frames.rpy_from_quat(q)]
    for expected, angle in zip(rpy_enu, found, strict=True):
        assert math.remainder(expected - angle, 360) == pytest.approx(0.0, abs=1e-9)


@given(quaternions, vectors)
def test_attitude_in_enu_turns_the_same_vector(q_NB, v_B):
    """The way round by the other frames ends at the same place: v_ENU = R(q_ENU_FLU) v_FLU."""
    v_FLU = frames.frd_from_flu(v_B)
    v_ENU = frames.rotate(frames.attitude_enu_flu(q_NB), v_FLU)
    assert frames.ned_from_enu(v_ENU) == pytest.approx(frames.rotate(q_NB, v_B), rel=1e-9, abs=1e-9)


@given(quaternions)
def test_attitude_in_enu_leads_back(q):
    assert same_rotation(frames.attitude_enu_flu(frames.attitude_enu_flu(q)), q)


def test_degrees():
    assert rad(180.0) == math.pi
    assert deg(math.pi / 6) == pytest.approx(30.0)


@given(quaternions, vectors)
def test_the_matrix_turns_as_the_quaternion_does(q, v):
    R = np.array(frames.matrix(q))
    assert np.allclose(R @ v, frames.rotate(q, v), rtol=0.0, atol=1e-9)
    assert np.allclose(R, scipy_of(q).as_matrix(), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("w", [(0.3, -0.2, 0.5), (0.0, 0.0, 2.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("t", [0.7, -1.3, 0.0])
def test_a_spin_is_what_a_constant_rate_turns_by(w, t):
    scalar, x, y, z = frames.spin(w, t)
    assert Rotation.from_quat([x, y, z, scalar]).as_rotvec() == pytest.approx(t * np.array(w), abs=1e-12)
