"""Contacts of pairs whose lines are written out here; the lines themselves are tested in test_directions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.frames import Quat, quat_from_rpy
from uwserver.physics.collision.manifold import Work, new_work
from uwserver.physics.collision.narrow_phase import convex_pair, half_space_pair, mesh_pair
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, Cylinder, HalfSpace, Placed, Shape, Sphere, TriangleMesh
from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import FloatArray

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
UP = np.array([0.0, 0.0, -1.0])
REACH = 0.05


def pair(a: Shape, p: Any, q: Quat, b: Shape, p_b: Any = (0.0, 0.0, 0.0), q_b: Quat = LEVEL) -> Shapes:
    """Shape a in slot 0 and b in slot 1, where they are."""
    shapes = shapes_of([part(Placed(a)), part(Placed(b))])
    for s, place, attitude in ((0, p, q), (1, p_b, q_b)):
        shapes.P[s], shapes.R[s] = place, Placed(a, q=attitude).R
    return shapes


def contacts_of(work: Work, count: int) -> FloatArray:
    return work.contacts[:count].copy()


def on_plane(shape: Shape, p: Any, q: Quat = LEVEL) -> FloatArray:
    work = new_work()
    shapes = pair(shape, p, q, HalfSpace())
    return contacts_of(work, half_space_pair(shapes, 0, 1, REACH, work))


def found(*lines: tuple[Any, Any, float]) -> FloatArray:
    """Lines: direction from b to a, point on b, gap."""
    return np.array([[*n, *p, d] for n, p, d in lines], float).reshape(-1, 7)


# -- half-spaces ----------------------------------------------------------------------------------------------------------------------


def test_a_box_on_a_plane_has_its_four_corners() -> None:
    contacts = on_plane(Box((0.3, 0.2, 0.1)), (1.0, 2.0, -0.09), quat_from_rpy(0.0, 0.0, 0.5))
    assert len(contacts) == 4
    np.testing.assert_allclose(contacts[:, 6], -0.01, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(contacts[:, 2], 0.005, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(contacts[:, 3:6], [UP] * 4)
    np.testing.assert_allclose(np.linalg.norm(contacts[:, :2] - [1.0, 2.0], axis=1), math.hypot(0.3, 0.2))


def test_a_tilted_box_has_those_corners_that_are_near() -> None:
    contacts = on_plane(Box((0.3, 0.2, 0.1)), (0.0, 0.0, -0.15), quat_from_rpy(0.0, -0.3, 0.0))
    assert len(contacts) == 2
    assert (np.sign(contacts[:, 0]) == np.sign(contacts[0, 0])).all()


@pytest.mark.parametrize("gap", [-0.02, 0.0, 0.04])
def test_a_ball_has_one_contact_below_it(gap: float) -> None:
    (contact,) = on_plane(Sphere(0.2), (0.5, 0.0, -0.2 - gap))
    np.testing.assert_allclose(contact, [0.5, 0.0, -0.5 * gap, *UP, gap], rtol=0.0, atol=1e-15)


def test_what_is_farther_than_the_reach_has_none() -> None:
    assert len(on_plane(Sphere(0.2), (0.0, 0.0, -0.26))) == 0


def test_a_cylinder_lies_on_a_line_and_stands_on_a_rim() -> None:
    lying = on_plane(Cylinder(0.1, 0.5), (0.0, 0.0, -0.1))
    np.testing.assert_allclose(np.sort(lying[:, 0]), [-0.5, 0.5], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(lying[:, 6], 0.0, rtol=0.0, atol=1e-15)
    standing = on_plane(Cylinder(0.1, 0.5), (0.0, 0.0, -0.5), quat_from_rpy(0.0, math.pi / 2, 0.0))
    assert len(standing) > 8
    np.testing.assert_allclose(np.hypot(standing[:, 0], standing[:, 1]), 0.1, rtol=0.0, atol=1e-12)


# -- convex shapes --------------------------------------------------------------------------------------------------------------------


def convex(shapes: Shapes, lines: FloatArray) -> FloatArray:
    work = new_work()
    return contacts_of(work, convex_pair(shapes, 0, 1, lines, REACH, work))


def test_a_box_on_a_larger_box_has_its_corners() -> None:
    """The line knows one point; 1e-5 off a face is on it."""
    shapes = pair(Box((0.3, 0.2, 0.1)), (0.1, 0.0, -1.099), LEVEL, Box((1.0, 1.0, 1.0)))
    contacts = convex(shapes, found(((1e-5, 0.0, -1.0), (0.1, 0.0, -1.0), -0.001)))
    assert len(contacts) == 4
    np.testing.assert_array_equal(contacts[:, 3:6], [UP] * 4)
    np.testing.assert_allclose(contacts[:, 6], -0.001, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.sort(np.abs(contacts[:, 0])), [0.2, 0.2, 0.4, 0.4], rtol=0.0, atol=1e-12)


def test_a_box_over_the_edge_of_another_has_the_corners_of_the_overlap() -> None:
    shapes = pair(Box((0.3, 0.2, 0.1)), (0.9, 0.0, -1.1), LEVEL, Box((1.0, 1.0, 1.0)))
    contacts = convex(shapes, found((UP, (0.9, 0.0, -1.0), 0.0)))
    np.testing.assert_allclose(np.sort(contacts[:, 0]), [0.6, 0.6, 1.0, 1.0], rtol=0.0, atol=1e-7)


def test_the_same_pair_the_other_way_round_has_the_same_points() -> None:
    above = pair(Box((0.3, 0.2, 0.1)), (0.1, 0.0, -1.099), LEVEL, Box((1.0, 1.0, 1.0)))
    below = pair(Box((1.0, 1.0, 1.0)), (0.0, 0.0, 0.0), LEVEL, Box((0.3, 0.2, 0.1)), (0.1, 0.0, -1.099))
    ours = convex(above, found((UP, (0.1, 0.0, -1.0), -0.001)))
    theirs = convex(below, found((-UP, (0.1, 0.0, -0.999), -0.001)))
    np.testing.assert_allclose(theirs[:, 3:6], -ours[:, 3:6], rtol=0.0, atol=1e-12)
    order, other = (np.lexsort(np.round(c[:, :3], 6).T) for c in (ours, theirs))
    np.testing.assert_allclose(theirs[other][:, :3], ours[order][:, :3], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(theirs[:, 6], -0.001, rtol=0.0, atol=1e-12)


def test_balls_have_the_direction_of_the_line_and_their_own_gap() -> None:
    n = np.array([0.6, 0.0, 0.8])
    shapes = pair(Sphere(0.2), 0.47 * n, LEVEL, Sphere(0.3))
    contacts = convex(shapes, found((n, 0.3 * n, -0.031)))  # 1 mm wrong
    np.testing.assert_allclose(contacts, [[*(0.285 * n), *n, -0.03]], rtol=0.0, atol=1e-12)


def test_parallel_cylinders_touch_along_a_line() -> None:
    shapes = pair(Cylinder(0.1, 0.5), (0.2, 0.0, -0.2), LEVEL, Capsule(0.1, 0.5))
    contacts = convex(shapes, found((UP, (0.2, 0.0, -0.1), 0.0)))
    assert set(np.round(contacts[:, 0], 6)) == {-0.3, 0.5}


def test_crossed_cylinders_touch_in_a_point() -> None:
    shapes = pair(Cylinder(0.1, 0.5), (0.2, 0.0, -0.2), quat_from_rpy(0.0, 0.0, 1.2), Cylinder(0.1, 0.5))
    contacts = convex(shapes, found((UP, (0.2, 0.0, -0.1), 0.0)))
    np.testing.assert_allclose(contacts, [[0.2, 0.0, -0.1, *UP, 0.0]], rtol=0.0, atol=1e-12)


def test_no_line_gives_no_contact() -> None:
    shapes = pair(Sphere(0.2), (0.0, 0.0, -1.0), LEVEL, Sphere(0.3))
    assert len(convex(shapes, found())) == 0


def test_what_a_line_calls_near_is_judged_by_its_own_gap() -> None:
    shapes = pair(Sphere(0.2), (0.0, 0.0, -1.0), LEVEL, Sphere(0.3))
    assert len(convex(shapes, found((UP, (0.0, 0.0, -0.3), 0.0)))) == 0


# -- meshes ---------------------------------------------------------------------------------------------------------------------------


def floor(oriented: bool = True, slope: float = 0.0) -> TriangleMesh:
    """Four triangles about the origin, which is a corner of all; x > 0 falls off by a slope (a ridge along y)."""
    corners = [(0, 0), (-2, -2), (2, -2), (2, 2), (-2, 2)]
    vertices = np.array([[x, y, slope * max(x, 0.0)] for x, y in corners], float)
    return TriangleMesh(vertices, np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4]]), oriented)


def on_mesh(shape: Shape, p: Any, lines: FloatArray, mesh: TriangleMesh, q: Quat = LEVEL) -> FloatArray:
    work, shapes = new_work(), pair(shape, p, q, mesh)
    return contacts_of(work, mesh_pair(shapes, 0, 1, lines, REACH, work))


def test_a_ball_on_a_triangle() -> None:
    lines = found((UP, (1.0, 0.2, 0.0), -0.01))
    np.testing.assert_allclose(
        on_mesh(Sphere(0.2), (1.0, 0.2, -0.19), lines, floor()), [[1.0, 0.2, 0.005, *UP, -0.01]], rtol=0.0, atol=1e-12
    )


def test_a_box_on_a_flat_seam_has_its_corners_once_each() -> None:
    """Its face lies over four triangles; a corner of it is over one, crossings are on their borders."""
    at = (0.0, 0.0, -0.1 - 1e-3)
    lines = found(*((UP, (x, y, 0.0), 1e-3) for x, y in ((0.3, 0.1), (-0.3, 0.1), (0.1, 0.3), (0.1, -0.3))))
    contacts = on_mesh(Box((0.4, 0.4, 0.1)), at, lines, floor())
    np.testing.assert_array_equal(contacts[:, 3:6], [UP] * len(contacts))
    np.testing.assert_allclose(contacts[:, 6], 1e-3, rtol=0.0, atol=1e-12)
    corners = {(round(x, 6), round(y, 6)) for x, y in contacts[:, :2]}
    assert {(-0.4, -0.4), (-0.4, 0.4), (0.4, -0.4), (0.4, 0.4)} <= corners


def test_no_contact_on_the_edge_of_a_smooth_surface() -> None:
    """A line offers a slanted normal at a flat seam, where a sliding body would catch."""
    slanted = np.array([0.3, 0.0, -1.0]) / math.hypot(0.3, 1.0)
    lines = found((slanted, (1.0, 1.0, 0.0), 0.01))
    assert len(on_mesh(Sphere(0.2), (1.07, 1.0, -0.2), lines, floor())) == 0


def test_a_ball_on_a_ridge_has_the_normal_between_its_sides() -> None:
    n = np.array([math.sin(0.3), 0.0, -math.cos(0.3)])
    lines = found((n, (0.0, 0.0, 0.0), -0.01))
    (contact,) = on_mesh(Sphere(0.2), 0.19 * n, lines, floor(slope=1.0))
    np.testing.assert_allclose(contact[3:6], n, rtol=0.0, atol=1e-15)
    assert contact[6] == pytest.approx(-0.01)


def test_a_sheet_carries_on_both_sides_and_a_seabed_on_one() -> None:
    """From below: the sheet pushes down, the seabed up and out."""
    lines = found((-UP, (1.0, 0.2, 0.0), -0.01))
    (sheet,) = on_mesh(Sphere(0.2), (1.0, 0.2, 0.19), lines, floor(oriented=False))
    np.testing.assert_allclose(sheet[3:], [*-UP, -0.01], rtol=0.0, atol=1e-12)
    (seabed,) = on_mesh(Sphere(0.2), (1.0, 0.2, 0.19), lines, floor())
    np.testing.assert_allclose(seabed[3:], [*UP, -0.39], rtol=0.0, atol=1e-12)


def test_deep_inside_where_no_feature_explains_it_the_deepest_point_is_left() -> None:
    slanted = np.array([0.6, 0.0, -0.8])
    lines = found((slanted, (1.0, 1.0, 0.0), -0.05), (slanted, (1.0, 1.1, 0.0), -0.02))
    (contact,) = on_mesh(Sphere(0.2), np.array([1.0, 1.0, 0.0]) + 0.15 * slanted, lines, floor())
    np.testing.assert_array_equal(contact[3:6], slanted)
    assert contact[6] == pytest.approx(-0.05)
    shallow = found((slanted, (1.0, 1.0, 0.0), -0.0019))
    assert len(on_mesh(Sphere(0.2), np.array([1.0, 1.0, 0.0]) + 0.198 * slanted, shallow, floor())) == 0
