"""Shapes that lie on a face: their line is that of the search, and no engine is asked."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from uwserver.frames import Quat, matrix, quat_from_rpy
from uwserver.physics.collision.cores import new_cores
from uwserver.physics.collision.directions import LINE, apart, out_of_triangle
from uwserver.physics.collision.engine import missing_engine
from uwserver.physics.collision.faces import SHALLOW, out_of_face, over_triangle
from uwserver.physics.collision.manifold import new_work
from uwserver.physics.collision.solids import Solids
from uwserver.physics.collision.ways import WaysOut
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    Placed,
    Shape,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.physics.geometry.slots import Shapes, support
from uwserver.physics.kernel.arrays import FloatArray

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
HALF = np.array([0.3, 0.2, 0.1])
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
POINTS = np.random.default_rng(7).normal(size=(20, 3))
POINTS *= 0.2 / np.linalg.norm(POINTS, axis=1)[:, None]
MOVED: dict[str, Shape] = {
    "box": Box((0.3, 0.2, 0.1)),
    "sphere": Sphere(0.1),
    "capsule": Capsule(0.1, 0.3),
    "cylinder": Cylinder(0.1, 0.3),
    "hull": ConvexHull(POINTS),
}


def pair(a: Shape, p: Any, q: Quat, b: Shape, q_b: Quat = LEVEL) -> Shapes:
    shapes = shapes_of([part(Placed(a)), part(Placed(b))])
    shapes.P[0], shapes.R[0], shapes.R[1] = p, Placed(a, q=q).R, Placed(b, q=q_b).R
    return shapes


def triangle() -> TriangleMesh:
    """One large triangle in the plane z = 0, its outside up."""
    vertices = np.array([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
    return TriangleMesh(vertices, np.array([[0, 1, 2]]), True)


def lines_of(shapes: Shapes, reach: float) -> tuple[int, FloatArray, int, FloatArray]:
    """Outcome and line at once, and those of the search."""
    quick, slow, cores = np.zeros(LINE), np.zeros(LINE), new_cores()
    at_once = over_triangle(shapes, 0, 1, 0, reach, cores, new_work(), quick)
    searched = apart(shapes, 0, 1, 0, reach, cores, slow)
    if searched < 0:
        assert out_of_triangle(shapes, 0, 1, 0, cores, slow)
        searched = 1
    return at_once, quick, searched, slow


def lowest(shapes: Shapes) -> float:
    """Height of shape a over the plane z = 0 (z is down), from its line to a triangle without end."""
    line = np.zeros(LINE)
    assert over_triangle(shapes, 0, 1, 0, 1e9, new_cores(), new_work(), line) == 1
    return float(line[6])


@pytest.mark.parametrize("name", MOVED)
def test_over_a_triangle_the_line_is_that_of_the_search(name: str) -> None:
    """Up to 0.9 mm deep and 20 mm above, at any attitude, over it, beside it and over its edges."""
    rng, tried = np.random.default_rng(3), {-1: 0, 0: 0, 1: 0}
    shapes = pair(MOVED[name], (0.0, 0.0, 0.0), LEVEL, triangle())
    for _ in range(400):
        p, q = np.array([*rng.uniform(-1.2, 1.2, 2), -2.0]), quat_from_rpy(*rng.uniform(-3, 3, 3))
        shapes.P[0], shapes.R[0] = (-0.5, -0.5, -2.0), matrix(q)
        p[2] += lowest(shapes) - rng.choice([-0.9e-3, -1e-5, 1e-3, 0.02])
        shapes.P[0] = p
        at_once, quick, searched, slow = lines_of(shapes, 0.01)
        tried[at_once] += 1
        if at_once == 1:
            assert searched == 1
            np.testing.assert_allclose(quick[[0, 1, 2, 6]], slow[[0, 1, 2, 6]], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(quick[3:6], slow[3:6], rtol=0.0, atol=1e-6)
        if at_once == 0:
            assert searched == 0
    assert min(tried.values()) > 20


@pytest.mark.parametrize("name", ["box", "cylinder"])
def test_what_lies_flat_over_a_triangle_needs_no_corner_in_it(name: str) -> None:
    small = np.array([[-0.05, -0.05, 0.0], [-0.05, 0.05, 0.0], [0.05, -0.05, 0.0]])
    mesh = TriangleMesh(small, np.array([[0, 1, 2]]), True)
    line = np.zeros(LINE)
    shapes = pair(MOVED[name], (0.0, 0.0, -0.1 + 1e-5), quat_from_rpy(0.0, 1e-4, 0.0), mesh)
    assert over_triangle(shapes, 0, 1, 0, 0.01, new_cores(), new_work(), line) == 1
    np.testing.assert_allclose(line[:3], [0.0, 0.0, -1.0], rtol=0.0, atol=1e-15)
    assert line[6] == pytest.approx(-1e-5, abs=1e-4 * 0.06)  # over the triangle, not at the corner 0.3 m away
    assert abs(line[3]) <= 0.05 + 1e-8


@pytest.mark.parametrize("name", MOVED)
@pytest.mark.parametrize(("away", "outcome"), [(0.005, -1), (0.02, 0)])
def test_what_is_far_beside_a_triangle_needs_no_search(name: str, away: float, outcome: int) -> None:
    """As most triangles of a mesh are that are near a body; this one's side runs along x = -1."""
    shapes = pair(MOVED[name], (0.0, 0.0, 0.0), LEVEL, triangle())
    half = support(shapes.slots[0], shapes.P[0], shapes.R[0], np.array([1.0, 0.0, 0.0]), shapes.vertices)
    level = lowest(pair(MOVED[name], (-0.5, -0.5, -2.0), LEVEL, triangle())) - 2.0
    shapes.P[0] = -1.0 - away - half, 0.0, level
    assert over_triangle(shapes, 0, 1, 0, 0.01, new_cores(), new_work(), np.zeros(LINE)) == outcome


def test_deep_in_a_triangle_a_search_tells() -> None:
    line = np.zeros(LINE)
    shapes = pair(MOVED["box"], (-0.5, -0.5, -0.1 - 1.01 * SHALLOW), LEVEL, triangle())
    assert over_triangle(shapes, 0, 1, 0, 0.01, new_cores(), new_work(), line) == -1


def test_two_boxes_against_all_their_axes() -> None:
    """What is found is the best of the six faces, and within a millimetre of the shortest way of all."""
    rng, found, edges = np.random.default_rng(5), 0, 0
    box = Box((0.3, 0.2, 0.1))
    for _ in range(1000):
        q_a, q_b = (quat_from_rpy(*rng.uniform(-3, 3, 3)) for _ in range(2))
        if rng.random() < 0.5:
            q_b = q_a
        A, B, p = np.array(matrix(q_a)), np.array(matrix(q_b)), rng.uniform(-0.4, 0.4, 3)
        crossed = np.cross(A.T[:, None], B.T[None]).reshape(9, 3)
        lengths = np.linalg.norm(crossed, axis=1)
        ways = np.concatenate([A.T, B.T, crossed[lengths > 1e-6] / lengths[lengths > 1e-6, None]])

        def gaps(n: FloatArray, p: FloatArray, A: FloatArray = A, B: FloatArray = B) -> FloatArray:
            """Along directions (m, 3)."""
            return ((SIGNS * HALF @ A.T + p) @ n.T).min(axis=0) - ((SIGNS * HALF @ B.T) @ n.T).max(axis=0)

        ways = np.concatenate([ways[:6], -ways[:6], ways[6:], -ways[6:]])
        before = gaps(ways, p)
        p += (-before.max() - rng.uniform(1e-6, 0.9e-3)) * ways[before.argmax()]
        after = gaps(ways, p)
        if after.max() > -1e-7:
            continue
        line = np.zeros(LINE)
        if not out_of_face(pair(box, p, q_a, box, q_b), 0, 1, new_cores(), new_work(), line):
            edges += 1
            continue
        found += 1
        assert line[6] == pytest.approx(after[:12].max(), abs=1e-12)
        assert gaps(line[None, :3], p)[0] == pytest.approx(line[6], abs=1e-12)
        assert line[6] >= max(SHALLOW, after.max() + SHALLOW)
        on_b = B.T @ line[3:6]
        assert (np.abs(on_b) <= HALF + 1e-3).all()
    assert found > 100
    assert edges > 100


@pytest.mark.parametrize("name", MOVED)
def test_on_a_floor_the_way_out_is_up_from_both_sides(name: str) -> None:
    floor, line = Box((2.0, 2.0, 0.5)), np.zeros(LINE)
    lower = float(POINTS[:, 2].max()) if name == "hull" else 0.1
    shapes = pair(MOVED[name], (0.1, 0.2, -0.5 - lower + 1e-4), LEVEL, floor)
    assert out_of_face(shapes, 0, 1, new_cores(), new_work(), line)
    np.testing.assert_allclose(line[:3], [0.0, 0.0, -1.0], rtol=0.0, atol=1e-15)
    assert [line[5], line[6]] == pytest.approx([-0.5, -1e-4], abs=1e-12)
    assert out_of_face(shapes, 1, 0, new_cores(), new_work(), line)
    np.testing.assert_allclose(line[:3], [0.0, 0.0, 1.0], rtol=0.0, atol=1e-15)
    assert [line[5], line[6]] == pytest.approx([-0.5 + 1e-4, -1e-4], abs=1e-12)
    shapes.P[0, 2] += 1e-3
    assert not out_of_face(shapes, 0, 1, new_cores(), new_work(), line), "1.1 mm deep"


class Asked(WaysOut):
    """Counts what it is asked."""

    times = 0

    def way_out(self, *pair: Any) -> FloatArray:
        self.times += 1
        return super().way_out(*pair)


@pytest.mark.skipif(missing_engine() is not None, reason="no engine for contacts is installed")
def test_an_engine_is_not_asked_about_what_rests() -> None:
    asked = Asked()
    state: Any = np.zeros((1, 13))
    state[0, 3] = 1.0
    with Solids(ways=asked) as solids:
        solids.add_static(Solid("table", (Placed(Box((1.0, 1.0, 0.5))),)))
        solids.add_moving(Solid("crate", (Placed(Box((0.3, 0.2, 0.1))),)), 0)
        for depth, times in ((1e-5, 0), (9e-4, 0), (2e-3, 1)):
            state[0, 2] = -0.6 + depth
            contacts = solids.find_contacts(state, 1e-3)
            np.testing.assert_allclose(contacts.gap, [-depth] * 4, rtol=0.0, atol=1e-12)
            assert asked.times == times
