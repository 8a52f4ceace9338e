"""Clipping of polygons and the choice of contacts, against areas, brute force, and what a body needs to rest on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.collision.contacts import NUMBERS
from uwserver.physics.collision.manifold import (
    CANDIDATES,
    FULL,
    KEPT,
    SAME_DEPTH,
    Work,
    add_point,
    add_polygon,
    clip,
    new_work,
    reduce,
    thin_out,
)
from uwserver.physics.kernel.arrays import FloatArray

UP = np.array([0.0, 0.0, 1.0])
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def polygon(*corners: Any, z: float = 0.0) -> FloatArray:
    return np.array([[x, y, z] for x, y in corners])


def clipped(ring: FloatArray, cut: FloatArray, t: FloatArray = UP) -> tuple[FloatArray, list[int]]:
    work = new_work()
    work.ring[: len(ring)], work.codes[: len(ring)] = ring, np.arange(len(ring))
    work.cut[: len(cut)] = cut
    count = clip(work, len(ring), len(cut), t)
    return work.ring[:count].copy(), work.codes[:count].tolist()


def area(ring: FloatArray) -> float:
    x, y = ring[:, 0], ring[:, 1]
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


# -- clipping -------------------------------------------------------------------------------------------------------------------------


def test_a_polygon_within_another_stays_as_it_is() -> None:
    ring = polygon(*(0.5 * SQUARE), z=0.3)
    found, codes = clipped(ring, polygon(*SQUARE))
    np.testing.assert_array_equal(found, ring)
    assert codes == [0, 1, 2, 3]


def test_a_polygon_around_another_becomes_the_other() -> None:
    found, codes = clipped(polygon(*(3.0 * SQUARE)), polygon(*SQUARE))
    assert area(found) == pytest.approx(4.0)
    assert min(codes) >= 4  # crossings, no corners of its own


def test_polygons_apart_leave_nothing() -> None:
    assert len(clipped(polygon(*np.add(SQUARE, [5.0, 0.0])), polygon(*SQUARE))[0]) == 0


@pytest.mark.parametrize("shift", [(0.5, 0.5), (1.0, 0.0), (-0.3, 1.9), (1.999, 1.999)])
def test_shifted_squares_overlap_in_a_rectangle(shift: tuple[float, float]) -> None:
    found, codes = clipped(polygon(*(SQUARE + shift)), polygon(*SQUARE))
    assert area(found) == pytest.approx((2.0 - abs(shift[0])) * (2.0 - abs(shift[1])), abs=1e-7)
    assert len(set(codes)) == len(codes)


@pytest.mark.parametrize("seed", range(6))
def test_the_overlap_is_the_same_whichever_is_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hexagon = [(math.cos(a), math.sin(a)) for a in np.sort(rng.uniform(0.0, 2.0 * math.pi, 6))]
    ring, cut = polygon(*hexagon), polygon(*(SQUARE * 0.7 + rng.uniform(-0.6, 0.6, 2)))
    one, other = clipped(ring, cut)[0], clipped(cut, ring)[0]
    assert area(one) == pytest.approx(area(other), abs=1e-7)
    points = rng.uniform(-1.5, 1.5, (4000, 2))

    def inside(corners: FloatArray) -> Any:
        edges = np.roll(corners, -1, axis=0) - corners
        return np.all(
            [
                e[0] * (points[:, 1] - c[1]) - e[1] * (points[:, 0] - c[0]) >= 0.0
                for c, e in zip(corners, edges, strict=True)
            ],
            axis=0,
        )

    assert area(one) == pytest.approx(9.0 * np.mean(inside(ring) & inside(cut)), abs=0.15)


def test_a_tilted_polygon_is_cut_along_t_and_keeps_its_plane() -> None:
    ring = polygon(*(3.0 * SQUARE))
    ring[:, 2] = 0.5 * ring[:, 0]
    found, _ = clipped(ring, polygon(*SQUARE, z=-7.0))
    assert area(found) == pytest.approx(4.0)
    np.testing.assert_allclose(found[:, 2], 0.5 * found[:, 0], rtol=0.0, atol=1e-12)


def test_a_line_cuts_at_its_ends_and_not_beside_them() -> None:
    found, _ = clipped(polygon((-3.0, 0.4), (3.0, 0.4)), polygon((-1.0, 0.0), (1.0, 0.0)))
    assert set(np.round(found[:, 0], 6)) == {-1.0, 1.0}
    np.testing.assert_array_equal(found[:, 1], 0.4)


def test_a_line_over_a_polygon_is_cut_at_its_border() -> None:
    found, _ = clipped(polygon((-3.0, 0.4), (3.0, 0.4)), polygon(*SQUARE))
    assert set(np.round(found[:, 0], 6)) == {-1.0, 1.0}


def test_a_corner_on_the_border_belongs_to_both_sides() -> None:
    left, right = (
        polygon((-2.0, -1.0), (0.0, -1.0), (0.0, 1.0), (-2.0, 1.0)),
        polygon((0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0)),
    )
    point = polygon((0.0, 0.0))
    assert len(clipped(point, left)[0]) == len(clipped(point, right)[0]) == 1


# -- contacts of a polygon ------------------------------------------------------------------------------------------------------------


def added(
    ring: FloatArray, on_a: bool, reach: float = 1.0, codes: Any = None, code: int = 0, n: int = 0
) -> tuple[Work, int]:
    work = new_work()
    work.ring[: len(ring)] = ring
    work.codes[: len(ring)] = range(len(ring)) if codes is None else codes
    return work, add_polygon(work, len(ring), np.array([9.0, 9.0, 0.0]), UP, on_a, code, reach, n)


@pytest.mark.parametrize("on_a", [False, True])
def test_corners_become_contacts_midway_with_the_normal_from_b_to_a(on_a: bool) -> None:
    work, n = added(polygon(*SQUARE, z=0.2), on_a)
    assert n == 4
    np.testing.assert_allclose(work.contacts[:4, :3], polygon(*SQUARE, z=0.1))
    np.testing.assert_array_equal(work.contacts[:4, 3:6], [UP if on_a else -UP] * 4)
    np.testing.assert_allclose(work.contacts[:4, 6], 0.2)
    assert len(set(work.keys[:4].tolist())) == 4


def test_corners_out_of_reach_are_left_out() -> None:
    ring = polygon(*SQUARE)
    ring[:, 2] = 0.0, 0.3, 0.6, -2.0
    assert added(ring, True, reach=0.5)[1] == 3


def test_the_key_of_a_corner_does_not_depend_on_what_it_stands_on() -> None:
    first, second = (added(polygon(*SQUARE), True, code=code)[0].keys[:4].tolist() for code in (0, 80))
    assert first == second
    crossing = [added(polygon((0.0, 0.0)), True, codes=[300], code=code)[0].keys[0] for code in (0, 80)]
    assert crossing[0] != crossing[1]


def test_a_corner_on_a_floor_and_a_wall_has_two_keys() -> None:
    work = new_work()
    work.ring[0], work.codes[0] = 0.0, 3
    n = 0
    for t in (*np.eye(3), *-np.eye(3)):
        n = add_polygon(work, 1, np.zeros(3), t, True, 0, 1.0, n)
    assert len(set(work.keys[:6].tolist())) == n == 6


def test_no_more_contacts_than_there_is_room_for() -> None:
    work, n = added(polygon(*SQUARE), True, n=CANDIDATES - 2)
    assert n == CANDIDATES
    assert add_point(work, np.zeros(3), UP, 0.0, 0.0, 1, n) == CANDIDATES


def test_a_point_is_moved_midway_between_the_surfaces() -> None:
    work, x = new_work(), np.array([1.0, 2.0, 9.0])
    assert add_point(work, x, UP, 3.0, 0.4, 77, 2) == 3
    np.testing.assert_allclose(work.contacts[2], [1.0, 2.0, 3.2, *UP, 0.4])
    assert work.keys[2] == 77


# -- the choice -----------------------------------------------------------------------------------------------------------------------


def chosen_of(contacts: Any, keys: Any = None) -> list[int]:
    contacts = np.array(contacts, float).reshape(-1, NUMBERS)
    chosen = np.full(8 * KEPT, -1)
    count = reduce(contacts, np.arange(len(contacts)) if keys is None else np.array(keys), len(contacts), chosen)
    return chosen[:count].tolist()


def contact(x: float, y: float, gap: float = 0.0, normal: Any = UP) -> list[float]:
    return [x, y, 0.0, *normal, gap]


def test_nothing_of_nothing() -> None:
    assert chosen_of([]) == []


def test_few_contacts_are_all_kept_the_deepest_first() -> None:
    assert chosen_of([contact(0, 0, 0.1), contact(1, 0, -0.1), contact(0, 1, 0.0)])[0] == 1
    assert sorted(chosen_of([contact(0, 0, 0.1), contact(1, 0, -0.1), contact(0, 1, 0.0)])) == [0, 1, 2]


def test_a_body_rests_on_its_four_outermost_corners() -> None:
    grid = [contact(x, y) for x in np.linspace(-1, 1, 7) for y in np.linspace(-1, 1, 7)]
    kept = {(grid[k][0], grid[k][1]) for k in chosen_of(grid)}
    assert kept == {(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)}


def test_those_almost_as_deep_come_before_those_farther_out() -> None:
    inner = [contact(*(0.5 * corner), gap=-0.5 * SAME_DEPTH * k / 4) for k, corner in enumerate(SQUARE)]
    outer = [contact(*(2.0 * corner), gap=0.01) for corner in SQUARE]
    assert sorted(chosen_of(outer + inner)) == [4, 5, 6, 7]


def test_each_group_of_like_normals_has_its_own() -> None:
    wall = np.array([1.0, 0.0, 0.0])
    corners = [contact(*corner) for corner in SQUARE] * 2
    for k in range(4, 8):
        corners[k] = contact(*SQUARE[k - 4], normal=wall)
    assert sorted(chosen_of(corners, keys=range(8))) == list(range(8))
    lean = np.array([math.sin(0.4), 0.0, math.cos(0.4)])  # 23 degrees: the same group
    corners = [contact(*corner) for corner in SQUARE] + [contact(0.0, 0.1 * k, 0.01, lean) for k in range(4)]
    assert len(chosen_of(corners)) == KEPT


def test_twins_are_one_contact() -> None:
    """At one place, or of one feature: the deeper stays."""
    assert chosen_of([contact(0, 0, 0.1), contact(0, 0, 0.0), contact(1, 0, 0.2)]) == [1, 2]
    assert chosen_of([contact(0, 0, 0.1), contact(0.5, 0, 0.0), contact(1, 0, 0.2)], keys=[5, 5, 6]) == [1, 2]
    assert sorted(chosen_of([contact(0, 0), contact(0, 0, normal=[1.0, 0.0, 0.0])], keys=[5, 5])) == [0, 1]


def test_points_on_one_line_are_its_ends() -> None:
    line = [contact(x, 0.0) for x in (0.0, 0.1, 0.2, 0.9, 1.0)]
    assert sorted(chosen_of(line)) == [0, 4]


def test_rounding_does_not_choose() -> None:
    rng = np.random.default_rng(3)
    grid = np.array([contact(x, y) for x in np.linspace(-1, 1, 5) for y in np.linspace(-1, 1, 5)])
    first = chosen_of(grid)
    for _ in range(20):
        noisy = grid.copy()
        noisy[:, 6] += 1e-11 * rng.normal(size=len(grid))
        assert chosen_of(noisy) == first


def test_thinning_out_keeps_what_would_be_chosen_at_the_front() -> None:
    rng, work = np.random.default_rng(4), new_work()
    contacts = np.array([contact(*rng.normal(size=2), gap=0.01 * rng.normal()) for _ in range(FULL)])
    work.contacts[:FULL], work.keys[:FULL] = contacts, np.arange(100, 100 + FULL)
    expected = chosen_of(contacts)
    count = thin_out(work, FULL)
    assert (work.keys[:count] - 100).tolist() == expected
    np.testing.assert_array_equal(work.contacts[:count], contacts[expected])
