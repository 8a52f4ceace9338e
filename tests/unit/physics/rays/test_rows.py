"""Triangles of solids are closed, outward, and of the right size and material; rows of what rays may hit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Shape,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.rows import AROUND, Facets, facets, middle, planes, sides

POINTS = np.random.default_rng(8).normal(size=(30, 3))
VOLUMES: list[tuple[Shape, float]] = [
    (Box((0.5, 0.3, 0.2)), 8.0 * 0.03),
    (Sphere(0.7), 4.0 / 3.0 * math.pi * 0.343),
    (Cylinder(0.4, 0.9), math.pi * 0.16 * 1.8),
    (Capsule(0.4, 0.9), math.pi * 0.16 * 1.8 + 4.0 / 3.0 * math.pi * 0.064),
]


def volume(corners: FloatArray) -> float:
    """By the divergence theorem; negative if the triangles look inward."""
    return float(np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def corners_of(shape: Shape, **placed: object) -> FloatArray:
    return facets(Solid("s", (Placed(shape, **placed),))).corners  # type: ignore[arg-type]


@pytest.mark.parametrize(("shape", "expected"), VOLUMES, ids=lambda x: type(x).__name__)
def test_the_triangles_hold_the_volume_from_outside(shape: Shape, expected: float) -> None:
    """Facets of round shapes have their corners on the surface, so they hold a little less."""
    found = volume(corners_of(shape))
    assert expected * (1.0 - 2.0 * (math.pi / AROUND) ** 2 - 0.003) <= found <= expected * (1.0 + 1e-12)


@pytest.mark.parametrize(
    "shape", [*(shape for shape, _ in VOLUMES), ConvexHull(POINTS)], ids=lambda x: type(x).__name__
)
def test_the_surface_is_closed(shape: Shape) -> None:
    """Each edge stands twice, once in each sense; areas times normals add up to nothing."""
    corners = corners_of(shape)
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(sides.sum(axis=0), 0.0, rtol=0.0, atol=1e-12)
    keys = np.round(corners, 9) + 0.0
    edges = {}
    for triangle in keys:
        for k in range(3):
            edge = (tuple(triangle[k]), tuple(triangle[(k + 1) % 3]))
            edges[edge] = edges.get(edge, 0) + 1
    assert all(edges.get((b, a)) == count == 1 for (a, b), count in edges.items() if a != b)


def test_a_hull_has_its_own_volume() -> None:
    from scipy.spatial import ConvexHull as Quickhull

    assert volume(corners_of(ConvexHull(POINTS))) == pytest.approx(Quickhull(POINTS).volume)


@pytest.mark.parametrize("shape", [Sphere(0.7), Capsule(0.4, 0.9), Cylinder(0.4, 0.9)], ids=lambda x: type(x).__name__)
def test_corners_of_round_shapes_lie_on_them(shape: Sphere | Capsule | Cylinder) -> None:
    length = 0.0 if isinstance(shape, Sphere) else shape.half_length
    x, r = corners_of(shape)[..., 0], np.linalg.norm(corners_of(shape)[..., 1:], axis=-1)
    if isinstance(shape, Cylinder):
        on = np.isclose(np.abs(x), length) & ((np.isclose(r, shape.radius)) | (r == 0.0))
    else:
        on = np.isclose(np.hypot(np.maximum(np.abs(x) - length, 0.0), r), shape.radius)
    assert on.all()


def test_a_placed_shape_is_moved_and_turned() -> None:
    q, p = quat_from_rpy(0.1, 0.2, 0.3), (1.0, -2.0, 3.0)
    plain, moved = corners_of(Box((0.5, 0.3, 0.2))), corners_of(Box((0.5, 0.3, 0.2)), p=p, q=q)
    np.testing.assert_allclose(moved, plain @ Placed(Sphere(1.0), q=q).R.T + p, rtol=0.0, atol=1e-15)


def test_materials_are_those_of_the_shape_or_else_of_the_solid() -> None:
    both = facets(Solid("s", (Placed(Box((1.0,) * 3), material=4), Placed(Box((1.0,) * 3))), material=2))
    assert both.material.tolist() == [4] * 12 + [2] * 12


def test_only_a_sheet_can_be_seen_from_both_sides() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shapes = tuple(Placed(TriangleMesh(triangle, np.array([[0, 1, 2]]), oriented)) for oriented in (True, False))
    found = facets(Solid("s", (*shapes, Placed(Box((1.0,) * 3)))))
    assert found.sided.tolist() == [1, 0] + [1] * 12
    np.testing.assert_array_equal(found.corners[0], triangle)


def test_a_half_space_has_no_triangles() -> None:
    found = facets(Solid("s", (Placed(HalfSpace()),)))
    assert (found.corners.shape, found.material.shape, found.sided.shape) == ((0, 3, 3), (0,), (0,))


BOX = facets(Solid("box", (Placed(Box((0.5, 0.3, 0.2)), (1.0, 2.0, 3.0), material=4),)))


def test_planes_are_those_of_half_spaces_with_the_outward_normal() -> None:
    slope = Placed(HalfSpace(), (0.0, 0.0, 10.0), quat_from_rpy(0.3, 0.0, 0.0))
    other = Placed(HalfSpace(), (1.0, 0.0, 0.0), material=5)
    found = planes([(3, Solid("a", (slope, Placed(Sphere(1.0))), material=2)), (8, Solid("b", (other,)))])
    assert found["body"].tolist() == [3, 8]
    assert found["material"].tolist() == [2, 5]
    np.testing.assert_array_equal(found["point"], [slope.p, other.p])
    np.testing.assert_allclose(found["normal"][0], -slope.R[:, 2], rtol=0.0, atol=1e-15)
    assert len(planes([])) == 0


def test_sides_stand_about_a_point_with_outward_unit_normals() -> None:
    rows = sides(BOX, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(rows["corners"] + [1.0, 2.0, 3.0], BOX.corners, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(rows["normal"], axis=1), 1.0)
    assert (np.einsum("ni,ni->n", rows["normal"], rows["corners"][:, 0]) > 0.0).all()
    assert set(rows["material"]) == {4}
    assert rows["sided"].all()


def test_a_triangle_without_area_has_no_normal() -> None:
    flat = Facets(np.zeros((1, 3, 3)), np.zeros(1, np.int64), np.ones(1, np.int64))
    assert not sides(flat, np.zeros(3))["normal"].any()


def test_the_middle_is_that_of_the_box_around_all() -> None:
    centre, half = middle(BOX)
    assert centre.tolist() == pytest.approx([1.0, 2.0, 3.0])
    assert half.tolist() == pytest.approx([0.5, 0.3, 0.2])
