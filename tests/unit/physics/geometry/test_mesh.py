"""Questions to a mesh, against brute force over its triangles."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.geometry.mesh import (
    AT_POINT,
    any_triangle_in,
    distance_to_triangle,
    fill_cells,
    in_normal_cone,
    triangles_at,
)
from uwserver.physics.geometry.rows import part, shapes_of
from uwserver.physics.geometry.shapes import Box, Placed, TriangleMesh
from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import FloatArray

RNG = np.random.default_rng(13)


def terrain(n: int = 7, roughness: float = 0.4) -> TriangleMesh:
    """A square of 6 m seen from above (z down)."""
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, n + 1), np.linspace(-3.0, 3.0, n + 1), indexing="ij")
    z = roughness * np.random.default_rng(1).normal(size=x.shape)
    faces = []
    for i in range(n):
        for j in range(n):
            a = i * (n + 1) + j
            faces += [(a, a + 1, a + n + 1), (a + n + 1, a + 1, a + n + 2)]
    return TriangleMesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), np.array(faces))


@pytest.fixture(scope="module")
def shapes() -> Shapes:
    """A box, then two tiles of terrain side by side, of which the second lies 6 m north."""
    mesh = terrain()
    return shapes_of([part(Placed(Box((1.0,) * 3))), part(Placed(mesh)), part(Placed(mesh, (6.0, 0.0, 0.0)))])


def corners(shapes: Shapes) -> FloatArray:
    result: FloatArray = shapes.vertices[shapes.triangles]
    return result


# -- distance -------------------------------------------------------------------------------------------------------------------------

TRIANGLE = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("x", "distance"),
    [
        ((0.5, 0.25, 0.7), 0.7), ((0.5, 0.25, -0.7), 0.7), ((-3.0, -4.0, 0.0), 5.0), ((5.0, -4.0, 0.0), 5.0), ((-3.0, 5.0, 0.0), 5.0),
        ((1.0, -2.0, 0.0), 2.0), ((-1.5, 0.5, 2.0), 2.5), ((1.0 + 0.2, 0.5 + 0.4, 0.0), np.sqrt(0.2)), ((0.0, 0.0, 0.0), 0.0),
    ],
)  # fmt: skip
def test_distance_from_face_corners_and_edges(x: tuple[float, ...], distance: float) -> None:
    for k in range(3):  # whichever corner comes first
        assert distance_to_triangle(np.array(x), *np.roll(TRIANGLE, k, axis=0)) == pytest.approx(distance, abs=1e-15)


def test_distance_against_points_of_the_triangle() -> None:
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 201), np.linspace(0.0, 1.0, 201))
    inside = u + v <= 1.0
    for _ in range(40):
        a, b, c, x = RNG.normal(size=(4, 3))
        points = a + u[inside][:, None] * (b - a) + v[inside][:, None] * (c - a)
        nearest = np.linalg.norm(points - x, axis=1).min()
        assert nearest - 0.03 <= distance_to_triangle(x, a, b, c) <= nearest + 1e-12


# -- cells ----------------------------------------------------------------------------------------------------------------------------


def test_cells_list_what_may_be_in_them_and_little_else() -> None:
    mesh = terrain()
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cells = np.array([5, 4, 3])
    size = float(((high - low) / cells).max())
    start, members = fill_cells(mesh.vertices, mesh.faces, low, size, cells)
    assert start[0] == 0
    assert start[-1] == len(members)
    points = mesh.vertices[mesh.faces]
    for cell in range(60):
        at = np.array(np.unravel_index(cell, cells)) * size + low
        listed = set(members[start[cell] : start[cell + 1]])
        for slack, contains in ((-1e-9, listed.issuperset), (2e-3 * size, listed.issubset)):
            meets = ((points.min(axis=1) <= at + size + slack) & (points.max(axis=1) >= at - slack)).all(axis=1)
            assert contains(set(np.flatnonzero(meets)))


@pytest.mark.parametrize("seed", range(3))
def test_a_box_meets_a_triangle_s_box_or_none(shapes: Shapes, seed: int) -> None:
    rng = np.random.default_rng(seed)
    answers = []
    for _ in range(60):
        low = rng.uniform([-5.0, -5.0, -2.0], [9.0, 5.0, 2.0])
        high = low + rng.uniform(0.0, 0.8, 3)
        for s in (1, 2):
            first, count = shapes.slots[s]["face_first"], shapes.slots[s]["face_count"]
            points = corners(shapes)[first : first + count]
            expected = ((points.min(axis=1) <= high) & (points.max(axis=1) >= low)).all(axis=1).any()
            assert any_triangle_in(shapes, s, low, high) == expected
            answers.append(expected)
    assert 0.05 < np.mean(answers) < 0.95


# -- points ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("near", [1e-4, 0.3])
def test_the_triangles_at_a_point_are_those_within_reach(shapes: Shapes, near: float) -> None:
    points = corners(shapes)
    found = np.empty(AT_POINT, np.int64)
    places = [*points[::9].mean(axis=1), *points[::7, 0], *RNG.uniform([-4.0, -4.0, -1.0], [10.0, 4.0, 1.0], (30, 3))]
    counts = []
    for x in places:
        count = triangles_at(shapes, x, near, found)
        expected = {k for k, t in enumerate(points) if distance_to_triangle(x, *t) <= near}
        if len(expected) <= AT_POINT:
            assert set(found[:count]) == expected
            counts.append(count)
    assert min(counts) == 0
    assert max(counts) >= 6


def test_a_point_on_the_seam_of_two_tiles_knows_both(shapes: Shapes) -> None:
    found = np.empty(AT_POINT, np.int64)
    seam = shapes.vertices[shapes.triangles].reshape(-1, 3)
    edge = seam[np.isclose(seam[:, 0], 3.0) & (np.abs(seam[:, 1]) < 0.5)][0]
    first_of_second = shapes.slots[2]["face_first"]
    count = triangles_at(shapes, edge, 0.5, found)
    owners = {int(k >= first_of_second) for k in found[:count]}
    assert owners == {0, 1}


def test_no_more_triangles_than_there_is_room_for(shapes: Shapes) -> None:
    found = np.empty(AT_POINT, np.int64)
    assert triangles_at(shapes, np.zeros(3), 50.0, found) == AT_POINT
    assert len(set(found)) == AT_POINT


def test_shapes_that_are_no_meshes_have_no_triangles() -> None:
    found = np.empty(AT_POINT, np.int64)
    assert triangles_at(shapes_of([part(Placed(Box((1.0,) * 3)))]), np.zeros(3), 1.0, found) == 0


# -- normals --------------------------------------------------------------------------------------------------------------------------


def roof(height: float) -> tuple[Shapes, FloatArray, int]:
    """Two sides that meet in an edge along x at the origin: a ridge for a positive height (up is -z), a valley for a negative one."""
    vertices = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, height], [0.0, -1.0, height]])
    shapes = shapes_of([part(Placed(TriangleMesh(vertices, np.array([[0, 2, 1], [0, 1, 3]]))))])
    found = np.empty(AT_POINT, np.int64)
    return shapes, found, triangles_at(shapes, np.zeros(3), 1e-4, found)


def normal(angle: float) -> FloatArray:
    """Up, leaning by an angle towards y."""
    return np.array([0.0, np.sin(angle), -np.cos(angle)])


@pytest.mark.parametrize(
    ("angle", "allowed"), [(0.0, True), (0.3, True), (-0.3, True), (0.6, False), (-0.6, False), (np.pi, False)]
)
def test_a_ridge_has_all_normals_between_those_of_its_sides(angle: float, allowed: bool) -> None:
    shapes, found, count = roof(0.5)  # sides lean by 0.46 rad
    assert count == 2
    assert in_normal_cone(shapes, np.zeros(3), normal(angle), found, count) == allowed


@pytest.mark.parametrize("angle", [0.0, 0.2, -0.2, 0.6])
def test_a_valley_has_no_normal_at_its_edge(angle: float) -> None:
    shapes, found, count = roof(-0.5)
    assert not in_normal_cone(shapes, np.zeros(3), normal(angle), found, count)


def test_a_flat_edge_has_the_normal_of_the_plane_alone() -> None:
    shapes, found, count = roof(0.0)
    assert in_normal_cone(shapes, np.zeros(3), normal(0.0), found, count)
    assert not in_normal_cone(shapes, np.zeros(3), normal(0.01), found, count)


def test_where_nothing_is_there_is_no_normal() -> None:
    shapes, found, _ = roof(0.5)
    assert not in_normal_cone(shapes, np.zeros(3), normal(0.0), found, 0)
