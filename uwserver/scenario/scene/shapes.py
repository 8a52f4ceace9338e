"""Shapes of the physics as viewers get them. Meshes go by the hash of their bytes, so that no viewer loads one twice."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Sequence

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import MeshView, ShapeView
from uwserver.scenario.solids.appearance import Colour, colour_of
from uwserver.scenario.vehicle.tables import BoxShape, VehicleFile

_MANY = 20_000
"""A mesh with more triangles also has a coarse form."""
_CELLS = 32
"""Number of cells of a coarse mesh along its longest edge."""
_FINENESS = 3.0
"""Length over diameter of the capsule that stands for a vehicle without shapes."""


class Meshes:
    """Meshes by the hash of their triangles.

    Attributes:
        data: numbers of vertices and triangles (u32), then vertices (f32), then triangles (u32), little endian.
        views: the view of each mesh in a scene.
    """

    def __init__(self) -> None:
        self.data: dict[str, bytes] = {}
        self.views: dict[str, MeshView] = {}
        self._known: dict[int, tuple[object, str]] = {}

    def add(self, shape: TriangleMesh | ConvexHull) -> str:
        """Keep the triangles of a shape, and return their hash."""
        known = self._known.get(id(shape))
        if known is not None:
            return known[1]
        if isinstance(shape, TriangleMesh):
            vertices, faces = shape.vertices, shape.faces
        else:
            vertices, faces = _hull(shape.points)
        name = self._keep(vertices, faces)
        coarse = self._keep(*coarsened(vertices, faces)) if len(faces) > _MANY else None
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        self.views[name] = MeshView(len(faces), tuple(low), tuple(high), coarse)
        self._known[id(shape)] = (shape, name)  # keeping the shape keeps its id from being used again
        return name

    def _keep(self, vertices: FloatArray, faces: IntArray) -> str:
        data = packed(vertices, faces)
        name = hashlib.sha256(data).hexdigest()
        self.data[name] = data
        return name


def coarsened(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Return a mesh with far fewer triangles (Rossignac and Borrel, Multi-resolution 3D approximations, 1993).

    All vertices in one cell of a lattice become one vertex at their mean. Triangles with fewer than three different vertices are dropped.

    Args:
        vertices, faces: (n, 3) m, and (m, 3) numbers of vertices.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    cell = max(float((high - low).max()) / _CELLS, 1e-9)
    x, y, z = ((vertices - low) / cell).astype(np.int64).T
    _, vertex, count = np.unique(x + (_CELLS + 1) * (y + (_CELLS + 1) * z), return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(vertex, vertices[:, k]) / count for k in range(3)], axis=1)
    moved = vertex[faces]
    a, b, c = moved.T
    moved = moved[(a != b) & (b != c) & (c != a)]
    _, kept = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    return means, moved[kept]


def packed(vertices: FloatArray, faces: IntArray) -> bytes:
    """Return a mesh as bytes, see `Meshes.data`."""
    head = struct.pack("<II", len(vertices), len(faces))
    return head + vertices.astype("<f4").tobytes() + faces.astype("<u4").tobytes()


def _hull(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the triangles of a convex hull, counter-clockwise as seen from outside."""
    from scipy.spatial import ConvexHull as Quickhull

    hull = Quickhull(points)
    faces: IntArray = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def shape_views(solid: Solid, materials: Sequence[str], otherwise: Colour, meshes: Meshes) -> tuple[ShapeView, ...]:
    """Return all shapes of a solid.

    Args:
        solid: the solid, in N or B.
        materials: names of materials, by number.
        otherwise: colour of materials that have none.
        meshes: receives the triangles.
    """
    return tuple(_view(placed, solid.material, materials, otherwise, meshes) for placed in solid.shapes)


def _view(placed: Placed, whole: int, materials: Sequence[str], otherwise: Colour, meshes: Meshes) -> ShapeView:
    number = whole if placed.material < 0 else placed.material
    material = materials[number] if 0 <= number < len(materials) else "default"
    colour, shape, p, q = colour_of(material, otherwise), placed.shape, placed.p, placed.q
    if isinstance(shape, Box):
        x, y, z = shape.half
        return ShapeView("box", p, q, size=(2.0 * x, 2.0 * y, 2.0 * z), material=material, colour=colour)
    if isinstance(shape, Sphere):
        return ShapeView("sphere", p, q, radius=shape.radius, material=material, colour=colour)
    if isinstance(shape, Cylinder | Capsule):
        kind = "cylinder" if isinstance(shape, Cylinder) else "capsule"
        length = 2.0 * shape.half_length
        return ShapeView(kind, p, q, radius=shape.radius, length=length, material=material, colour=colour)  # type: ignore[arg-type]  # two kinds
    if isinstance(shape, HalfSpace):
        return ShapeView("plane", p, q, material=material, colour=colour)
    return ShapeView("mesh", p, q, mesh=meshes.add(shape), material=material, colour=colour)


def displaced_shapes(file: VehicleFile, colour: Colour) -> tuple[ShapeView, ...]:
    """Return the shapes of a vehicle without collision shapes: those of its displaced volume, or a capsule of this volume."""
    shapes: list[ShapeView] = []
    for name, table in file.buoyancy.shapes.items():
        p = table.center_frd_m
        if isinstance(table, BoxShape):
            shapes.append(ShapeView("box", p, size=table.size_m, colour=colour, name=name))
        else:
            shapes.append(ShapeView("sphere", p, radius=table.radius_m, colour=colour, name=name))
    if shapes:
        return tuple(shapes)
    volume = max(file.buoyancy.volume_m3, 1e-3)
    # pi r^2 l + 4/3 pi r^3 with l = (fineness - 1) 2 r
    radius = (volume / (math.pi * (2.0 * (_FINENESS - 1.0) + 4.0 / 3.0))) ** (1.0 / 3.0)
    length = 2.0 * radius * (_FINENESS - 1.0)
    return (ShapeView("capsule", file.buoyancy.center_frd_m, radius=radius, length=length, colour=colour),)


def unit(v: Vec3) -> Vec3:
    """Return a vector scaled to length 1; a vector without length stays."""
    length = math.hypot(*v)
    return v if length == 0.0 else (v[0] / length, v[1] / length, v[2] / length)
