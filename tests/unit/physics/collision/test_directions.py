"""Ways out of overlaps: exact whatever an engine's rounding, and against brute force over all candidates."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from uwserver.frames import Quat, matrix, quat_from_rpy
from uwserver.physics.collision.cores import new_cores
from uwserver.physics.collision.directions import LINE, apart, out_of_triangle, triangles_in, way_out
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, Cylinder, Placed, Shape, Sphere, TriangleMesh
from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import FloatArray

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
UP = np.array([0.0, 0.0, -1.0])
HALF = np.array([0.3, 0.2, 0.1])
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def pair(a: Shape, p: Any, q: Quat, b: Shape, q_b: Quat = LEVEL) -> Shapes:
    shapes = shapes_of([part(Placed(a)), part(Placed(b))])
    shapes.P[0], shapes.R[0], shapes.R[1] = p, Placed(a, q=q).R, Placed(b, q=q_b).R
    return shapes


def unit(v: Any) -> FloatArray:
    x: FloatArray = np.asarray(v, float) / np.linalg.norm(v)
    return x


def out(shapes: Shapes, start: Any) -> FloatArray:
    line = np.array([*unit(start), *[0.0] * 4])
    assert way_out(shapes, 0, 1, -1, new_cores(), line)
    return line


@pytest.mark.parametrize("shape", [Box((0.3, 0.2, 0.1)), Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.1, 0.3)], ids=repr)
@pytest.mark.parametrize("depth", [0.0, 1e-9, 1e-5, 1e-3, 0.05])
@pytest.mark.parametrize("error", [0.0, 2e-6, 1e-3])
def test_out_of_a_floor_the_way_is_straight_up_whatever_the_engine_s_rounding(
    shape: Shape, depth: float, error: float
) -> None:
    shapes = pair(shape, (0.2, 0.1, -0.1 - 0.5 + depth), LEVEL, Box((1.0, 1.0, 0.5)))
    line = out(shapes, UP + error * np.array([1.0, 0.5, 0.0]))
    np.testing.assert_allclose(line[:3], UP, rtol=0.0, atol=1e-14)
    assert line[6] == pytest.approx(-depth, abs=1e-14)
    assert line[5] == pytest.approx(-0.5, abs=1e-14)


@pytest.mark.parametrize("depth", [1e-6, 1e-3, 0.02])
def test_out_of_a_rim(depth: float) -> None:
    """A ball whose middle is inside a cylinder's rim comes out away from the ring on which the rim is nearest."""
    rim = Cylinder(0.5, 0.3)
    n = unit([1.0, 1.0, 0.0])
    shapes = pair(
        Cylinder(0.02, 0.1), np.array([0.3, 0.5, 0.0]) + (0.1 - depth) * n, quat_from_rpy(0, 0, np.pi / 4), rim
    )
    line = out(shapes, n + np.array([0.0, 0.01, 0.01]))
    cap = np.array([1.0, 0.0, 0.0])
    # From the rim outward all directions between cap and side are ways out; the shortest is that of the cylinder's own end.
    assert line[6] <= 0.0
    assert min(float(line[:3] @ cap), float(line[1])) >= -1e-12


def test_two_boxes_against_all_their_faces_and_edges() -> None:
    """The shortest way out of two boxes is among 15 axes; a direction that is off by 1e-3 leads to it exactly."""
    rng, tried = np.random.default_rng(1), 0
    while tried < 100:
        q_a, q_b = (quat_from_rpy(*rng.uniform(-3, 3, 3)) for _ in range(2))
        A, B, p = np.array(matrix(q_a)), np.array(matrix(q_b)), rng.uniform(-0.4, 0.4, 3)
        axes = np.concatenate([A.T, B.T, np.cross(A.T[:, None], B.T[None]).reshape(9, 3)])
        ways = np.concatenate([axes, -axes]) / np.tile(np.linalg.norm(axes, axis=1), 2)[:, None]
        gaps = ((SIGNS * HALF @ A.T + p) @ ways.T).min(axis=0) - ((SIGNS * HALF @ B.T) @ ways.T).max(axis=0)
        order = np.argsort(gaps)[::-1]
        if not -0.03 < gaps[order[0]] < -1e-6 or gaps[order[0]] - gaps[order[1]] < 5e-3:
            continue
        tried += 1
        line = out(
            pair(Box((0.3, 0.2, 0.1)), p, q_a, Box((0.3, 0.2, 0.1)), q_b), ways[order[0]] + 1e-3 * rng.normal(size=3)
        )
        np.testing.assert_allclose(line[:3], ways[order[0]], rtol=0.0, atol=1e-12)
        assert line[6] == pytest.approx(gaps[order[0]], abs=1e-13)


def triangle(oriented: bool = True) -> TriangleMesh:
    """One large triangle in the plane z = 0, its outside up."""
    vertices = np.array([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
    return TriangleMesh(vertices, np.array([[0, 1, 2]]), oriented)


def out_of(shape: Shape, p: Any, oriented: bool = True) -> FloatArray:
    line, cores = np.zeros(LINE), new_cores()
    shapes = pair(shape, p, LEVEL, triangle(oriented))
    assert apart(shapes, 0, 1, 0, 0.1, cores, line) == -1
    assert out_of_triangle(shapes, 0, 1, 0, cores, line)
    return line


def test_out_of_a_triangle_along_its_normal_and_over_its_edge() -> None:
    flat = out_of(Box((0.1, 0.1, 0.1)), (-0.5, -0.5, -0.08))
    np.testing.assert_allclose(flat[:3], UP, rtol=0.0, atol=1e-14)
    assert flat[6] == pytest.approx(-0.02, abs=1e-14)
    over = out_of(Box((0.1, 0.1, 0.1)), (-1.095, -0.5, -0.08))  # 5 mm of it are over the edge x = -1
    np.testing.assert_allclose(over[:3], [-1.0, 0.0, 0.0], rtol=0.0, atol=1e-14)
    assert over[6] == pytest.approx(-0.005, abs=1e-14)


def test_through_a_sheet_but_not_through_a_seabed() -> None:
    """Nearly through it, a body goes on through a sheet and back out of a seabed."""
    sheet, seabed = (out_of(Box((0.1, 0.1, 0.1)), (-0.5, -0.5, 0.08), oriented) for oriented in (False, True))
    np.testing.assert_allclose([*sheet[:3], sheet[6]], [*-UP, -0.02], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose([*seabed[:3], seabed[6]], [*UP, -0.18], rtol=0.0, atol=1e-14)


def test_the_triangles_in_a_box_are_each_found_once() -> None:
    n = 13
    x, y = np.meshgrid(np.linspace(-3, 3, n), np.linspace(-3, 3, n), indexing="ij")
    vertices = np.stack([x, y, np.sin(x) * np.cos(y)], -1).reshape(-1, 3)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, d, b), (b, d, c))])
    shapes = shapes_of([part(Placed(TriangleMesh(vertices, faces)))])
    corners = shapes.vertices[shapes.triangles]
    rng, found = np.random.default_rng(2), np.empty(400, np.int64)
    for _ in range(200):
        low = rng.uniform(-4, 4, 3)
        high = low + rng.uniform(0, 2, 3)
        want = np.flatnonzero(((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1))
        count = triangles_in(shapes, 0, low, high, found)
        assert sorted(found[:count]) == want.tolist()
