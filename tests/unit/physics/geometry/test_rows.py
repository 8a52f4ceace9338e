"""Shapes as rows: polyhedra of boxes and hulls, grids of meshes, and many of them end to end."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.rows import Polyhedron, Stock, part, polyhedron, shapes_of
from uwserver.physics.geometry.shapes import (
    HULL_POINTS,
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
)
from uwserver.physics.geometry.slots import CAPSULE, CYLINDER, HALF_SPACE, MESH, POLYHEDRON, SHAPES, SPHERE
from uwserver.physics.kernel.arrays import FloatArray

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def grid(n: int = 6, seed: int = 1) -> TriangleMesh:
    """A bumpy square of 2 n^2 triangles, seen from above (z down)."""
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, n + 1), np.linspace(-3.0, 3.0, n + 1), indexing="ij")
    z = 0.2 * np.random.default_rng(seed).normal(size=x.shape)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    faces = []
    for i in range(n):
        for j in range(n):
            a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, i * (n + 1) + j + 1, (i + 1) * (n + 1) + j + 1
            faces += [(a, c, b), (b, c, d)]
    return TriangleMesh(vertices, np.array(faces))


def normals_of(solid: Polyhedron) -> FloatArray:
    """Of each face, from its first three corners."""
    rings = [solid.vertices[list(face)] for face in solid.faces]
    crossed = np.array([np.cross(ring[1] - ring[0], ring[2] - ring[1]) for ring in rings])
    result: FloatArray = crossed / np.linalg.norm(crossed, axis=1, keepdims=True)
    return result


SOLIDS = {
    "box": Box((0.5, 0.3, 0.2)),
    "cube as a hull": ConvexHull(CORNERS),
    "hull": ConvexHull(np.random.default_rng(2).normal(size=(40, 3))),
    "prism": ConvexHull(
        np.array([[c, s, z] for c, s in [(np.cos(a), np.sin(a)) for a in range(5)] for z in (0.0, 1.0)])
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_faces_are_flat_convex_and_look_outward(name: str) -> None:
    solid = polyhedron(SOLIDS[name])  # type: ignore[arg-type]
    np.testing.assert_allclose(normals_of(solid), solid.normals, rtol=0.0, atol=1e-9)
    for face, normal in zip(solid.faces, solid.normals, strict=True):
        heights = solid.vertices @ normal
        np.testing.assert_allclose(heights[list(face)], heights.max(), rtol=0.0, atol=1e-9)
        ring = solid.vertices[list(face)]
        for k in range(len(ring)):
            a, b, c = ring[k - 2], ring[k - 1], ring[k]
            assert np.cross(b - a, c - b) @ normal > 0.0


@pytest.mark.parametrize("name", SOLIDS)
def test_a_polyhedron_satisfies_euler(name: str) -> None:
    solid = polyhedron(SOLIDS[name])  # type: ignore[arg-type]
    edges = {frozenset((face[k - 1], face[k])) for face in solid.faces for k in range(len(face))}
    assert len(solid.vertices) - len(edges) + len(solid.faces) == 2


def test_triangles_of_one_plane_are_one_face() -> None:
    assert sorted(len(face) for face in polyhedron(ConvexHull(CORNERS)).faces) == [4] * 6


def test_points_inside_a_hull_are_left_out() -> None:
    inside = np.concatenate([CORNERS, 0.5 * CORNERS])
    assert len(polyhedron(ConvexHull(inside)).vertices) == 8


def test_hulls_that_are_flat_or_too_fine_are_refused() -> None:
    with pytest.raises(BadSolid, match="no volume"):
        polyhedron(ConvexHull(np.concatenate([CORNERS[:4] * [0.0, 1.0, 1.0]] * 2)))
    sphere = np.random.default_rng(3).normal(size=(HULL_POINTS + 50, 3))
    with pytest.raises(BadSolid, match=f"at most {HULL_POINTS}"):
        polyhedron(ConvexHull(sphere / np.linalg.norm(sphere, axis=1, keepdims=True)))


@pytest.mark.parametrize(
    ("shape", "kind", "half"),
    [
        (Sphere(0.2), SPHERE, (0.2, 0.2, 0.2)),
        (Capsule(0.2, 0.5), CAPSULE, (0.7, 0.2, 0.2)),
        (Cylinder(0.2, 0.5), CYLINDER, (0.5, 0.2, 0.2)),
        (Box((0.1, 0.2, 0.3)), POLYHEDRON, (0.1, 0.2, 0.3)),
        (HalfSpace(), HALF_SPACE, (0.0, 0.0, 0.0)),
        (ConvexHull(np.add(CORNERS, [1.0, 0.0, 0.0])), POLYHEDRON, (1.0, 1.0, 1.0)),
    ],
)
def test_a_slot_has_the_kind_and_the_box_of_its_shape(shape: Shape, kind: int, half: tuple[float, ...]) -> None:
    slot = part(Placed(shape, (1.0, 2.0, 3.0), quat_from_rpy(0.1, 0.2, 0.3))).slot[0]
    assert slot["kind"] == kind
    np.testing.assert_allclose(slot["half"], half)
    np.testing.assert_allclose(slot["centre"], [1.0, 0.0, 0.0] if isinstance(shape, ConvexHull) else 0.0, atol=1e-15)
    assert slot["p"].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(slot["R"], Placed(shape, q=quat_from_rpy(0.1, 0.2, 0.3)).R)


def test_a_mesh_stands_in_n_with_outward_normals() -> None:
    mesh, q = grid(), quat_from_rpy(0.1, -0.2, 0.4)
    placed = Placed(mesh, (1.0, 2.0, 3.0), q)
    found = part(placed)
    assert found.mesh is not None
    np.testing.assert_allclose(found.mesh.vertices, mesh.vertices @ placed.R.T + [1.0, 2.0, 3.0], rtol=0.0, atol=1e-14)
    assert found.slot["kind"][0] == MESH
    np.testing.assert_array_equal(found.slot["R"][0], np.eye(3))
    assert found.normals is not None
    assert (found.normals @ placed.R[:, 2] < 0.0).all()  # upwards, as z is down
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0)


@pytest.mark.parametrize("flat", [False, True])
def test_each_triangle_is_in_every_cell_that_its_box_meets(flat: bool) -> None:
    mesh = grid(5)
    if flat:
        mesh.vertices[:, 2] = 0.0
    found = part(Placed(mesh))
    slot, start, members = found.slot[0], found.cell_start, found.cell_triangles
    assert start is not None
    assert members is not None
    assert len(start) == slot["cells"].prod() + 1
    corners = mesh.vertices[mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    for cell in range(len(start) - 1):
        at = np.array(np.unravel_index(cell, slot["cells"]))
        cell_low = slot["cell_origin"] + at * slot["cell_size"]
        meets = ((low <= cell_low + slot["cell_size"]) & (high >= cell_low)).all(axis=1)
        assert set(np.flatnonzero(meets)) <= set(members[start[cell] : start[cell + 1]])


def test_parts_end_to_end_refer_to_their_own() -> None:
    first, second = Placed(Box((0.5, 0.3, 0.2))), Placed(ConvexHull(CORNERS))
    mesh, other = grid(3), grid(2, seed=4)
    shapes = shapes_of([part(p) for p in (first, Placed(mesh), Placed(Sphere(1.0)), second, Placed(other))])
    assert shapes.slots["kind"].tolist() == [POLYHEDRON, MESH, SPHERE, POLYHEDRON, MESH]
    for s, placed in ((0, first), (3, second)):
        slot, own = shapes.slots[s], polyhedron(placed.shape)  # type: ignore[arg-type]
        np.testing.assert_array_equal(shapes.vertices[slot["vertex_first"] :][: slot["vertex_count"]], own.vertices)
        for k, face in enumerate(own.faces):
            f = slot["face_first"] + k
            ring = shapes.face_vertices[shapes.face_start[f] : shapes.face_start[f + 1]]
            assert (ring - slot["vertex_first"]).tolist() == list(face)
            np.testing.assert_array_equal(shapes.face_normals[f], own.normals[k])
    for s, own_mesh in ((1, mesh), (4, other)):
        slot = shapes.slots[s]
        triangles = shapes.triangles[slot["face_first"] :][: slot["face_count"]]
        np.testing.assert_array_equal(shapes.vertices[triangles], own_mesh.vertices[own_mesh.faces])
        first_cell, cells = slot["cell_first"], slot["cells"].prod()
        bounds = shapes.cell_start[first_cell], shapes.cell_start[first_cell + cells]
        listed = shapes.cell_triangles[bounds[0] : bounds[1]]
        assert set(listed) == set(range(slot["face_first"], slot["face_first"] + slot["face_count"]))


def test_rows_are_of_the_forms_that_kernels_read() -> None:
    for parts in ([], [part(Placed(Box((1.0,) * 3))), part(Placed(grid(2)))]):
        shapes = shapes_of(parts)
        for name, form in SHAPES.items():
            array = getattr(shapes, name)
            assert (array.dtype, array.shape[1:]) == (form.base, form.shape), name


# -- a stock --------------------------------------------------------------------------------------------------------------------------


def test_equal_shapes_share_their_corners_and_triangles() -> None:
    stock, box, mesh = Stock(), Placed(Box((0.5, 0.3, 0.2))), Placed(grid())
    first = stock.shapes([stock.part(box), stock.part(mesh)])
    again = stock.shapes([stock.part(box) for _ in range(50)] + [stock.part(mesh)])
    for name in set(SHAPES) - {"slots", "P", "R"}:
        assert len(getattr(again, name)) == len(getattr(first, name))
    for name in ("vertex_first", "vertex_count", "face_first", "face_count", "cell_first"):
        assert set(again.slots[name][:50]) == {first.slots[name][0]}
        assert again.slots[name][50] == first.slots[name][1]


def test_what_a_slot_refers_to_is_the_same_whoever_else_was_ever_there() -> None:
    hull, box, mesh = Placed(SOLIDS["hull"]), Placed(Box((0.5, 0.3, 0.2))), Placed(grid())
    stock = Stock()
    stock.shapes([stock.part(box), stock.part(mesh), stock.part(hull)])
    shapes, alone = stock.shapes([stock.part(hull), stock.part(mesh)]), shapes_of([part(hull), part(mesh)])
    for k, slot, own in zip(range(2), shapes.slots, alone.slots, strict=True):
        points = slice(slot["vertex_first"], slot["vertex_first"] + slot["vertex_count"])
        lone = slice(own["vertex_first"], own["vertex_first"] + own["vertex_count"])
        np.testing.assert_array_equal(shapes.vertices[points], alone.vertices[lone])
        faces = [
            [
                shapes.face_vertices[shapes.face_start[f] : shapes.face_start[f + 1]] - slot["vertex_first"]
                for f in where
            ]
            if k == 0
            else shapes.triangles[where] - slot["vertex_first"]
            for shapes, slot, where in (
                (shapes, slot, range(slot["face_first"], slot["face_first"] + slot["face_count"])),
                (alone, own, range(own["face_first"], own["face_first"] + own["face_count"])),
            )
        ]
        for one, other in zip(*faces, strict=True):
            np.testing.assert_array_equal(one, other)
    slot, own = shapes.slots[1], alone.slots[1]
    count = int(np.prod(slot["cells"]))
    for c in range(count):
        listed = [
            found.cell_triangles[found.cell_start[first + c] : found.cell_start[first + c + 1]] - where
            for found, first, where in (
                (shapes, slot["cell_first"], slot["face_first"]),
                (alone, own["cell_first"], own["face_first"]),
            )
        ]
        np.testing.assert_array_equal(*listed)


def test_a_part_is_nobody_elses() -> None:
    stock, box = Stock(), Placed(Box((0.5, 0.3, 0.2)))
    stock.part(box).slot["row"] = 7
    assert stock.part(box).slot["row"] == 0
