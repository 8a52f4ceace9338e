"""Shapes as plain data: what is refused, and how they are placed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy, rotate
from uwserver.physics.geometry.shapes import (
    TILE_TRIANGLES,
    BadSolid,
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Shape,
    Sphere,
    TriangleMesh,
    check_shape,
    has_area,
)

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
ONE = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    "shape",
    [
        Box((0.1, 1.0, 10.0)), Sphere(1e-3), Cylinder(1.0, 2.0), Capsule(0.1, 0.2), HalfSpace(), ConvexHull(CORNERS),
        TriangleMesh(TRIANGLE, ONE), TriangleMesh(TRIANGLE, ONE, oriented=False),
    ],
)  # fmt: skip
def test_sound_shapes_pass(shape: Shape) -> None:
    check_shape(shape)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf, 2e5])
def test_sizes_that_no_engine_may_get(size: float) -> None:
    for shape in (Box((1.0, size, 1.0)), Sphere(size), Cylinder(size, 1.0), Cylinder(1.0, size), Capsule(1.0, size)):
        with pytest.raises(BadSolid, match="positive and below 100 km"):
            check_shape(shape)


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        (TriangleMesh(TRIANGLE[:, :2], ONE), r"array \(n, 3\)"),
        (TriangleMesh(np.array([[0.0, 0.0, math.nan], *TRIANGLE]), ONE), "1 vertices of a mesh are not finite"),
        (TriangleMesh(TRIANGLE, ONE[:0]), "at least one"),
        (TriangleMesh(TRIANGLE, np.array([[0, 1, 2, 0]])), r"array \(m, 3\)"),
        (TriangleMesh(TRIANGLE, np.array([[0, 1, 3]])), "names vertex 3, but there are 3"),
        (TriangleMesh(TRIANGLE, np.array([[0, 1, -1]])), "names vertex"),
        (TriangleMesh(TRIANGLE, np.array([[0, 1, 1]])), "1 triangles of a mesh have no area"),
        (TriangleMesh(TRIANGLE, np.repeat(ONE, TILE_TRIANGLES + 1, axis=0)), "cut it into tiles"),
    ],
)
def test_meshes_that_no_engine_may_get(mesh: TriangleMesh, text: str) -> None:
    with pytest.raises(BadSolid, match=text):
        check_shape(mesh)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (CORNERS[:3], "span a volume"),
        (CORNERS[CORNERS[:, 2] == 0.0], "span a volume"),
        (np.where(CORNERS == 0.0, math.inf, CORNERS), "not finite"),
        (CORNERS.ravel(), r"array \(n, 3\)"),
    ],
)
def test_hulls_that_no_engine_may_get(points: np.ndarray, text: str) -> None:
    with pytest.raises(BadSolid, match=text):
        check_shape(ConvexHull(points))


def test_a_triangle_has_area_if_it_has_a_height() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1e-6, 0.0], [2.0, 1e-10, 0.0]])
    assert has_area(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 0]])).tolist() == [
        False,
        True,
        False,
        False,
    ]


def test_a_kilometre_and_a_micrometre_are_judged_alike() -> None:
    for scale in (1e-6, 1.0, 1e3):
        assert has_area(scale * TRIANGLE, ONE).all()


def test_a_placed_shape_has_the_matrix_of_its_attitude() -> None:
    q = quat_from_rpy(0.3, -0.2, 1.0)
    np.testing.assert_allclose(
        Placed(Sphere(1.0), q=q).R @ (1.0, 2.0, 3.0), rotate(q, (1.0, 2.0, 3.0)), rtol=0.0, atol=1e-15
    )
    np.testing.assert_array_equal(Placed(Sphere(1.0)).R, np.eye(3))
