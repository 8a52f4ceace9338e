"""Quaternions and angles against rotation matrices of the sequence z-y-x, and against the server's own conversions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from uwclient import attitude

ANGLES = [(0.0, 0.0, 0.0), (0.3, -0.4, 2.9), (-3.0, 1.2, -1.0), (1e-9, 0.0, 3.14), (0.0, -1.5, 0.5)]


def matrix(roll: float, pitch: float, yaw: float) -> np.ndarray:
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@pytest.mark.parametrize("rpy", ANGLES)
def test_angles_become_a_rotation_and_come_back(rpy):
    q = attitude.from_rpy(*rpy)
    v = (0.3, -1.2, 0.7)
    np.testing.assert_allclose(attitude.rotate(q, v), matrix(*rpy) @ v, atol=1e-12)
    np.testing.assert_allclose(attitude.rotate(attitude.inverse(q), attitude.rotate(q, v)), v, atol=1e-12)
    np.testing.assert_allclose(attitude.to_rpy(q), rpy, atol=1e-9)


@pytest.mark.parametrize("rpy", ANGLES)
def test_the_server_means_the_same(rpy):
    import uwserver
    from uwserver.scenario.builder import ScenarioBuilder

    scenario = ScenarioBuilder("a", seed=1).vehicle(
        "rov", "bluerov2", position_ned_m=(0, 0, 5), attitude_rpy_deg=tuple(math.degrees(a) for a in rpy)
    )
    q = uwserver.load(scenario.build()).vehicles["rov"].pose.q_NB
    sign = math.copysign(1.0, np.dot(q, attitude.from_rpy(*rpy)))
    np.testing.assert_allclose(q, sign * np.array(attitude.from_rpy(*rpy)), atol=1e-9)


@pytest.mark.parametrize("pitch", [0.5 * math.pi, -0.5 * math.pi])
def test_straight_up_and_down_all_turning_is_yaw(pitch):
    q = attitude.from_rpy(0.0, pitch, 0.7)
    np.testing.assert_allclose(attitude.to_rpy(q), (0.0, pitch, 0.7), atol=1e-6)


def test_products_and_the_error_of_an_attitude():
    one, other = attitude.from_rpy(0.1, 0.2, 0.3), attitude.from_rpy(-0.4, 0.5, 2.0)
    v = (1.0, 2.0, 3.0)
    both = attitude.rotate(attitude.product(one, other), v)
    np.testing.assert_allclose(both, attitude.rotate(one, attitude.rotate(other, v)), atol=1e-12)
    turn = attitude.product(attitude.inverse(one), attitude.product(one, attitude.from_rpy(0.0, 0.0, -2.5)))
    for q in (turn, tuple(-each for each in turn)):
        np.testing.assert_allclose(attitude.rotation_vector(q), (0.0, 0.0, -2.5), atol=1e-12)
    assert attitude.rotation_vector((1.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


def test_the_short_way_round():
    assert attitude.wrapped(math.radians(350)) == pytest.approx(math.radians(-10))
    assert attitude.wrapped(-3.5) == pytest.approx(2 * math.pi - 3.5)
    assert attitude.heading(attitude.from_rpy(0.2, 0.3, -2.0)) == pytest.approx(-2.0)
