"""Contacts of solid things: exact where they touch, a pure function of the poses, blind to the edges inside a smooth surface.

Also of uwserver.physics.collision.contacts.
"""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.collision.contacts import NO_CONTACTS
from uwserver.physics.collision.solids import Solids
from uwserver.physics.geometry.shapes import (
    BadSolid,
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)

DT = 1.0 / 240.0
CORNERS = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.2, 0.2) for z in (-0.1, 0.1)])
COLUMNS = ("body_a", "body_b", "point", "normal", "gap", "key", "friction", "restitution")


def grid(n, spacing, height=lambda x, y: 0.0 * x):
    """A surface of 2 (n-1)^2 triangles with its outside up (-z), depth = height(x, y)."""
    x = (np.arange(n) - (n - 1) / 2) * spacing
    X, Y = np.meshgrid(x, x, indexing="ij")
    vertices = np.stack([X, Y, height(X, Y)], -1).reshape(-1, 3)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    faces = [np.stack(f, -1).reshape(-1, 3) for f in ((a, d, b), (b, d, c))]
    return TriangleMesh(vertices, np.concatenate(faces))


def state(*poses, nu=(0.0,) * 6):
    return np.array([[*p, *quat_from_rpy(*rpy), *nu] for p, rpy in poses])


def world(*static, gate=True):
    solids = Solids(gate)
    for shape in static:
        solids.add_static(Solid("static", (shape if isinstance(shape, Placed) else Placed(shape),)))
    return solids


def body(*shapes, **numbers):
    return Solid("body", tuple(s if isinstance(s, Placed) else Placed(s) for s in shapes), **numbers)


FLOORS = {
    "half-space": Placed(HalfSpace()),
    "large box": Placed(Box((5.0, 5.0, 0.5)), (0.0, 0.0, 0.5)),
    "two triangles": Placed(grid(2, 10.0)),
    "coarse mesh": Placed(grid(21, 0.5)),
    "fine mesh": Placed(grid(101, 0.05)),
}
RESTING = {  # shapes, height of the origin, contacts
    "box": (body(Box((0.3, 0.2, 0.1))), 0.1, 4),
    "hull": (body(ConvexHull(CORNERS)), 0.1, 4),
    "sphere": (body(Sphere(0.1)), 0.1, 1),
    "cylinder on its side": (body(Cylinder(0.1, 0.3)), 0.1, 2),
    "cylinder on its end": (body(Placed(Cylinder(0.1, 0.3), q=quat_from_rpy(0, np.pi / 2, 0))), 0.3, 4),
    "capsule": (body(Capsule(0.1, 0.3)), 0.1, 2),
    "compound": (body(*(Placed(Box((0.1, 0.2, 0.1)), (x, 0.0, 0.02)) for x in (-0.2, 0.2))), 0.12, 8),
}


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3, -1e-3])
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("name", RESTING)
def test_at_rest_the_gap_is_that_of_the_exact_shapes(name, floor, gap):
    solid, height, count = RESTING[name]
    with world(FLOORS[floor]) as solids:
        solids.add_moving(solid, 0)
        contacts = solids.find_contacts(state(((0.13, 0.07, -height - gap), (0.0, 0.0, 0.3))), DT)
    assert len(contacts.gap) == count
    assert np.allclose(contacts.gap, gap, rtol=0.0, atol=1e-9)
    assert np.allclose(contacts.normal, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-9)
    assert np.allclose(contacts.point[:, 2], -gap / 2, rtol=0.0, atol=1e-9)
    assert set(contacts.body_a) == {0}
    assert set(contacts.body_b) == {-1}
    assert len(set(contacts.key)) == count


@pytest.mark.parametrize("floor", FLOORS)
def test_a_box_rests_on_its_four_corners(floor):
    with world(FLOORS[floor]) as solids:
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        found = solids.find_contacts(state(((0.13, 0.07, -0.1), (0.0, 0.0, 0.3))), DT)
    corners = CORNERS[CORNERS[:, 2] > 0] @ np.array(matrix(quat_from_rpy(0.0, 0.0, 0.3))).T + [0.13, 0.07, -0.1]
    assert np.allclose(np.sort(found.point[:, 0]), np.sort(corners[:, 0]), rtol=0.0, atol=1e-9)


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in COLUMNS)


def poses(n, seed, depth=-0.15):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        p = [*rng.uniform(-3.0, 3.0, 2), depth + rng.uniform(-0.1, 0.1)]
        yield tuple(p), tuple(rng.uniform(-1.0, 1.0, 3) * [0.6, 0.6, 3.0])


@pytest.mark.parametrize("shape", [Box((0.3, 0.2, 0.1)), ConvexHull(CORNERS)])
def test_a_moved_world_gives_the_contacts_of_a_fresh_one(shape):
    rough = grid(41, 0.25, lambda x, y: 0.05 * np.sin(3 * x) + 0.05 * np.cos(4 * y))
    touching = 0
    with world(rough) as moved:
        moved.add_moving(body(shape), 0)
        for k, pose in enumerate(poses(60, 1)):
            first = moved.find_contacts(state(pose), DT)
            with world(rough) as fresh:
                fresh.add_moving(body(shape), 0)
                assert same(first, fresh.find_contacts(state(pose), DT)), f"pose {k}"
            touching += len(first.gap) > 0
    assert touching > 18


def test_the_gate_changes_no_contact():
    rough = grid(41, 0.25, lambda x, y: 0.05 * np.sin(3 * x) + 0.05 * np.cos(4 * y))
    block = Placed(Box((0.5, 0.5, 0.2)), (1.0, 1.0, -0.1))
    bodies = [body(Box((0.3, 0.2, 0.1))), body(Capsule(0.1, 0.2)), body(Sphere(0.15))]
    with world(rough, block) as gated, world(rough, block, gate=False) as ungated:
        for solids in (gated, ungated):
            for row, solid in enumerate(bodies):
                solids.add_moving(solid, row)
        touching = 0
        for seed in range(150):
            x = state(*poses(3, seed), nu=(0.5, 0.0, 0.2, 0.0, 1.0, 0.0))
            contacts = gated.find_contacts(x, DT)
            assert same(contacts, ungated.find_contacts(x, DT)), f"seed {seed}"
            touching += len(contacts.gap) > 0
    assert touching > 60


@pytest.mark.parametrize("name", ["box", "hull", "sphere", "cylinder on its side", "capsule"])
def test_a_body_does_not_catch_on_the_edges_of_a_flat_mesh(name):
    solid, height, count = RESTING[name]
    tiles = [Placed(grid(21, 0.1), (x, 0.0, 0.0)) for x in (-1.0, 1.0)]  # they share the border x = 0
    rng = np.random.default_rng(3)
    with world(*tiles) as solids:
        solids.add_moving(solid, 0)
        for _ in range(100):
            x, y, yaw = rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3.0, 3.0)
            gap = rng.uniform(-2e-3, 2e-3)
            found = solids.find_contacts(state(((x, y, -height - gap), (0.0, 0.0, yaw)), nu=(1.0, *[0.0] * 5)), DT)
            assert len(found.gap) >= count
            assert np.allclose(found.normal, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-9)
            assert np.allclose(found.gap, gap, rtol=0.0, atol=1e-9)


def test_a_ridge_is_felt_where_it_is_sharp():
    roof = grid(3, 1.0, lambda x, y: np.abs(x))  # 45 degrees to both sides of x = 0
    with world(roof) as solids:
        solids.add_moving(body(Sphere(0.2)), 0)
        on_top = solids.find_contacts(state(((0.0, 0.3, -0.2), (0.0, 0.0, 0.0))), DT)
        leaning = solids.find_contacts(state(((0.2 * np.sin(0.5), 0.3, -0.2 * np.cos(0.5)), (0.0, 0.0, 0.0))), DT)
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 1)
        across = solids.find_contacts(state(((0.0, 5.0, 0.0), (0, 0, 0)), ((0.0, 0.1, -0.1), (0, 0, 0))), DT)
    assert np.allclose(on_top.normal, [[0.0, 0.0, -1.0]], atol=1e-6)
    assert np.allclose(leaning.normal, [[np.sin(0.5), 0.0, -np.cos(0.5)]], atol=1e-6)
    assert np.allclose(leaning.gap, 0.0, atol=1e-6)
    touching = across.gap < 1e-6  # the part of the ridge under the box, and nothing deeper
    assert np.allclose(across.gap[touching], 0.0, atol=1e-9)
    assert np.ptp(across.point[touching, 1]) == pytest.approx(0.4, abs=1e-6)


def test_corner_between_floor_and_wall():
    wall = Placed(Box((0.5, 5.0, 5.0)), (0.8, 0.0, 0.0))
    with world(FLOORS["coarse mesh"], wall) as solids:
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        found = solids.find_contacts(state(((0.0, 0.0, -0.1), (0.0, 0.0, 0.0))), DT)
    down, aside = found.normal[:, 2] < -0.99, found.normal[:, 0] < -0.99
    assert (down.sum(), aside.sum(), len(found.gap)) == (4, 4, 8)
    assert np.allclose(found.gap, 0.0, atol=1e-9)


def test_two_bodies_and_their_coefficients():
    with world() as solids:
        solids.add_moving(body(Box((0.3, 0.3, 0.3)), friction=0.9, restitution=0.1), 0)
        solids.add_moving(body(Sphere(0.2), friction=0.4, restitution=0.5), 2)
        away = ((50.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        found = solids.find_contacts(state(((1.0, 0, 0), (0, 0, 0)), away, ((1.501, 0.1, 0.0), (0, 0, 0))), DT)
    assert (found.body_a.tolist(), found.body_b.tolist()) == ([0], [2])
    assert np.allclose(found.normal, [[-1.0, 0.0, 0.0]])
    assert found.gap[0] == pytest.approx(1e-3, abs=1e-12)
    assert found.friction[0] == pytest.approx(0.6)
    assert found.restitution[0] == 0.5


def test_crossed_edges():
    turned_45 = (np.pi / 4, 0.0, 0.0)
    reach = 0.1 * np.sqrt(2.0)
    with world(Placed(Box((1.0, 0.1, 0.1)), q=quat_from_rpy(*turned_45))) as solids:
        solids.add_moving(body(Placed(Box((1.0, 0.1, 0.1)), q=quat_from_rpy(*turned_45))), 0)
        found = solids.find_contacts(state(((0.2, 0.1, -2 * reach - 1e-4), (0.0, 0.0, np.pi / 2))), DT)
    assert np.allclose(found.normal, [[0.0, 0.0, -1.0]], atol=1e-6)
    assert np.allclose(found.gap, 1e-4, atol=1e-6)
    assert np.allclose(found.point, [[0.2, 0.0, -reach]], atol=1e-3)


def test_far_away_costs_no_contact_and_a_fast_body_is_seen_earlier():
    with world(FLOORS["coarse mesh"]) as solids:
        solids.add_moving(body(Sphere(0.1)), 0)
        above = ((0.1, 0.1, -0.12), (0.0, 0.0, 0.0))
        assert solids.find_contacts(state(above), DT) is NO_CONTACTS
        assert len(solids.find_contacts(state(above, nu=(0, 0, 5.0, 0, 0, 0)), DT).gap) == 1
        assert len(NO_CONTACTS.gap) == 0


def test_where_no_body_is_nothing_touches():
    assert Solids().find_contacts(np.zeros((0, 13)), DT) is NO_CONTACTS


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_a_state_that_is_not_finite_is_nowhere(bad):
    with world(FLOORS["coarse mesh"], HalfSpace()) as solids:
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        x = state(((0.0, 0.0, -0.1), (0.0, 0.0, 0.0)))
        for column in range(13):
            spoilt = x.copy()
            spoilt[0, column] = bad
            solids.find_contacts(spoilt, DT)
        assert len(solids.find_contacts(x, DT).gap) == 8


def test_keys_stay_while_a_box_slides():
    with world(FLOORS["coarse mesh"]) as solids:
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        keys = [set(solids.find_contacts(state(((x, 0.02, -0.1), (0, 0, 0.3))), DT).key) for x in np.arange(0, 1, 0.05)]
    assert all(k == keys[0] for k in keys)


def test_what_is_removed_is_gone_and_others_keep_their_keys():
    with world(HalfSpace()) as solids:
        first = solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 1)
        x = state(((0.0, 0.0, -0.1), (0, 0, 0)), ((9.0, 0.0, -0.1), (0, 0, 0)))
        before = solids.find_contacts(x, DT)
        solids.remove(first)
        after = solids.find_contacts(x, DT)
        assert set(after.body_a) == {1}
        assert set(after.key) == set(before.key[before.body_a == 1])
        with pytest.raises(KeyError):
            solids.remove(first)


def test_what_comes_and_goes_touches_as_if_new():
    """An engine may keep what it made, and use it again."""
    floor, form = grid(5, 1.0), body(Box((0.3, 0.2, 0.1)), Placed(Cylinder(0.1, 0.2), (0.0, 0.0, 0.2)))
    with world(floor) as solids, world(floor) as fresh:
        for k in range(20):
            both = [solids.add_moving(form, row) for row in (0, 1)]
            touching = state(((0.1 * k, 0.0, -0.25), (0.0, 0.1, 0.0)), ((0.1 * k, 0.3, -0.3), (0.0, 0.0, 0.1 * k)))
            found = solids.find_contacts(touching, DT)
            for one in both[:: (-1) ** k]:
                solids.remove(one)
        for row in (0, 1):
            fresh.add_moving(form, row)
        assert same(found, fresh.find_contacts(touching, DT))
        assert len(found.gap) > 4


def test_what_is_spawned_under_a_seabed_is_pushed_up():
    with world(FLOORS["coarse mesh"]) as solids:
        solids.add_moving(body(Box((0.3, 0.2, 0.1))), 0)
        found = solids.find_contacts(state(((0.1, 0.1, 0.06), (0.0, 0.0, 0.0))), DT)
    assert len(found.gap) == 4
    assert np.allclose(found.normal, [0.0, 0.0, -1.0])
    assert np.allclose(found.gap, -0.16)


@pytest.mark.parametrize(
    ("shape", "text"),
    [
        (Box((0.1, 0.0, 0.1)), "positive"),
        (Sphere(float("nan")), "positive"),
        (ConvexHull(np.zeros((8, 3))), "plane"),
        (ConvexHull(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 1]])), "not finite"),
        (TriangleMesh(np.eye(3) * np.nan, np.array([[0, 1, 2]])), "not finite"),
        (TriangleMesh(np.eye(3), np.array([[0, 1, 3]])), "names vertex 3"),
        (TriangleMesh(np.eye(3), np.array([[0, 1, 1]])), "no area"),
        (TriangleMesh(np.eye(3), np.zeros((0, 3), int)), "at least one"),
        (TriangleMesh(np.eye(3), np.tile([[0, 1, 2]], (100_001, 1))), "tiles"),
    ],
)
def test_what_would_crash_an_engine_is_refused(shape, text):
    with world() as solids, pytest.raises(BadSolid, match=text):
        solids.add_static(body(shape))


def test_a_mesh_cannot_move():
    with world() as solids, pytest.raises(BadSolid, match="hull"):
        solids.add_moving(body(grid(2, 1.0)), 0)


def test_the_arrays_are_made_anew_once_for_all_that_came_and_went(monkeypatch):
    made = []
    rebuild = Solids._rebuild
    monkeypatch.setattr(Solids, "_rebuild", lambda self: (made.append(1), rebuild(self)))
    with Solids() as solids:
        box = Solid("box", (Placed(Box((0.5, 0.5, 0.5))),))
        ids = [solids.add_moving(box, row) for row in range(20)]
        for each in ids[5:]:
            solids.remove(each)
        state = np.zeros((20, 13))
        state[:, 3] = 1.0
        state[:, 0] = 10.0 * np.arange(20)
        assert not len(solids.find_contacts(state, 0.01).gap)
        state[:5, 0] = 0.0
        assert {*solids.find_contacts(state, 0.01).body_a.tolist()} == {0, 1, 2, 3}
    assert len(made) == 1
