"""One set of solids in both engines: contacts and rays know the same things by the same ids."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import BadSolid, Box, HalfSpace, Placed, Solid, Sphere
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.scene import Scene

GROUND = Solid("ground", (Placed(HalfSpace(), (0.0, 0.0, 10.0)),))
BALL = Solid("ball", (Placed(Sphere(0.5)),))
DOWN = np.array([[0.0, 0.0, 1.0]])


@pytest.fixture
def state() -> FloatArray:
    """A body that touches the ground, and one far above it."""
    rows = np.zeros((2, 13))
    rows[:, 3] = 1.0
    rows[0, 2], rows[1, 0] = 9.5, 30.0
    return rows


def test_both_engines_know_a_solid_by_one_id(state: FloatArray) -> None:
    scene = Scene(lambda: state)
    ground, ball, other = scene.add_static(GROUND), scene.add_moving(BALL, 0), scene.add_moving(BALL, 1)
    assert len({ground, ball, other}) == 3
    contacts = scene.find_contacts(state, 0.01)
    assert contacts.body_a.tolist() == [0]
    assert contacts.body_b.tolist() == [-1]
    origins = np.array([[0.0, 0.0, 5.0], [30.0, 0.0, -5.0], [60.0, 0.0, 0.0]])
    hits = scene.raycast(origins, np.repeat(DOWN, 3, axis=0), 100.0)
    assert hits.body.tolist() == [ball, other, ground]
    np.testing.assert_allclose(hits.distance, [4.0, 4.5, 10.0], rtol=1e-3)


def test_rays_meet_bodies_where_they_are_now(state: FloatArray) -> None:
    scene = Scene(lambda: state)
    ball = scene.add_moving(BALL, 0)
    state[0, :3] = 3.0, 0.0, 2.0
    hit = scene.raycast(np.array([[3.0, 0.0, 0.0]]), DOWN, 10.0)
    assert (hit.body[0], hit.distance[0]) == (ball, pytest.approx(1.5, rel=1e-3))


def test_what_is_removed_is_gone_from_both(state: FloatArray) -> None:
    scene = Scene(lambda: state)
    ground, ball = scene.add_static(GROUND), scene.add_moving(BALL, 0)
    scene.remove(ball)
    assert len(scene.find_contacts(state, 0.01).gap) == 0
    assert scene.raycast(np.zeros((1, 3)), DOWN, 100.0).body[0] == ground
    with pytest.raises(KeyError):
        scene.remove(ball)
    assert scene.add_moving(BALL, 0) not in (ground, ball)


def test_a_refused_solid_is_in_neither(state: FloatArray) -> None:
    scene = Scene(lambda: state)
    for bad in (Solid("moving ground", GROUND.shapes), Solid("nothing", (Placed(Box((1.0, 0.0, 1.0))),))):
        with pytest.raises(BadSolid):
            scene.add_moving(bad, 0)
    assert len(scene.find_contacts(state, 0.01).gap) == 0
    assert scene.raycast(np.zeros((1, 3)), DOWN, 100.0).body[0] == -1


def test_what_is_led_yields_to_nothing_and_pushes_what_can_move() -> None:
    """Three balls in one place above the ground, which all of them touch: only the free one feels anything."""
    rows = np.zeros((3, 13))
    rows[:, 3] = 1.0
    rows[:, 2] = 9.5
    scene = Scene(lambda: rows)
    scene.add_static(GROUND)
    scene.add_moving(BALL, 0, led=True)
    other = scene.add_moving(BALL, 1, led=True)
    assert len(scene.find_contacts(rows, 0.01).gap) == 0
    scene.add_moving(BALL, 2)
    contacts = scene.find_contacts(rows, 0.01)
    pairs = {frozenset(pair) for pair in zip(contacts.body_a.tolist(), contacts.body_b.tolist(), strict=True)}
    assert pairs == {frozenset((2, -1)), frozenset((2, 0)), frozenset((2, 1))}
    assert contacts.normal.flags.c_contiguous
    scene.remove(other)
    scene.add_moving(BALL, 1)
    pairs = {
        frozenset(pair)
        for pair in zip(*(column.tolist() for column in scene.find_contacts(rows, 0.01)[:2]), strict=True)
    }
    assert frozenset((1, -1)) in pairs
    assert frozenset((0, -1)) not in pairs
