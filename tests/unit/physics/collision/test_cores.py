"""Closest points of cores with corners and edges, against closed forms; of whole shapes in test_closest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.physics.collision.cores import FAR, Cores, core_distance, core_gap, new_cores
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, Placed, Shape, Sphere
from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import FloatArray


def pair(a: Shape, p: Any, b: Shape) -> tuple[Shapes, Cores]:
    """Shape a in slot 0 at p, and b in slot 1 at the origin, both level."""
    shapes, cores = shapes_of([part(Placed(a)), part(Placed(b))]), new_cores()
    shapes.P[0], shapes.R[:] = p, np.eye(3)
    cores.a[0], cores.b[0], cores.n[2] = 0, 1, -1.0
    return shapes, cores


@pytest.mark.parametrize(
    "p", [(1.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, -0.6, 0.7), (0.301, 0.0, 0.0), (0.30001, 0.20001, 0.0)]
)
@pytest.mark.parametrize("start", [(0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)])
def test_a_point_and_a_box(p: Any, start: Any) -> None:
    """Before a face, an edge and a corner, near and far, whatever direction the search begins with."""
    shapes, cores = pair(Sphere(0.2), p, Box((0.3, 0.2, 0.1)))
    cores.n[:] = start
    nearest = np.clip(p, [-0.3, -0.2, -0.1], [0.3, 0.2, 0.1])
    away: FloatArray = np.array(p) - nearest
    assert core_distance(shapes, cores, FAR) == pytest.approx(np.linalg.norm(away), abs=1e-14)
    np.testing.assert_allclose(cores.xa, p, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(cores.xb, nearest, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(cores.n, away / np.linalg.norm(away), rtol=0.0, atol=1e-9)


def test_crossed_and_parallel_axes() -> None:
    shapes, cores = pair(Capsule(0.1, 0.5), (0.2, 0.1, -0.4), Capsule(0.1, 0.5))
    shapes.R[0] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert core_distance(shapes, cores, FAR) == pytest.approx(0.4, abs=1e-15)
    np.testing.assert_allclose(cores.xb, [0.2, 0.0, 0.0], rtol=0.0, atol=1e-15)
    shapes.R[0] = np.eye(3)
    assert core_distance(shapes, cores, FAR) == pytest.approx(np.hypot(0.1, 0.4), abs=1e-15)


@pytest.mark.parametrize("height", [2e-6, 1e-4, 0.1])
def test_a_triangle_under_a_corner_has_its_exact_normal_however_near(height: float) -> None:
    shapes, cores = pair(Box((0.3, 0.2, 0.1)), (0.05, 0.0, -0.1 - height), Box((1.0, 1.0, 1.0)))
    cores.b[0] = -1
    cores.corners[:] = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]
    assert core_distance(shapes, cores, FAR) == pytest.approx(height, abs=1e-15)
    np.testing.assert_allclose(cores.n, [0.0, 0.0, -1.0], rtol=0.0, atol=1e-12)


def test_a_shift_moves_the_first_and_leaves_the_gap_that_is_asked_for() -> None:
    shapes, cores = pair(Box((0.3, 0.2, 0.1)), (0.0, 0.0, -0.15), Box((0.3, 0.2, 0.1)))
    assert core_distance(shapes, cores, FAR) == 0.0
    up = np.array([0.0, 0.0, -1.0])
    cores.shift[2], cores.n[:] = -0.1, up
    assert core_distance(shapes, cores, FAR) == pytest.approx(0.05, abs=1e-15)
    assert core_gap(shapes, cores, up) == pytest.approx(-0.05, abs=1e-15)


def test_what_is_farther_than_the_reach_is_far() -> None:
    shapes, cores = pair(Box((0.3, 0.2, 0.1)), (0.0, 3.0, 0.0), Box((0.3, 0.2, 0.1)))
    assert core_distance(shapes, cores, 2.5) == FAR
    assert core_distance(shapes, cores, 2.7) == pytest.approx(2.6, abs=1e-14)
