"""What rays may hit, as records for the kernels of `hits`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from uwserver.physics.geometry.shapes import HalfSpace, Solid
from uwserver.physics.geometry.tessellation import Facets
from uwserver.physics.kernel.arrays import FloatArray, Records

PLANE = np.dtype([("point", "f8", 3), ("normal", "f8", 3), ("body", "i8"), ("material", "i8")])
"""A half-space: a point of its plane, the outward normal (N), the id of its solid and the number of its material."""

SIDE = np.dtype([("corners", "f8", (3, 3)), ("normal", "f8", 3), ("sided", "i8"), ("material", "i8")])
"""A triangle, counter-clockwise from outside: corners, outward unit normal (zero without an area), whether only the outside can be hit."""

CARRIED = np.dtype(
    [("body", "i8"), ("row", "i8"), ("first", "i8"), ("count", "i8"), ("centre", "f8", 3), ("radius", "f8")]
)
"""A solid that moves: its id, its row in the state, its triangles, and the ball around them in its frame."""


class Simple(NamedTuple):
    """All that is intersected one by one.

    Attributes:
        planes: (n) PLANE.
        carried: (m) CARRIED.
        sides: (k) SIDE, of all carried.
    """

    planes: Records
    carried: Records
    sides: Records


def planes(solids: Iterable[tuple[int, Solid]]) -> Records:
    """The half-spaces of static solids, by id, as PLANE (n)."""
    found = [
        (placed.p, -placed.R[:, 2], body, solid.material if placed.material < 0 else placed.material)
        for body, solid in solids
        for placed in solid.shapes
        if isinstance(placed.shape, HalfSpace)
    ]
    return np.array(found, PLANE)


def sides(parts: Facets, centre: FloatArray) -> Records:
    """The triangles of a solid about a point (3) of its frame, as SIDE (n)."""
    rows = np.empty(len(parts.corners), SIDE)
    corners = parts.corners - centre
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["corners"], rows["sided"], rows["material"] = corners, parts.sided, parts.material
    rows["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    return rows


def middle(parts: Facets) -> tuple[FloatArray, FloatArray]:
    """Centre and half sizes (3) of the box around a solid's triangles."""
    low, high = parts.corners.min(axis=(0, 1)), parts.corners.max(axis=(0, 1))
    return 0.5 * (low + high), 0.5 * (high - low)
