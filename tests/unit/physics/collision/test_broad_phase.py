"""Which shapes may touch within a tick: boxes that hold them on their way, and pairs against brute force."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from uwserver.frames import multiply, quat_from_rpy, rotate
from uwserver.physics.collision.broad_phase import (
    SEARCH,
    Search,
    bound,
    find_pairs,
    overlap,
    overlapping_pairs,
    place,
    radius_of,
    sweep,
)
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, HalfSpace, Placed, Shape, Solid, Sphere
from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays.rows import facets

DT, MARGIN = 0.02, 0.005
Bodies = list[tuple[Placed, ...]]


class World(NamedTuple):
    """The arrays, and the table by which a kernel finds them, which does not keep them alive."""

    shapes: Shapes
    search: Search
    table: Any


def search_of(bodies: Bodies, static: tuple[Placed, ...] = ()) -> World:
    """A world of bodies, each of some shapes, and of static shapes after them; static ones are placed already."""
    shapes = shapes_of([part(p) for body in bodies for p in body] + [part(p) for p in static])
    ranges, first = [], 0
    for row, body in enumerate(bodies):
        ranges.append((first, len(body), row))
        first += len(body)
    n, m = first + len(static), len(bodies)
    search = Search(
        np.array(ranges, np.int64).reshape(-1, 3), np.arange(first, n), np.array([radius_of(shapes.slots[at : at + k]) for at, k, _ in ranges]),
        np.zeros((n, 4)), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((m, 3)), np.zeros((m, 3)), np.arange(m), *np.zeros((2, m), np.bool_),
    )  # fmt: skip
    for s in range(first, n):
        place(shapes.slots[s], np.zeros(3), np.eye(3), shapes.P[s], shapes.R[s])
        bound(shapes.slots[s], shapes.P[s], shapes.R[s], 0.0, search.low[s], search.high[s])
    return World(shapes, search, addresses(SEARCH, {**shapes._asdict(), **search._asdict()}))


def states(n: int, seed: int = 1, spread: float = 3.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(n, 13))
    state[:, :3] *= spread
    state[:, 3:7] = [quat_from_rpy(*angles) for angles in rng.uniform(-3.0, 3.0, (n, 3))]
    return state


def pairs_of(world: World, state: FloatArray, gate: bool = True, room: int = 500) -> list[tuple[int, int]]:
    pairs = np.full((room, 2), -1)
    count = find_pairs(world.table, state, DT, MARGIN, gate, pairs)
    return [(int(a), int(b)) for a, b in pairs[:count]]


SHAPES: list[Shape] = [Box((0.5, 0.3, 0.2)), Sphere(0.4), Capsule(0.2, 0.6)]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda x: type(x).__name__)
def test_a_box_holds_the_placed_shape_and_is_no_larger_than_its_own_box(shape: Shape) -> None:
    placed = Placed(shape, (0.2, 0.1, -0.3), quat_from_rpy(0.2, 0.3, 0.4))
    p, q = np.array([1.0, 2.0, 3.0]), quat_from_rpy(-0.5, 0.1, 2.0)
    P, R, low, high = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    slot = part(placed).slot[0]
    place(slot, p, Placed(shape, q=q).R, P, R)
    np.testing.assert_allclose(P, p + rotate(q, placed.p), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(R, Placed(shape, q=multiply(q, placed.q)).R, rtol=0.0, atol=1e-14)
    bound(slot, P, R, 0.1, low, high)
    corners = facets(Solid("s", (Placed(shape),))).corners.reshape(-1, 3) @ R.T + P
    assert (corners.min(axis=0) >= low + 0.1 - 1e-12).all()
    assert (corners.max(axis=0) <= high - 0.1 + 1e-12).all()
    if isinstance(shape, Box):
        np.testing.assert_allclose(
            [corners.min(axis=0) - 0.1, corners.max(axis=0) + 0.1], [low, high], rtol=0.0, atol=1e-12
        )


@pytest.mark.parametrize("seed", range(5))
def test_a_body_stays_in_its_box_for_the_tick(seed: int) -> None:
    """All points of its shapes, at all velocities that it has now."""
    body = (Placed(Box((0.5, 0.3, 0.2)), (0.4, 0.0, 0.1)), Placed(Sphere(0.2), (-0.8, 0.2, 0.0)))
    world = search_of([body])
    search = world.search
    state = states(1, seed)
    pairs_of(world, state)
    x = state[0]
    points = np.concatenate([facets(Solid("s", (p,))).corners.reshape(-1, 3) for p in body])
    for t in (0.0, 0.5 * DT, DT):
        rate = float(np.linalg.norm(x[10:]))
        q = multiply(x[3:7], (np.cos(0.5 * t * rate), *(np.sin(0.5 * t * rate) / rate * x[10:])))
        p = x[:3] + t * np.array(rotate(x[3:7], x[7:10]))
        there = points @ Placed(Sphere(1.0), q=q).R.T + p
        assert (there >= search.body_low[0]).all()
        assert (there <= search.body_high[0]).all()


def test_the_engine_s_attitude_is_that_of_its_shape_with_w_last() -> None:
    """Where there is something that the engine will be asked about."""
    own = quat_from_rpy(0.1, 0.2, 0.3)
    for near in (True, False):
        world = search_of([(Placed(Sphere(1.0)),), (Placed(Sphere(1.0)), Placed(Sphere(0.5)))])
        shapes, search, _ = world
        shapes.slots["q"][2] = own
        state = states(2)
        state[:, :3] = (0.0, 0.0, 0.0), (1.5 if near else 50.0, 0.0, 0.0)
        assert bool(pairs_of(world, state)) == near
        w, x, y, z = multiply(state[1, 3:7], own)
        np.testing.assert_allclose(search.Q[2], [x, y, z, w] if near else 0.0, rtol=0.0, atol=1e-15)


def test_the_ball_of_a_body_holds_the_boxes_of_its_shapes() -> None:
    """Shapes lie off the centres of their boxes, and boxes off the origin of the body: no sum of lengths may be forgotten."""
    slots = shapes_of(
        [part(Placed(Box((3.0, 4.0, 0.0)), (0.0, 0.0, 2.0))), part(Placed(Sphere(1.0), (-7.0, 0.0, 0.0)))]
    ).slots
    assert radius_of(slots[:1]) == pytest.approx(2.0 + 5.0)
    assert radius_of(slots) == pytest.approx(7.0 + np.sqrt(3.0))
    slots["centre"][0] = 0.0, -8.0, 0.0
    assert radius_of(slots[:1]) == pytest.approx(2.0 + np.hypot(3.0, 12.0))
    assert radius_of(slots[:0]) == 0.0


@pytest.mark.parametrize(
    ("a", "b", "meet"),
    [
        (((0, 0, 0), (1, 1, 1)), ((0.5, 0.5, 0.5), (2, 2, 2)), True), (((0, 0, 0), (1, 1, 1)), ((1, 0, 0), (2, 1, 1)), True),
        (((0, 0, 0), (1, 1, 1)), ((0, 0, 1.1), (1, 1, 2)), False), (((0, 0, 0), (3, 3, 3)), ((1, 1, 1), (2, 2, 2)), True),
    ],
)  # fmt: skip
def test_boxes_that_meet(a: Any, b: Any, meet: bool) -> None:
    (low_a, high_a), (low_b, high_b) = (np.array(box, float) for box in (a, b))
    assert overlap(low_a, high_a, low_b, high_b) == overlap(low_b, high_b, low_a, high_a) == meet


@pytest.mark.parametrize("seed", range(8))
def test_pairs_are_those_whose_boxes_meet(seed: int) -> None:
    """Against all pairs of boxes, over ticks in which the order of the sweep is kept."""
    rng = np.random.default_rng(seed)
    bodies: Bodies = [
        tuple(Placed(SHAPES[k], tuple(rng.normal(size=3))) for k in rng.integers(0, 3, rng.integers(1, 4)))
        for _ in range(9)
    ]
    static = tuple(Placed(SHAPES[0], tuple(3.0 * rng.normal(size=3))) for _ in range(4))
    world, pairs = search_of(bodies, static), 0
    search = world.search
    for tick in range(3):
        state = states(9, 10 * seed + tick, spread=2.0)
        found = pairs_of(world, state)
        moving = len(search.reach) - 4
        owner = np.repeat(np.arange(9), [len(body) for body in bodies])
        expected = {
            (a, b)
            for a in range(moving)
            for b in range(a + 1, moving + 4)
            if (b >= moving or owner[a] != owner[b])
            and (search.low[a] <= search.high[b]).all()
            and (search.low[b] <= search.high[a]).all()
        }
        assert set(found) == expected
        assert len(found) == len(expected)
        pairs += len(found)
    assert pairs


def test_the_order_of_pairs_does_not_depend_on_what_was_before() -> None:
    bodies: Bodies = [(Placed(Sphere(1.0)),)] * 6
    used, fresh = search_of(bodies), search_of(bodies)
    for seed in range(4):
        pairs_of(used, states(6, seed))
    assert pairs_of(used, states(6, 9, 1.0)) == pairs_of(fresh, states(6, 9, 1.0))


def test_without_the_gate_each_pair_is_given() -> None:
    world = search_of([(Placed(Sphere(0.1)),) * 2] * 3, (Placed(Sphere(0.1)), Placed(HalfSpace())))
    found = pairs_of(world, states(3, spread=1e3), gate=False)
    assert len(found) == len(set(found)) == 3 * 2 * 2 + 3 * 4


def test_a_half_space_is_below_what_reaches_into_it() -> None:
    slope = Placed(HalfSpace(), (0.0, 0.0, 5.0), quat_from_rpy(0.3, 0.0, 0.0))
    world = search_of([(Placed(Sphere(0.5)),)], (slope,))
    outward = -slope.R[:, 2]
    for height, near in ((0.4, True), (0.8, False), (-50.0, True)):
        state = np.zeros((1, 13))
        state[0, :3], state[0, 3] = np.array([0.0, 0.0, 5.0]) + height * outward, 1.0
        assert bool(pairs_of(world, state)) == near


def test_a_body_whose_state_is_not_finite_is_nowhere() -> None:
    world = search_of([(Placed(Sphere(0.5)),)] * 2, (Placed(HalfSpace()), Placed(Sphere(50.0))))
    state = states(2, spread=0.1)
    assert (0, 1) in pairs_of(world, state)
    state[0, 8] = np.nan
    assert {a for a, _ in pairs_of(world, state)} == {1}


def test_more_pairs_than_there_is_room_for_are_counted() -> None:
    world = search_of([(Placed(Sphere(5.0)),)] * 5)
    pairs = np.full((3, 2), -1)
    assert find_pairs(world.table, states(5, spread=0.1), DT, MARGIN, True, pairs) == 10
    assert (pairs >= 0).all()


def test_a_sweep_tells_who_is_alone() -> None:
    search = search_of([(Placed(Sphere(0.1)),)] * 4).search
    low = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, 9.0, 0.0]])
    search.body_low[:], search.body_high[:] = low, low + 1.0
    sweep(search)
    assert search.overlapping.tolist() == [True, False, True, False]
    assert low[search.order, 0].tolist() == sorted(low[:, 0])


def test_the_parts_of_a_search_give_what_the_whole_gives() -> None:
    world = search_of([(Placed(Sphere(1.0)),)] * 5, (Placed(Sphere(1.0)),))
    shapes, search, _ = world
    whole = pairs_of(world, states(5, 3, 1.0))
    pairs = np.full((50, 2), -1)
    assert overlapping_pairs(shapes, search, True, pairs) == len(whole)
    assert [tuple(pair) for pair in pairs[: len(whole)].tolist()] == whole


def test_shapes_are_placed_where_their_body_is_near_something_and_there_alone() -> None:
    """A plane counts as well as a box, and another body as well as both; who comes near is placed before he is judged."""
    body = (Placed(Box((0.5, 0.3, 0.2)), (0.4, 0.0, 0.1)),)
    world = search_of([body] * 4, (Placed(Sphere(1.0), (0.0, 0.0, 0.0)), Placed(HalfSpace(), (0.0, 0.0, 20.0))))
    state = np.zeros((4, 13))
    state[:, 3] = 1.0
    state[:, :3] = (1.0, 0.0, 0.0), (50.0, 0.0, 0.0), (100.0, 0.0, 19.75), (150.0, 0.0, 0.0)
    assert pairs_of(world, state) == [(0, 4), (2, 5)]
    assert world.search.near.tolist() == [True, False, True, False]
    state[1, 0] = 149.0
    assert pairs_of(world, state) == [(0, 4), (1, 3), (2, 5)]
    np.testing.assert_allclose(world.shapes.P[:4], state[:, :3] + (0.4, 0.0, 0.1))
    assert (world.search.body_high - world.search.body_low)[:, 1].max() < 0.7, "around the shapes, not the balls"
