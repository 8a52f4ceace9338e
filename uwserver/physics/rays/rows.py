"""What rays may hit: solids as triangles, and records for the kernels of `hits`.

Round shapes become facets with their corners on the surface, so a range to one is up to 0.25 % of its radius too long.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from uwserver.physics.geometry.rows import polyhedron
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
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records

AROUND = 64
"""Number of facets around a round shape."""
PLANE = np.dtype([("point", "f8", 3), ("normal", "f8", 3), ("body", "i8"), ("material", "i8")])
"""A half-space: a point of its plane, the outward normal (N), the id of its solid, and the number of its material."""
SIDE = np.dtype([("corners", "f8", (3, 3)), ("normal", "f8", 3), ("sided", "i8"), ("material", "i8")])
"""A triangle, counter-clockwise from outside: corners, outward unit normal (zero if it has no area), whether only the outside can be hit,
material."""
CARRIED = np.dtype(
    [("body", "i8"), ("row", "i8"), ("first", "i8"), ("count", "i8"), ("centre", "f8", 3), ("radius", "f8")]
)
"""A moving solid: its id, its row in the state, its triangles, and the ball around them in its frame."""


class Facets(NamedTuple):
    """Triangles of a solid in its frame: corners (n, 3, 3), counter-clockwise from outside, and the material and sides of each.

    `sided` (n) is 1 if only the outside can be hit.
    """

    corners: FloatArray
    material: IntArray
    sided: IntArray


def facets(solid: Solid) -> Facets:
    """Return the triangles of all shapes of a solid except half-spaces."""
    corners, material, sided = [np.zeros((0, 3, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for placed in solid.shapes:
        triangles = _triangles(placed)
        n = len(triangles)
        corners.append(triangles @ placed.R.T + np.array(placed.p))
        material.append(np.full(n, solid.material if placed.material < 0 else placed.material))
        oriented = placed.shape.oriented if isinstance(placed.shape, TriangleMesh) else True
        sided.append(np.full(n, int(oriented)))
    return Facets(np.concatenate(corners), np.concatenate(material), np.concatenate(sided))


def _triangles(placed: Placed) -> FloatArray:
    shape = placed.shape
    if isinstance(shape, TriangleMesh):
        return np.asarray(shape.vertices[shape.faces], dtype=np.float64)
    if isinstance(shape, Box | ConvexHull):
        solid = polyhedron(shape)
        fans = [(face[0], face[k], face[k + 1]) for face in solid.faces for k in range(1, len(face) - 1)]
        return np.asarray(solid.vertices[np.array(fans)])
    if isinstance(shape, Cylinder):
        length = shape.half_length
        return _surface_of_revolution([(-length, 0.0), (-length, shape.radius), (length, shape.radius), (length, 0.0)])
    if isinstance(shape, Sphere | Capsule):
        length = shape.half_length if isinstance(shape, Capsule) else 0.0
        angles = np.linspace(0.0, np.pi, AROUND // 2 + 1)
        x, r = -shape.radius * np.cos(angles), shape.radius * np.sin(angles)
        r[0] = r[-1] = 0.0
        middle = AROUND // 4
        below = [(float(x[k]) - length, float(r[k])) for k in range(middle + 1)]
        above = [(float(x[k]) + length, float(r[k])) for k in range(middle, len(x))]
        return _surface_of_revolution(below + (above if length else above[1:]))
    return np.zeros((0, 3, 3))


def _surface_of_revolution(profile: list[tuple[float, float]]) -> FloatArray:
    """Return the triangles of the surface that points (x, radius), from -x to +x, sweep about axis x."""
    angles = 2.0 * np.pi * np.arange(AROUND) / AROUND
    y, z = np.cos(angles), np.sin(angles)
    rings = [np.stack([np.full(AROUND, x), r * y, r * z], axis=1) for x, r in profile]
    following = np.roll(np.arange(AROUND), -1)
    triangles: list[FloatArray] = []
    for (_, r0), (_, r1), lower, upper in zip(profile, profile[1:], rings, rings[1:], strict=False):
        if r1 > 0.0:
            triangles.append(np.stack([lower, upper[following], upper], axis=1))
        if r0 > 0.0:
            triangles.append(np.stack([lower, lower[following], upper[following]], axis=1))
    return np.concatenate(triangles)


class Simple(NamedTuple):
    """All things that are intersected one by one.

    Attributes:
        planes: (n) PLANE.
        carried: (m) CARRIED.
        sides: (k) SIDE, the triangles of all carried solids.
    """

    planes: Records
    carried: Records
    sides: Records


def planes(solids: Iterable[tuple[int, Solid]]) -> Records:
    """Return the half-spaces of static solids, by id, as PLANE (n)."""
    found = [
        (placed.p, -placed.R[:, 2], body, solid.material if placed.material < 0 else placed.material)
        for body, solid in solids
        for placed in solid.shapes
        if isinstance(placed.shape, HalfSpace)
    ]
    return np.array(found, PLANE)


def sides(parts: Facets, centre: FloatArray) -> Records:
    """Return the triangles of a solid about a point (3) of its frame, as SIDE (n)."""
    rows = np.empty(len(parts.corners), SIDE)
    corners = parts.corners - centre
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["corners"], rows["sided"], rows["material"] = corners, parts.sided, parts.material
    rows["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    return rows


def middle(parts: Facets) -> tuple[FloatArray, FloatArray]:
    """Return centre and half sizes (3) of the box around a solid's triangles."""
    low, high = parts.corners.min(axis=(0, 1)), parts.corners.max(axis=(0, 1))
    return 0.5 * (low + high), 0.5 * (high - low)
