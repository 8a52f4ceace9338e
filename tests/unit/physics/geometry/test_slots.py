"""Forms of the arrays of shapes, kinds that compiled code compares, and faces, edges and corners in a direction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.collision.broad_phase import SEARCH, Search
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Shape, Sphere
from uwserver.physics.geometry.slots import (
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    MESH,
    POLYHEDRON,
    RIM,
    RING,
    SHAPES,
    SLOT,
    SPHERE,
    Shapes,
    support,
    support_face,
    support_feature,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.rows import facets


def test_each_array_of_the_shapes_has_a_form() -> None:
    assert tuple(SHAPES) == Shapes._fields
    assert SHAPES["slots"] == SLOT


def test_a_search_has_the_shapes_and_its_own() -> None:
    assert set(SEARCH) == {*Shapes._fields, *Search._fields}
    assert all(SEARCH[name] == form for name, form in SHAPES.items())


def test_round_kinds_come_first() -> None:
    """Kernels ask for them with one comparison."""
    assert max(SPHERE, CAPSULE, CYLINDER) < min(POLYHEDRON, HALF_SPACE, MESH)


RNG = np.random.default_rng(12)
DIRECTIONS = [v / np.linalg.norm(v) for v in RNG.normal(size=(12, 3))]
PLACE, ATTITUDE = np.array([1.0, -2.0, 3.0]), quat_from_rpy(0.3, -0.4, 1.1)
CONVEX: dict[str, Shape] = {
    "sphere": Sphere(0.7),
    "capsule": Capsule(0.3, 0.8),
    "cylinder": Cylinder(0.4, 0.9),
    "box": Box((0.5, 0.3, 0.2)),
    "hull": ConvexHull(RNG.normal(size=(25, 3))),
}


def placed(shape: Shape) -> Shapes:
    shapes = shapes_of([part(Placed(shape))])
    shapes.P[0], shapes.R[0] = PLACE, Placed(shape, q=ATTITUDE).R
    return shapes


def points_of(shape: Shape) -> FloatArray:
    """Corners of its facets, in N."""
    from uwserver.physics.geometry.shapes import Solid

    corners = facets(Solid("s", (Placed(shape),))).corners.reshape(-1, 3)
    result: FloatArray = corners @ Placed(shape, q=ATTITUDE).R.T + PLACE
    return result


def support_of(shapes: Shapes, d: FloatArray) -> float:
    return support(shapes.slots[0], shapes.P[0], shapes.R[0], d, shapes.vertices)


@pytest.mark.parametrize("d", DIRECTIONS)
@pytest.mark.parametrize("name", CONVEX)
def test_the_support_function_is_the_farthest_point(name: str, d: FloatArray) -> None:
    """Facets of round shapes fall short of them by a little, never the other way."""
    found, farthest = support_of(placed(CONVEX[name]), d), float((points_of(CONVEX[name]) @ d).max())
    assert farthest - 1e-12 <= found <= farthest + (1e-12 if name in ("box", "hull") else 4e-3)


@pytest.mark.parametrize("name", ["cylinder", "capsule"])
def test_the_support_function_along_the_axis(name: str) -> None:
    shape, shapes = CONVEX[name], placed(CONVEX[name])
    axis = shapes.R[0][:, 0].copy()
    assert isinstance(shape, Cylinder | Capsule)
    end = shape.half_length + (shape.radius if name == "capsule" else 0.0)
    assert support_of(shapes, axis) - PLACE @ axis == pytest.approx(end)
    assert support_of(shapes, -axis) + PLACE @ axis == pytest.approx(end)


@pytest.mark.parametrize("d", DIRECTIONS)
@pytest.mark.parametrize("name", ["box", "hull"])
def test_the_face_along_a_direction_is_the_one_of_the_largest_cosine(name: str, d: FloatArray) -> None:
    shapes, normal = placed(CONVEX[name]), np.empty(3)
    cosine = support_face(shapes.slots[0], shapes.R[0], d, shapes.face_normals, normal)
    normals = shapes.face_normals @ shapes.R[0].T
    assert cosine == pytest.approx(float((normals @ d).max()))
    np.testing.assert_allclose(normal, normals[np.argmax(normals @ d)], rtol=0.0, atol=1e-14)


def test_a_cylinder_has_its_two_ends_as_faces_and_other_round_shapes_have_none() -> None:
    normal = np.empty(3)
    shapes = placed(CONVEX["cylinder"])
    axis = shapes.R[0][:, 0].copy()
    d = (axis + 0.1 * DIRECTIONS[0]) / np.linalg.norm(axis + 0.1 * DIRECTIONS[0])
    for sign in (1.0, -1.0):
        assert support_face(shapes.slots[0], shapes.R[0], sign * d, shapes.face_normals, normal) == pytest.approx(
            d @ axis
        )
        np.testing.assert_array_equal(normal, sign * axis)
    for name in ("sphere", "capsule"):
        other = placed(CONVEX[name])
        assert support_face(other.slots[0], other.R[0], d, other.face_normals, normal) == -2.0


def feature(shapes: Shapes, d: FloatArray) -> FloatArray:
    ring, codes = np.full((4 * RING, 3), np.nan), np.full(4 * RING, -1)
    count = support_feature(shapes, 0, d, ring, codes)
    assert len(set(codes[:count])) == count
    return ring[:count]


@pytest.mark.parametrize("d", DIRECTIONS)
@pytest.mark.parametrize("name", ["box", "hull"])
def test_the_feature_of_a_polyhedron_is_its_face_counter_clockwise(name: str, d: FloatArray) -> None:
    shapes, normal = placed(CONVEX[name]), np.empty(3)
    ring = feature(shapes, d)
    support_face(shapes.slots[0], shapes.R[0], d, shapes.face_normals, normal)
    np.testing.assert_allclose(ring @ normal, support_of(shapes, normal), rtol=0.0, atol=1e-9)
    for k in range(len(ring)):
        assert np.cross(ring[k - 1] - ring[k - 2], ring[k] - ring[k - 1]) @ normal > 0.0


@pytest.mark.parametrize("d", DIRECTIONS)
def test_the_feature_of_a_sphere_is_its_point(d: FloatArray) -> None:
    np.testing.assert_allclose(feature(placed(CONVEX["sphere"]), d), [PLACE + 0.7 * d], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["cylinder", "capsule"])
def test_the_side_of_a_round_shape_is_the_line_that_is_farthest(name: str) -> None:
    shape, shapes = CONVEX[name], placed(CONVEX[name])
    axis, across = shapes.R[0][:, 0], shapes.R[0][:, 1]
    d = math.cos(0.2) * across + math.sin(0.2) * axis
    ring = feature(shapes, d)
    assert isinstance(shape, Cylinder | Capsule)
    assert len(ring) == 2
    np.testing.assert_allclose(ring[0] - ring[1], 2.0 * shape.half_length * axis, rtol=0.0, atol=1e-14)
    assert float((ring @ d).max()) == pytest.approx(support_of(shapes, d), abs=1e-14)


def test_the_end_of_a_capsule_is_one_point_of_its_ball() -> None:
    shapes = placed(CONVEX["capsule"])
    axis = shapes.R[0][:, 0]
    d = -(axis + 0.2 * DIRECTIONS[1]) / np.linalg.norm(axis + 0.2 * DIRECTIONS[1])
    np.testing.assert_allclose(feature(shapes, d), [PLACE - 0.8 * axis + 0.3 * d], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_end_of_a_cylinder_is_its_rim(sign: float) -> None:
    shapes = placed(CONVEX["cylinder"])
    axis, d = shapes.R[0][:, 0], sign * shapes.R[0][:, 0]
    tilted = d + 0.1 * shapes.R[0][:, 2]
    tilted /= np.linalg.norm(tilted)
    ring = feature(shapes, tilted)
    assert len(ring) == RIM
    spokes = ring - PLACE - sign * 0.9 * axis
    np.testing.assert_allclose(np.linalg.norm(spokes, axis=1), 0.4, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(spokes @ axis, 0.0, rtol=0.0, atol=1e-14)
    for k in range(RIM):
        assert np.cross(ring[k - 1] - ring[k - 2], ring[k] - ring[k - 1]) @ d > 0.0
    assert float(ring[0] @ tilted) == pytest.approx(support_of(shapes, tilted), abs=1e-14)
