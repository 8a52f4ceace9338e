"""Shapes as rows of plain arrays, for compiled contact geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uwserver.physics.geometry.mesh import fill_cells
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
    check_shape,
)
from uwserver.physics.geometry.slots import (
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    MESH,
    POLYHEDRON,
    SHAPES,
    SLOT,
    SPHERE,
    Shapes,
)
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray, Records, joined

_BOX_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Corners of each face of a box, counter-clockwise seen from outside. Bit i of a corner's number selects the sign of axis i."""


@dataclass(frozen=True)
class Polyhedron:
    """Corners (n, 3), faces as rings of corner numbers counter-clockwise seen from outside, and outward `normals` (m, 3)."""

    vertices: FloatArray
    faces: tuple[tuple[int, ...], ...]
    normals: FloatArray


def polyhedron(shape: Box | ConvexHull) -> Polyhedron:
    """Return the corners and plane faces of a box or hull.

    Raises:
        BadSolid: a hull without volume or with more than `HULL_POINTS` corners.
    """
    if isinstance(shape, Box):
        signs = np.array([[1.0 if k >> i & 1 else -1.0 for i in range(3)] for k in range(8)])
        axes = np.eye(3)
        # In the order of _BOX_FACES.
        outward = np.array([-axes[0], axes[0], -axes[1], axes[1], -axes[2], axes[2]])
        return Polyhedron(signs * np.array(shape.half), _BOX_FACES, outward)
    from scipy.spatial import ConvexHull as Quickhull
    from scipy.spatial import QhullError

    try:
        hull = Quickhull(shape.points)
    except QhullError as error:
        raise BadSolid("the points of a hull span no volume") from error
    corners = np.sort(hull.vertices)
    if len(corners) > HULL_POINTS:
        raise BadSolid(f"a hull of {len(corners)} corners: simplify it to at most {HULL_POINTS}")
    vertices = np.ascontiguousarray(shape.points[corners])
    rings: list[tuple[int, ...]] = []
    normals: list[FloatArray] = []
    for members in _coplanar(hull.equations):
        normal = hull.equations[members[0], :3]
        ring = np.unique(np.searchsorted(corners, hull.simplices[members]))
        spokes = vertices[ring] - vertices[ring].mean(axis=0)
        side = np.cross(normal, spokes[0])
        order = np.argsort(np.arctan2(spokes @ side, spokes @ spokes[0] * np.linalg.norm(normal)), kind="stable")
        rings.append(tuple(int(k) for k in ring[order]))
        normals.append(normal)
    return Polyhedron(vertices, tuple(rings), np.array(normals))


def _coplanar(equations: FloatArray) -> list[list[int]]:
    """Group the triangles of a hull that lie in one plane, ordered by their first triangle."""
    groups: list[list[int]] = []
    size = float(np.abs(equations[:, 3]).max())
    for k, plane in enumerate(equations):
        for group in groups:
            first = equations[group[0]]
            if first[:3] @ plane[:3] > 1.0 - 1e-12 and abs(first[3] - plane[3]) <= 1e-9 * size:
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


@dataclass
class Part:
    """One placed shape that is to become part of `Shapes`: its SLOT row (1), whose numbers count from its own first row."""

    slot: Records
    corners: Polyhedron | None = None
    mesh: TriangleMesh | None = None
    normals: FloatArray | None = None
    cell_start: IntArray | None = None
    cell_triangles: IntArray | None = None


def part(placed: Placed) -> Part:
    """Return the rows of one placed shape, which belongs to no solid yet."""
    shape = placed.shape
    slot = np.zeros(1, SLOT)
    slot["p"], slot["R"] = placed.p, placed.R
    if isinstance(shape, TriangleMesh):
        return _mesh_part(slot, placed, shape)
    if isinstance(shape, Box | ConvexHull):
        corners = polyhedron(shape)
        slot["kind"] = POLYHEDRON
        _bound(slot, corners.vertices)
        return Part(slot, corners)
    slot["kind"] = _kind(shape)
    if isinstance(shape, HalfSpace):
        return Part(slot)
    half_length = 0.0 if isinstance(shape, Sphere) else shape.half_length
    round_end = 0.0 if isinstance(shape, Cylinder) else shape.radius
    slot["radius"], slot["half_length"] = shape.radius, half_length
    slot["half"] = half_length + round_end, shape.radius, shape.radius
    return Part(slot)


def _kind(shape: Shape) -> int:
    return {Sphere: SPHERE, Capsule: CAPSULE, Cylinder: CYLINDER, HalfSpace: HALF_SPACE}[type(shape)]


def _bound(slot: Records, points: FloatArray) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    slot["centre"], slot["half"] = 0.5 * (low + high), 0.5 * (high - low)


def _mesh_part(slot: Records, placed: Placed, mesh: TriangleMesh) -> Part:
    """Return the rows of a static mesh: it is transformed to N once, and its triangles are sorted into cells."""
    vertices = np.ascontiguousarray(mesh.vertices @ placed.R.T + np.array(placed.p))
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    slot["kind"], slot["oriented"] = MESH, mesh.oriented
    slot["p"], slot["R"] = 0.0, np.eye(3)
    _bound(slot, vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    edges = high - low + 1e-9
    size = max(float(np.prod(edges) / (2.0 * len(faces))) ** (1.0 / 3.0), float(edges.max()) / 1000.0)
    # A flat mesh has an area to divide among the cells, not a volume.
    size = max(size, float(np.sqrt(np.sort(edges)[1:].prod() / len(faces))))
    slot["cell_origin"], slot["cell_size"] = low, size
    slot["cells"] = np.maximum(1, np.ceil(edges / size)).astype(np.int64)
    start, members = fill_cells(vertices, faces, low, size, slot["cells"][0])
    static = TriangleMesh(vertices, faces, mesh.oriented)
    return Part(slot, None, static, np.ascontiguousarray(normals), start, members)


class Stock:
    """The arrays to which the slots of a world refer. Equal shapes share rows, so that adding or removing a solid changes slots alone. Rows stay
    for later solids with the same shape."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[Placed, Part]] = {}
        self._counts = {"vertices": 0, "faces": 0, "rings": 0, "triangles": 0, "cells": 0, "members": 0}
        self._arrays: dict[str, list[Array]] = {
            name: [np.zeros((1 if name == "face_start" else 0, *form.shape), form.base)]
            for name, form in SHAPES.items()
            if name not in ("slots", "P", "R")
        }

    def part(self, placed: Placed) -> Part:
        """Return the rows of one placed shape, which belongs to no solid yet. They are made once for each `placed`. Raise BadSolid if the shape is
        impossible."""
        known = self._made.get(id(placed))
        if known is None:
            check_shape(placed.shape)
            made = part(placed)
            self.take(made)
            known = self._made[id(placed)] = placed, made  # kept, so that no other object gets this id
        return replace(known[1], slot=known[1].slot.copy())

    def take(self, new: Part) -> None:
        """Add the arrays of a part to the stock, and write their places to its slot."""
        slot, counts = new.slot, self._counts
        slot["vertex_first"] = counts["vertices"]
        if new.corners is not None:
            lengths = np.array([len(face) for face in new.corners.faces], dtype=np.int64)
            slot["vertex_count"], slot["face_first"] = len(new.corners.vertices), counts["faces"]
            slot["face_count"] = len(lengths)
            ring = np.array([k for face in new.corners.faces for k in face], dtype=np.int64)
            self._put("face_start", np.cumsum(lengths) + counts["rings"])
            self._put("face_vertices", ring + counts["vertices"], "rings")
            self._put("face_normals", new.corners.normals, "faces")
            self._put("vertices", new.corners.vertices, "vertices")
        if (
            new.mesh is not None
            and new.normals is not None
            and new.cell_start is not None
            and new.cell_triangles is not None
        ):
            slot["vertex_count"], slot["face_first"] = len(new.mesh.vertices), counts["triangles"]
            slot["face_count"], slot["cell_first"] = len(new.mesh.faces), counts["cells"]
            # One entry more than cells, so that each mesh's last cell has an end.
            self._put("cell_start", new.cell_start + counts["members"], "cells")
            self._put("cell_triangles", new.cell_triangles + counts["triangles"], "members")
            self._put("triangles", new.mesh.faces + counts["vertices"], "triangles")
            self._put("triangle_normals", new.normals)
            self._put("vertices", new.mesh.vertices, "vertices")

    def shapes(self, parts: Sequence[Part]) -> Shapes:
        """Return these parts, which were made or taken here, each at the origin."""
        for arrays in self._arrays.values():
            if len(arrays) > 1:
                arrays[:] = [np.concatenate(arrays)]
        n = len(parts)
        slots = joined([p.slot for p in parts], SLOT)
        return Shapes(
            slots, np.zeros((n, 3)), np.zeros((n, 3, 3)), **{k: arrays[0] for k, arrays in self._arrays.items()}
        )

    def _put(self, name: str, rows: Array, counted: str = "") -> None:
        self._arrays[name].append(rows)
        if counted:
            self._counts[counted] += len(rows)


def shapes_of(parts: Sequence[Part]) -> Shapes:
    """Return parts that belong to no stock, each at the origin."""
    stock = Stock()
    for each in parts:
        stock.take(each)
    return stock.shapes(parts)
