"""Contacts in closed form: what a plane and balls say of bodies near them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Balls, Floor

from uwserver.frames import quat_from_rpy
from uwserver.physics.kernel.arrays import FloatArray

FEET = ((0.2, 0.0, 0.1), (-0.2, 0.0, 0.1))


def state(*poses: tuple[tuple[float, float, float], tuple[float, float, float]]) -> FloatArray:
    rows = np.zeros((len(poses), 13))
    for row, (p, rpy) in zip(rows, poses, strict=True):
        row[:3], row[3:7] = p, quat_from_rpy(*rpy)
    return rows


LEVEL = (0.0, 0.0, 0.0)


def test_points_near_a_floor_are_contacts_on_it() -> None:
    floor = Floor({1: FEET}, friction=0.3, restitution=0.2)
    found = floor.find_contacts(state(((0.0, 0.0, 0.0), LEVEL), ((1.0, 2.0, -0.11), LEVEL)), 0.01)
    assert found.body_a.tolist() == [1, 1]
    assert found.body_b.tolist() == [-1, -1]
    assert found.gap.tolist() == pytest.approx([0.01, 0.01])
    np.testing.assert_allclose(found.point, [[1.2, 2.0, -0.01], [0.8, 2.0, -0.01]])
    np.testing.assert_array_equal(found.normal, [[0.0, 0.0, -1.0]] * 2)
    assert len(set(found.key.tolist())) == 2
    assert (found.friction.tolist(), found.restitution.tolist()) == ([0.3] * 2, [0.2] * 2)


def test_a_body_that_leans_has_one_foot_down() -> None:
    found = Floor({0: FEET}).find_contacts(state(((0.0, 0.0, -0.1), (0.0, 0.3, 0.0))), 0.01)
    assert len(found.gap) == 1
    assert found.point[0, 0] < 0.0  # bow up, stern down


def test_a_slope_has_its_own_normal_and_place() -> None:
    floor = Floor({0: ((0.0, 0.0, 0.0),)}, normal=(0.0, -3.0, -4.0), origin=(0.0, 0.0, 5.0))
    found = floor.find_contacts(state(((0.0, 0.0, 4.99), LEVEL)), 0.01)
    np.testing.assert_allclose(found.normal, [[0.0, -0.6, -0.8]])
    assert found.gap.tolist() == pytest.approx([0.008])


def test_what_is_farther_than_the_margin_is_no_contact() -> None:
    for z, contacts in ((-0.14, 2), (-0.16, 0), (5.0, 2)):
        assert len(Floor({0: FEET}).find_contacts(state(((0.0, 0.0, z), LEVEL)), 0.01).gap) == contacts


def test_balls_touch_on_the_line_between_their_middles() -> None:
    balls = Balls({0: ((0.0, 0.0, 0.0), 0.3), 2: ((0.1, 0.0, 0.0), 0.2)}, restitution=0.5)
    found = balls.find_contacts(
        state(((0.0, 0.0, 0.0), LEVEL), ((9.0, 9.0, 9.0), LEVEL), ((0.0, 0.41, 0.0), (0.0, 0.0, math.pi / 2))), 0.01
    )
    assert (found.body_a.tolist(), found.body_b.tolist()) == ([0], [2])
    np.testing.assert_allclose(found.normal, [[0.0, -1.0, 0.0]], rtol=0.0, atol=1e-15)
    assert found.gap.tolist() == pytest.approx([0.01])
    np.testing.assert_allclose(found.point, [[0.0, 0.305, 0.0]], rtol=0.0, atol=1e-15)


def test_each_pair_of_balls_has_its_key() -> None:
    balls = Balls(dict.fromkeys(range(3), ((0.0, 0.0, 0.0), 1.0)))
    found = balls.find_contacts(state(*(((1.0 * k, 0.0, 0.0), LEVEL) for k in range(3))), 0.01)
    assert list(zip(found.body_a.tolist(), found.body_b.tolist(), strict=True)) == [(0, 1), (0, 2), (1, 2)]
    assert len(set(found.key.tolist())) == 3
