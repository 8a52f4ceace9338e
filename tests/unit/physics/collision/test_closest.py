"""Closest points of two shapes against closed forms, and against the conditions that only the closest points fulfil."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.frames import Quat, matrix, quat_from_rpy
from uwserver.physics.collision.closest import shape_distance
from uwserver.physics.collision.cores import FAR, Cores, core_radius, new_cores
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Shape, Sphere
from uwserver.physics.geometry.slots import Shapes, support
from uwserver.physics.kernel.arrays import FloatArray

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
UP = np.array([0.0, 0.0, -1.0])
CORNERS = np.random.default_rng(7).normal(size=(20, 3))
SHAPES: dict[str, Shape] = {
    "box": Box((0.3, 0.2, 0.1)),
    "sphere": Sphere(0.2),
    "capsule": Capsule(0.1, 0.3),
    "cylinder": Cylinder(0.15, 0.25),
    "hull": ConvexHull(0.25 * CORNERS / np.linalg.norm(CORNERS, axis=1)[:, None]),
}


def pair(a: Shape, p: Any, q: Quat, b: Shape, q_b: Quat = LEVEL) -> tuple[Shapes, Cores]:
    """Shape a in slot 0 at p, and b in slot 1 at the origin."""
    shapes = shapes_of([part(Placed(a)), part(Placed(b))])
    return shapes, placed(shapes, p, q, q_b)


def placed(shapes: Shapes, p: Any, q: Quat, q_b: Quat) -> Cores:
    shapes.P[0], shapes.R[0], shapes.R[1] = p, matrix(q), matrix(q_b)
    cores = new_cores()
    cores.a[0], cores.b[0] = 0, 1
    cores.n[:] = UP
    return cores


def gap(shapes: Shapes, n: FloatArray) -> float:
    """Along n, from the support functions."""
    slots, P, R, corners = shapes.slots, shapes.P, shapes.R, shapes.vertices
    return float(-support(slots[0], P[0], R[0], -n, corners) - support(slots[1], P[1], R[1], n, corners))


def radii(shapes: Shapes, cores: Cores) -> float:
    return float(core_radius(shapes, 0, cores.lines[0]) + core_radius(shapes, 1, cores.lines[1]))


@pytest.mark.parametrize("b", SHAPES)
@pytest.mark.parametrize("a", SHAPES)
def test_the_gap_along_the_direction_is_as_large_as_the_points_are_apart(a: str, b: str) -> None:
    """Of convex shapes that is true of the closest points and of nothing else: no gap is larger, no points are nearer (duality)."""
    flat_ends = "cylinder" in (a, b)  # over which the points, not the direction, are less exact
    rng = np.random.default_rng(3)
    shapes, _ = pair(SHAPES[a], (0.0, 0.0, 0.0), LEVEL, SHAPES[b])
    tried = 0
    while tried < 60:
        q_a, q_b = (quat_from_rpy(*rng.uniform(-3, 3, 3)) for _ in range(2))
        cores = placed(shapes, rng.uniform(-0.6, 0.6, 3), q_a, q_b)
        distance = shape_distance(shapes, cores, FAR)
        if distance == 0.0:
            continue
        tried += 1
        assert np.linalg.norm(cores.n) == pytest.approx(1.0, abs=1e-14)
        assert gap(shapes, cores.n.copy()) == pytest.approx(
            distance - radii(shapes, cores), abs=1e-8 if flat_ends else 1e-12
        )
        assert np.linalg.norm(cores.xa - cores.xb) == pytest.approx(distance, abs=1e-8 if flat_ends else 1e-12)


@pytest.mark.parametrize("height", [1e-5, 1e-3, 0.5])
def test_two_rims(height: float) -> None:
    """Standing cylinders whose rims cross: the direction lies in the plane of their axes, however near they are."""
    upright = quat_from_rpy(0.0, np.pi / 2, 0.0)
    offset, tall = np.array([0.28, 0.1, 0.0]), np.array([0.0, 0.0, -(0.4 + height)])
    shapes, cores = pair(Cylinder(0.15, 0.2), offset + tall, upright, Cylinder(0.14, 0.2), upright)
    distance = shape_distance(shapes, cores, FAR)
    apart = np.linalg.norm(offset) - 0.29
    want = np.array([*(apart * offset / np.linalg.norm(offset))[:2], -height])
    np.testing.assert_allclose(cores.n, want / np.linalg.norm(want), rtol=0.0, atol=1e-11)
    assert distance == pytest.approx(np.linalg.norm(want), abs=1e-14)


@pytest.mark.parametrize("turn", [0.0, 1e-5, 0.7])
def test_the_sides_of_two_cylinders_are_those_of_their_axes(turn: float) -> None:
    shapes, cores = pair(Cylinder(0.1, 0.5), (0.2, 0.0, -0.25), quat_from_rpy(0.0, 0.0, turn), Cylinder(0.1, 0.5))
    distance = shape_distance(shapes, cores, FAR)
    np.testing.assert_allclose(cores.n, UP, rtol=0.0, atol=1e-15)
    assert distance - radii(shapes, cores) == pytest.approx(0.05, abs=1e-15)


def test_a_rim_before_an_edge() -> None:
    """A standing cylinder beside and above the edge of a box: its rim has one point that is nearest to the edge."""
    upright = quat_from_rpy(0.0, np.pi / 2, 0.0)
    shapes, cores = pair(Cylinder(0.15, 0.2), (0.5, 0.0, -0.34), upright, Box((0.3, 1.0, 0.1)))
    distance = shape_distance(shapes, cores, FAR)
    want = np.array([0.05, 0.0, -0.04])
    np.testing.assert_allclose(cores.n, want / np.linalg.norm(want), rtol=0.0, atol=1e-12)
    assert distance == pytest.approx(np.linalg.norm(want), abs=1e-15)
    np.testing.assert_allclose(cores.xb, [0.3, 0.0, -0.1], rtol=0.0, atol=1e-12)


def test_shapes_that_overlap_have_no_distance_and_far_ones_are_not_looked_at() -> None:
    shapes, cores = pair(Box((0.3, 0.2, 0.1)), (0.0, 0.0, -0.19), LEVEL, Box((0.3, 0.2, 0.1)))
    assert shape_distance(shapes, cores, FAR) == 0.0
    shapes, cores = pair(Box((0.3, 0.2, 0.1)), (0.0, 0.0, -2.0), LEVEL, Box((0.3, 0.2, 0.1)))
    assert shape_distance(shapes, cores, 0.1) == FAR
    assert shape_distance(shapes, cores, 1.81) == pytest.approx(1.8, abs=1e-14)


def test_far_from_the_origin_it_is_as_exact_as_the_numbers() -> None:
    shapes, cores = pair(
        Cylinder(0.15, 0.2), (0.5, 0.0, -0.34), quat_from_rpy(0.0, np.pi / 2, 0.0), Box((0.3, 1.0, 0.1))
    )
    shapes.P[:] += [5000.0, -3000.0, 80.0]
    shape_distance(shapes, cores, FAR)
    want = np.array([0.05, 0.0, -0.04])
    np.testing.assert_allclose(cores.n, want / np.linalg.norm(want), rtol=0.0, atol=1e-10)
