"""Rays through both pickers against brute force over all triangles in float64, and against closed forms."""

from __future__ import annotations

import threading
from functools import cache

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.geometry.shapes import (
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
from uwserver.physics.rays import surfaces
from uwserver.physics.rays.casting import Rays
from uwserver.physics.rays.rows import facets
from uwserver.physics.rays.surfaces import make_picker
from uwserver.testing.fake_geometry import FakeGeometry, Plane


@pytest.fixture(params=["embree", "tree"], autouse=True)
def picker(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Every test runs with Embree and, as on a machine without it, with our own tree."""
    if request.param == "tree":
        monkeypatch.setattr(surfaces, "find_spec", lambda name: None)
    else:
        pytest.importorskip("embreex")
    return str(request.param)


STATE = np.array([[2.0, -1.0, 3.0, *quat_from_rpy(0.3, -0.2, 1.0), *[0.0] * 6]])


def unit(rng, n):
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def terrain(n=60, spacing=1.0):
    x = (np.arange(n) - (n - 1) / 2) * spacing
    X, Y = np.meshgrid(x, x, indexing="ij")
    vertices = np.stack([X, Y, 10 + 2 * np.sin(X / 4) + 2 * np.cos(Y / 5)], -1).reshape(-1, 3)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    return TriangleMesh(vertices, np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, d, b), (b, d, c))]))


def brute_force(corners, sided, origin, direction):
    """Nearest hit of each ray on triangles (t, 3, 3): range, normal. Moeller and Trumbore 1997, every ray on every triangle."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    best, normals = np.full(len(origin), np.inf), np.zeros((len(origin), 3))
    n = np.cross(u, v)
    for k, (o, d) in enumerate(zip(origin, direction, strict=True)):
        p = np.cross(d, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / np.einsum("ij,ij->i", u, p)
            s = o - a
            q = np.cross(s, u)
            bu, bv = np.einsum("ij,ij->i", s, p) * inverse, q @ d * inverse
            t = np.einsum("ij,ij->i", v, q) * inverse
            hit = (bu >= 0) & (bv >= 0) & (bu + bv <= 1) & (t >= 0) & ~((n @ d > 0) & (sided != 0))
        if hit.any():
            t = np.where(hit, t, np.inf)
            j = int(t.argmin())
            best[k], normals[k] = t[j], n[j] / np.linalg.norm(n[j]) * (1 if n[j] @ d < 0 else -1)
    return best, normals


def agree(hits, distance, normal, allowed=0):
    """The same but for at most `allowed` rays, which pass an edge within the engine's rounding."""
    same = np.isclose(hits.distance, distance, rtol=1e-9, atol=1e-9)  # inf is close to inf
    assert (~same).sum() <= allowed
    flat = same & np.isfinite(distance)
    turned_away = np.abs(hits.normal[flat] - normal[flat]).max(axis=1, initial=0.0) > 1e-9
    assert turned_away.sum() <= allowed
    return int(flat.sum())


@cache
def seabed():
    """A mesh, 1000 rays, and what they hit."""
    mesh = Solid("seabed", (Placed(terrain(), p=(5000.0, -3000.0, 20.0)),), material=4)
    rng = np.random.default_rng(1)
    origin, direction = rng.uniform(-25, 25, (1000, 3)) * [1, 1, 0.3] + [5000, -3000, 20], unit(rng, 1000)
    parts = facets(mesh)
    return mesh, origin, direction, brute_force(parts.corners, parts.sided, origin, direction)


def test_a_mesh_against_brute_force():
    mesh, origin, direction, expected = seabed()
    rays = Rays()
    rays.add_static(9, mesh)
    hits = rays.at(STATE).raycast(origin, direction, np.inf)
    assert agree(hits, *expected, allowed=2) > 250
    assert set(hits.body) == {-1, 9}
    assert set(hits.material) == {-1, 4}


SHAPES = [
    Box((0.5, 0.3, 0.2)),
    Cylinder(0.3, 0.6),
    Sphere(0.5),
    Capsule(0.2, 0.4),
    ConvexHull(unit(np.random.default_rng(5), 40)),
]


@cache
def moving(k):
    """A shape with a rod through it, 500 rays towards it, and what they hit."""
    pose = (0.4, 0.0, 0.1), quat_from_rpy(0.1, 0.2, 0.3)
    solid = Solid("it", (Placed(SHAPES[k], *pose), Placed(Box((0.1, 0.1, 0.9)), material=7)))
    rng = np.random.default_rng(2)
    at = STATE[0, :3]
    origin = at + 3.0 * unit(rng, 500)
    direction = at + rng.uniform(-1, 1, (500, 3)) - origin
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    parts = facets(solid)
    corners = parts.corners @ np.array(matrix(STATE[0, 3:7])).T + at
    return solid, origin, direction, brute_force(corners, parts.sided, origin, direction)


@pytest.mark.parametrize("k", range(len(SHAPES)), ids=lambda k: type(SHAPES[k]).__name__)
def test_a_moving_solid_against_brute_force(k):
    solid, origin, direction, expected = moving(k)
    rays = Rays()
    rays.add_moving(3, solid, 0)
    hits = rays.at(STATE).raycast(origin, direction, 50.0)
    assert agree(hits, *expected, allowed=2) > 75
    assert set(hits.material) == {-1, 0, 7}


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_facets_face_outward_and_lie_on_the_shape(shape):
    corners = facets(Solid("it", (Placed(shape),))).corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normal, corners.mean(axis=1)) > 0).all()
    volume = np.einsum("ij,ij->i", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]).sum() / 6
    exact = {
        Box: 8 * 0.5 * 0.3 * 0.2, Cylinder: np.pi * 0.09 * 1.2, Sphere: np.pi / 6,
        Capsule: np.pi * 0.04 * 0.8 + 4 / 3 * np.pi * 0.008,
    }.get(type(shape))  # fmt: skip
    if exact is not None:
        assert volume == pytest.approx(exact, rel=5e-3)


def test_the_nearest_wins_and_far_things_are_not_seen():
    rays = Rays()
    rays.add_static(0, Solid("floor", (Placed(HalfSpace(), (0.0, 0.0, 20.0)),), material=2))
    rays.add_static(1, Solid("box", (Placed(Box((1.0, 1.0, 1.0)), (0.0, 0.0, 10.0)),), material=3))
    rays.add_moving(2, Solid("rov", (Placed(Sphere(0.5)),)), 0)
    down = np.tile([[0.0, 0.0, 1.0]], (4, 1))
    origin = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [2.0, -1.0, 0.0], [0.0, 0.0, 9.5]])
    hits = rays.at(STATE).raycast(origin, down, 100.0)
    assert hits.body.tolist() == [1, 0, 2, 0]  # the last starts inside the box
    assert hits.material.tolist() == [3, 2, 0, 2]
    assert np.allclose(hits.distance, [9.0, 20.0, 2.5, 10.5], atol=2e-3)
    assert np.allclose(hits.normal[[0, 1, 3]], [0.0, 0.0, -1.0])
    near = rays.at(STATE).raycast(origin, down, 9.0)
    assert near.body.tolist() == [1, -1, 2, -1]
    assert np.isinf(near.distance[1])
    assert not near.normal[1].any()


def test_half_space_as_the_fake_plane():
    rng = np.random.default_rng(4)
    q = quat_from_rpy(0.2, -0.3, 0.5)
    rays = Rays()
    rays.add_static(0, Solid("slope", (Placed(HalfSpace(), (1.0, 2.0, 30.0), q),)))
    fake = FakeGeometry([Plane((1.0, 2.0, 30.0), tuple(-np.array(matrix(q))[:, 2]))])
    origin, direction = rng.uniform(-20, 20, (500, 3)), unit(rng, 500)
    ours, theirs = (g.raycast(origin, direction, 60.0) for g in (rays.at(STATE), fake))
    assert np.allclose(ours.distance, theirs.distance)
    assert np.allclose(ours.normal, theirs.normal)
    assert np.array_equal(ours.body, theirs.body)
    assert np.array_equal(ours.material, theirs.material)


def test_a_sheet_is_seen_from_both_sides_and_a_solid_from_outside():
    mesh = terrain()
    above, below = [[0.0, 0.0, 0.0]], [[0.0, 0.0, 30.0]]
    for oriented in (True, False):
        rays = Rays()
        rays.add_static(0, Solid("it", (Placed(TriangleMesh(mesh.vertices, mesh.faces, oriented)),)))
        assert rays.at(STATE).raycast(np.array(above), np.array([[0.0, 0.0, 1.0]]), 99.0).body[0] == 0
        from_below = rays.at(STATE).raycast(np.array(below), np.array([[0.0, 0.0, -1.0]]), 99.0)
        assert from_below.body[0] == (-1 if oriented else 0)
        assert oriented or from_below.normal[0, 2] > 0.0


def test_removed_and_moved_things():
    rays, solid = Rays(), Solid("box", (Placed(Box((1.0, 1.0, 1.0))),))
    rays.add_static(0, solid)
    rays.add_moving(1, solid, 0)
    o, d = np.array([[0.0, 0.0, -9.0], [2.0, -1.0, -9.0]]), np.tile([[0.0, 0.0, 1.0]], (2, 1))
    assert rays.at(STATE).raycast(o, d, 99.0).body.tolist() == [0, 1]
    away = STATE.copy()
    away[0, 0] += 50.0
    assert rays.at(away).raycast(o, d, 99.0).body.tolist() == [0, -1]
    rays.remove(0)
    assert rays.at(STATE).raycast(o, d, 99.0).body.tolist() == [-1, 1]
    rays.remove(1)
    assert rays.at(STATE).raycast(o, d, 99.0).body.tolist() == [-1, -1]
    with pytest.raises(KeyError):
        rays.remove(1)


@pytest.mark.parametrize("shape", [Box((1.0, 1.0, 1.0)), Sphere(0.5)])
def test_what_is_kept_of_an_instant_stays_while_the_world_goes_on(shape):
    """Bodies of few triangles and of many: they move on, come and go, while another thread casts rays at what was."""
    rays, state = Rays(), STATE.copy()
    rays.add_static(0, Solid("floor", (Placed(terrain(20)),)))
    rays.add_moving(1, Solid("body", (Placed(shape),)), 0)
    rng = np.random.default_rng(4)
    o = np.tile([[2.0, -1.0, -6.0]], (500, 1)) + rng.uniform(-1.0, 1.0, (500, 3))
    d = unit(rng, 500) * 0.1 + [0.0, 0.0, 1.0]
    d /= np.linalg.norm(d, axis=1)[:, None]
    expected = rays.at(state).raycast(o, d, 50.0)
    assert set(expected.body.tolist()) == {0, 1}
    kept = rays.still(state)
    assert kept.still() is kept
    found = []
    thread = threading.Thread(target=lambda: found.extend(kept.raycast(o, d, 50.0) for _ in range(20)))
    thread.start()
    state[0, :3] += 30.0
    for _ in range(5):
        assert 1 not in rays.at(state).raycast(o, d, 50.0).body
    rays.remove(1)
    rays.add_moving(1, Solid("other", (Placed(Capsule(0.3, 1.0)),)), 0)
    rays.at(STATE).raycast(o, d, 50.0)
    thread.join()
    assert len(found) == 20
    for hits in found:
        assert all(np.array_equal(one, other) for one, other in zip(hits, expected, strict=True))


@pytest.mark.parametrize("n", [0, 1])
def test_few_rays_and_bad_ones(n):
    rays = Rays()
    rays.add_static(0, Solid("box", (Placed(Box((1.0, 1.0, 1.0))),)))
    rays.add_moving(1, Solid("box", (Placed(Box((1.0, 1.0, 1.0))),)), 0)
    hits = rays.at(STATE).raycast(np.full((n, 3), np.nan), np.full((n, 3), np.nan), 10.0)
    assert hits.body.tolist() == [-1] * n


def test_the_quickest_picker_that_is_installed(picker: str) -> None:
    kind = type(make_picker(np.eye(3)[None])).__name__
    assert kind == {"embree": "EmbreePicker", "tree": "TreePicker"}[picker]


def test_who_looks_out_of_a_body_sees_what_is_behind_it(picker: str) -> None:
    """A body of boxes and one of a mesh, each in a row: without it rays meet the other, and the bottom."""
    boxes = Solid("boxes", (Placed(Box((0.5, 0.5, 0.5))),))
    ball = Solid("ball", (Placed(TriangleMesh(*_ball())),))
    bottom = Solid("bottom", (Placed(HalfSpace(), p=np.array([0.0, 0.0, 10.0])),))
    state = np.zeros((2, 13))
    state[:, 3] = 1.0
    state[:, 2] = 2.0, 5.0
    rays = Rays()
    rays.add_static(7, bottom)
    rays.add_moving(3, boxes, 0)
    rays.add_moving(5, ball, 1)
    down = np.tile([0.0, 0.0, 1.0], (3, 1))
    start = np.zeros((3, 3))
    assert rays.cast(state, start, down, 50.0).body.tolist() == [3, 3, 3]
    assert rays.cast(state, start, down, 50.0, 0).body.tolist() == [5, 5, 5]
    assert rays.at(state, 0).raycast(start, down, 50.0).body.tolist() == [5, 5, 5]
    assert rays.at(state, 0).still().raycast(start, down, 50.0).body.tolist() == [5, 5, 5]
    # Compiled code would take these for what they are not.
    for other in (state.astype(np.float32), np.asfortranarray(state)):
        assert rays.cast(other, start, down, 50.0, 0).body.tolist() == [5, 5, 5]
        assert rays.still(other, 0).raycast(start, down, 50.0).body.tolist() == [5, 5, 5]
    start[:, 2] = 3.0  # between the boxes and the ball
    assert rays.cast(state, start, down, 50.0, 1).body.tolist() == [7, 7, 7]


def _ball() -> tuple[np.ndarray, np.ndarray]:
    """More triangles than are intersected one by one."""
    found = facets(Solid("ball", (Placed(Sphere(0.5)),))).corners
    assert len(found) > surfaces.FEW
    return found.reshape(-1, 3), np.arange(3 * len(found)).reshape(-1, 3)
