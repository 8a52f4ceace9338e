"""Exact hits of rays against formulas and brute force over triangles; the pickers are tested in test_casting."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays.hits import BATCH, SIMPLE, Batch, intersect_level, intersect_simple, refine, select_rays
from uwserver.physics.rays.raycast import SURFACE, Hits, no_hits
from uwserver.physics.rays.rows import CARRIED, SIDE, Simple, facets, middle, planes, sides

RNG = np.random.default_rng(31)


def unit(n: int) -> FloatArray:
    d = RNG.normal(size=(n, 3))
    result: FloatArray = d / np.linalg.norm(d, axis=1, keepdims=True)
    return result


def state_of(*poses: tuple[Any, Any]) -> FloatArray:
    rows = np.zeros((len(poses), 13))
    for row, (p, rpy) in zip(rows, poses, strict=True):
        row[:3], row[3:7] = p, quat_from_rpy(*rpy)
    return rows


LEVEL = state_of(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


def simple_of(static: list[tuple[int, Solid]], moving: list[tuple[int, Solid, int]]) -> Simple:
    each, rows, first = [np.empty(0, SIDE)], [], 0
    for body, solid, row in moving:
        parts = facets(solid)
        centre, half = middle(parts)
        each.append(sides(parts, np.zeros(3)))
        rows.append((body, row, first, len(each[-1]), centre, float(np.linalg.norm(half))))
        first += len(each[-1])
    return Simple(planes(static), np.array(rows, CARRIED), np.concatenate(each))


def cast(simple: Simple, origin: Any, direction: Any, limit: float = 100.0, state: FloatArray = LEVEL) -> Hits:
    origin, direction = np.array(origin, float).reshape(-1, 3), np.array(direction, float).reshape(-1, 3)
    answer = Hits(
        np.full(len(origin), -5.0), np.full((len(origin), 3), -5.0), np.full(len(origin), -5), np.full(len(origin), -5)
    )
    intersect_simple(
        addresses(SIMPLE, simple._asdict()), origin, direction, limit, state, np.zeros(0, np.int64), *answer
    )
    return answer


GROUND = Solid("ground", (Placed(HalfSpace(), (0.0, 0.0, 10.0), quat_from_rpy(0.2, 0.0, 0.0), material=3),))


def test_nothing_is_an_answer_too() -> None:
    answer = cast(simple_of([], []), np.zeros((3, 3)), unit(3))
    for found, expected in zip(answer, no_hits(3), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_plane_is_hit_where_its_equation_says() -> None:
    simple, direction, origin = simple_of([(7, GROUND)], []), unit(200), RNG.uniform(-3.0, 3.0, (200, 3))
    answer = cast(simple, origin, direction, 30.0)
    normal = -GROUND.shapes[0].R[:, 2]
    with np.errstate(divide="ignore"):
        distance = ([0.0, 0.0, 10.0] - origin) @ normal / (direction @ normal)
    hit = (direction @ normal < 0.0) & (distance <= 30.0)
    assert 0.2 < hit.mean() < 0.8
    np.testing.assert_allclose(answer.distance, np.where(hit, distance, np.inf), rtol=1e-12, atol=0.0)
    np.testing.assert_allclose(answer.normal, np.where(hit[:, None], normal, 0.0), rtol=0.0, atol=1e-15)
    assert set(zip(answer.body[hit].tolist(), answer.material[hit].tolist(), strict=True)) == {(7, 3)}
    assert (answer.body[~hit] == -1).all()


def test_from_inside_a_plane_is_not_hit() -> None:
    assert cast(simple_of([(7, GROUND)], []), [0.0, 0.0, 12.0], [0.0, 0.0, -1.0]).body[0] == -1


def inside(corners: FloatArray, n: FloatArray, x: FloatArray, slack: float = 0.0) -> Any:
    """(t) whether points x (t, 3) of the planes of triangles (t, 3, 3) with normals n lie in them."""
    edges = np.roll(corners, -1, axis=1) - corners
    sides = np.cross(edges, x[:, None] - corners)
    return (np.einsum("tki,ti->tk", sides, n) >= -slack).all(axis=1)


def brute_force(corners: FloatArray, o: FloatArray, d: FloatArray) -> tuple[float, FloatArray]:
    """Distance and normal of the nearest triangle that faces the ray."""
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    approach, height = n @ d, np.einsum("ti,ti->t", n, corners[:, 0] - o)
    t = np.divide(height, approach, out=np.full(len(n), -1.0), where=approach < 0.0)
    t = np.where((t >= 0.0) & inside(corners, n, o + t[:, None] * d), t, np.inf)
    k = int(np.argmin(t))
    return float(t[k]), n[k] / np.linalg.norm(n[k]) if t[k] < np.inf else np.zeros(3)


@pytest.mark.parametrize("shape", [Box((0.5, 0.3, 0.2)), Sphere(0.4)], ids=lambda x: type(x).__name__)
def test_a_moving_solid_is_hit_where_brute_force_says(shape: Any) -> None:
    solid = Solid("s", (Placed(shape, (0.2, 0.0, 0.1)),), material=4)
    state = state_of(((9.0, 9.0, 9.0), (0.0, 0.0, 0.0)), ((1.0, -2.0, 3.0), (0.3, -0.2, 1.0)))
    simple = simple_of([], [(5, solid, 1)])
    R = Placed(shape, q=tuple(state[1, 3:7])).R
    corners = facets(solid).corners @ R.T + state[1, :3]
    origin = state[1, :3] + RNG.uniform(-2.0, 2.0, (40, 3))
    direction = state[1, :3] + RNG.uniform(-0.5, 0.5, (40, 3)) - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    answer = cast(simple, origin, direction, 10.0, state)
    hits = 0
    for k in range(40):
        distance, normal = brute_force(corners, origin[k], direction[k])
        assert answer.distance[k] == pytest.approx(distance, rel=1e-9)
        np.testing.assert_allclose(answer.normal[k], normal, rtol=0.0, atol=1e-9)
        hits += distance < math.inf
        assert (answer.body[k], answer.material[k]) == ((5, 4) if distance < math.inf else (-1, -1))
    assert hits > 5


def test_many_rays_from_one_place_are_as_each_alone() -> None:
    simple = simple_of([(1, GROUND)], [(5, Solid("b", (Placed(Box((1.0, 1.0, 1.0)), (4.0, 0.0, 0.0)),)), 0)])
    direction = unit(100)
    together = cast(simple, np.zeros((100, 3)), direction)
    for k in range(0, 100, 7):
        alone = cast(simple, np.zeros(3), direction[k])
        for found, expected in zip(together, alone, strict=True):
            np.testing.assert_array_equal(found[k], expected[0])


def test_no_ray_slips_through_between_two_sides() -> None:
    """At the edges and corners of a box, to the last bit."""
    simple = simple_of([], [(5, Solid("b", (Placed(Box((1.0, 1.0, 1.0))),)), 0)])
    targets = np.array([[x, y, -1.0] for x in np.linspace(-1.0, 1.0, 41) for y in (-1.0, -0.5, 0.0, 1.0)]) * (
        1.0 - 1e-15
    )
    origin = np.array([0.3, 0.2, -7.0])
    direction = (targets - origin) / np.linalg.norm(targets - origin, axis=1, keepdims=True)
    answer = cast(simple, np.repeat([origin], len(targets), axis=0), direction)
    assert (answer.body == 5).mean() > 0.95  # outermost ones may miss by rounding
    inner = (np.abs(targets[:, :2]) < 0.99).all(axis=1)
    assert (answer.body[inner] == 5).all()


def test_a_ray_from_inside_leaves_unhindered() -> None:
    simple = simple_of([], [(5, Solid("b", (Placed(Box((1.0, 1.0, 1.0))),)), 0)])
    assert (cast(simple, np.zeros((50, 3)), unit(50)).body == -1).all()


def test_the_limit_and_the_nearer_of_two() -> None:
    far, near = (
        Solid("far", (Placed(Box((1.0,) * 3), (8.0, 0.0, 0.0)),)),
        Solid("near", (Placed(Box((1.0,) * 3), (4.0, 0.0, 0.0)),)),
    )
    for order in ([(1, far, 0), (2, near, 0)], [(2, near, 0), (1, far, 0)]):
        simple = simple_of([], order)
        assert cast(simple, np.zeros(3), [1.0, 0.0, 0.0]).body[0] == 2
        assert cast(simple, np.zeros(3), [1.0, 0.0, 0.0]).distance[0] == pytest.approx(3.0)
        assert cast(simple, np.zeros(3), [1.0, 0.0, 0.0], limit=2.9).body[0] == -1
    wall = Solid("wall", (Placed(HalfSpace(), (2.0, 0.0, 0.0), quat_from_rpy(0.0, math.pi / 2, 0.0)),))
    assert cast(simple_of([(9, wall)], [(2, near, 0)]), np.zeros(3), [1.0, 0.0, 0.0]).body[0] == 9


def test_a_sheet_is_hit_on_both_sides_with_the_normal_towards_the_ray() -> None:
    triangle = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 2.0, 0.0]])
    sheet = Solid("sheet", (Placed(TriangleMesh(triangle, np.array([[0, 1, 2]]), oriented=False)),))
    simple = simple_of([], [(5, sheet, 0)])
    answer = cast(simple, [[0.0, 0.0, -2.0], [0.0, 0.0, 2.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert answer.distance.tolist() == [2.0, 2.0]
    np.testing.assert_array_equal(answer.normal, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


# -- the surface ----------------------------------------------------------------------------------------------------------------------


def test_the_surface_is_hit_from_below_unless_something_is_nearer() -> None:
    direction = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.6, -0.8]])
    answer = no_hits(5)
    answer.distance[4], answer.body[4], answer.material[4] = 1.0, 9, 2
    intersect_level(4.0, direction, 30.0, SURFACE, *answer)
    assert answer.distance.tolist() == pytest.approx([4.0, 5.0, math.inf, math.inf, 1.0])
    assert answer.body.tolist() == [SURFACE, SURFACE, -1, -1, 9]
    assert answer.material.tolist() == [SURFACE, SURFACE, -1, -1, 2]
    np.testing.assert_array_equal(answer.normal[:2], [[0.0, 0.0, 1.0]] * 2)
    short = no_hits(5)
    intersect_level(4.0, direction, 4.5, SURFACE, *short)
    assert short.body.tolist() == [SURFACE, -1, -1, -1, -1]


# -- rays that go to the engine -------------------------------------------------------------------------------------------------------


def batch_of(solid: Solid, n: int) -> Batch:
    parts = facets(solid)
    box = np.array(middle(parts))
    return Batch(
        sides(parts, box[0]), np.full(len(parts.corners), 5), box, np.empty((3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.int64),
        np.empty(n), np.empty((n, 7), np.float32),
    )  # fmt: skip


BLOCK = Solid("block", (Placed(Box((1.0, 2.0, 0.5)), (0.3, 0.0, 0.0)),), material=6)


def test_rays_that_pass_a_box_enter_its_frame() -> None:
    x = state_of(((5.0, 1.0, -2.0), (0.2, 0.4, -1.0)))[0]
    R = Placed(Sphere(1.0), q=tuple(x[3:7])).R
    origin = x[:3] + RNG.uniform(-3.0, 3.0, (300, 3))
    direction = unit(300)
    batch, distance = batch_of(BLOCK, 300), np.full(300, np.inf)
    count = select_rays(addresses(BATCH, batch._asdict()), origin, direction, 8.0, x, distance)
    chosen = set(batch.rays[:count].tolist())
    local_o, local_d = (origin - x[:3]) @ R - batch.box[0], direction @ R
    steps = np.linspace(0.0, 8.0, 1601)
    for k in range(300):
        points = local_o[k] + steps[:, None] * local_d[k]
        passes = (np.abs(points) <= batch.box[1] - 0.01).all(axis=1).any()
        assert not passes or k in chosen
        apart = not (np.abs(points) <= batch.box[1] + 0.02).all(axis=1).any()
        assert not apart or k not in chosen
    assert 10 < count < 290
    np.testing.assert_allclose(batch.start[:count], local_o[batch.rays[:count]], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(batch.towards[:count], local_d[batch.rays[:count]], rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(batch.engine[:count, :3], batch.start[:count].astype(np.float32))
    assert not batch.ahead[:count].any()


def test_what_is_behind_a_hit_does_not_enter() -> None:
    batch, far, near = batch_of(BLOCK, 1), np.array([9.0]), np.array([1.0])
    table = addresses(BATCH, batch._asdict())
    for distance, count in ((far, 1), (near, 0)):
        assert (
            select_rays(table, np.array([[-5.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]), 50.0, LEVEL[0], distance)
            == count
        )


def picked_by_brute_force(batch: Batch, count: int) -> Any:
    """What an engine would pick: the nearest triangle beyond `ahead`, whichever side it shows."""
    n, corners = batch.sides["normal"], batch.sides["corners"]
    out = np.full(count, -1)
    for k in range(count):
        approach, height = n @ batch.towards[k], np.einsum("ti,ti->t", n, corners[:, 0] - batch.start[k])
        t = np.divide(height, approach, out=np.full(len(n), -1.0), where=approach != 0.0)
        t = np.where(
            (t > batch.ahead[k]) & inside(corners, n, batch.start[k] + t[:, None] * batch.towards[k], 1e-12), t, np.inf
        )
        if t.min() < np.inf:
            out[k] = np.argmin(t)
    return out


def test_picked_triangles_give_exact_hits_and_hidden_sides_send_on() -> None:
    """Two blocks in one scene, rays from inside the first: they leave it and hit the second."""
    two = Solid("two", (*BLOCK.shapes, Placed(Box((1.0, 2.0, 0.5)), (5.3, 0.0, 0.0))), material=6)
    n = 30
    batch, answer = batch_of(two, n), no_hits(n)
    table = addresses(BATCH, batch._asdict())
    origin = np.full((n, 3), (0.3, 0.0, 0.0))
    direction = np.array([1.0, 0.0, 0.0]) + 0.15 * unit(n)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    count = select_rays(table, origin, direction, 20.0, LEVEL[0], answer.distance)
    assert count == n
    again = refine(table, picked_by_brute_force(batch, n), 20.0, 8, *answer)
    assert again == n
    assert (answer.body == -1).all()
    assert refine(table, picked_by_brute_force(batch, again), 20.0, 8, *answer) < n
    corners = facets(two).corners
    for k in range(n):
        distance, normal = brute_force(corners, origin[k], direction[k])
        assert answer.distance[k] == pytest.approx(distance, rel=1e-12)
        np.testing.assert_allclose(answer.normal[k], normal, rtol=0.0, atol=1e-12)
        assert (answer.body[k], answer.material[k]) == (8, 6) if distance < math.inf else (-1, -1)


def test_without_a_body_a_hit_is_its_owner_s() -> None:
    batch, answer = batch_of(BLOCK, 1), no_hits(1)
    batch.owners[:] = 42
    table = addresses(BATCH, batch._asdict())
    select_rays(table, np.array([[-5.0, 0.1, 0.1]]), np.array([[1.0, 0.0, 0.0]]), 50.0, LEVEL[0], answer.distance)
    assert refine(table, picked_by_brute_force(batch, 1), 50.0, -1, *answer) == 0
    assert (answer.body[0], answer.distance[0]) == (42, pytest.approx(4.3))


def test_rays_that_go_on_move_to_the_front() -> None:
    """Of four rays the second and fourth meet hidden sides."""
    batch, answer = batch_of(BLOCK, 4), no_hits(4)
    table = addresses(BATCH, batch._asdict())
    origin = np.array([[-5.0, 0.0, 0.1], [0.3, 0.5, 0.1], [-5.0, 0.2, 0.1], [0.3, -0.5, 0.1]])
    select_rays(table, origin, np.array([[1.0, 0.0, 0.0]] * 4), 50.0, LEVEL[0], answer.distance)
    assert refine(table, picked_by_brute_force(batch, 4), 50.0, 8, *answer) == 2
    assert batch.rays[:2].tolist() == [1, 3]
    np.testing.assert_allclose(batch.start[:2], origin[[1, 3]] - batch.box[0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(batch.ahead[:2], 1.0, rtol=0.0, atol=1e-12)
    assert answer.body.tolist() == [8, -1, 8, -1]
