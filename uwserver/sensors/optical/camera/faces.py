"""Triangles as a camera sees them: corners, smooth normals, colours, textures and patterns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.geometry.shapes import HalfSpace, Solid
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import entry
from uwserver.physics.rays.rows import facets
from uwserver.units import rad

Colour = tuple[float, float, float]
"""Red, green, blue, linear, 0..1."""

PLAIN, SEABED, GROWTH, TILES = 0, 1, 2, 3
"""Patterns: none; sand, mud and stones; growth on structures in the sea; the tiles of a pool."""

FACE = np.dtype(
    [
        ("corners", "f4", (3, 3)),  # about the centre of its scene, in the frame of the scene, m
        ("normals", "f4", (3, 3)),  # unit, outward, at the corners
        ("uv", "f4", (3, 2)),  # texture coordinates at the corners
        ("colour", "f4", (3,)),
        ("texel", "f4"),  # distance between texels, m
        ("texture", "i4"),  # number of its texture, -1 for none
        ("pattern", "i4"),
        ("sided", "i4"),  # 0: both sides are lit; 1: only the outside; CLOSED: the same, and no ray comes from inside
        ("thing", "i4"),  # row of `rays.THING`
    ]
)
"""A triangle, counter-clockwise as seen from outside."""

CLOSED = 2
"""`sided` of a face of a closed solid."""

CREASE = math.cos(rad(40.0))
"""Cosine of the angle between faces above which there is an edge between them."""


class Paint(NamedTuple):
    """The paint of a solid.

    Attributes:
        colours: colours by number of the material.
        patterns: patterns by number of the material.
    """

    colours: Sequence[Colour]
    patterns: Sequence[int] = (PLAIN,)

    def of(self, material: int) -> tuple[Colour, int]:
        """Return colour and pattern of a material by number; the last ones for a material without an entry."""
        colour = self.colours[material if 0 <= material < len(self.colours) else -1]
        return colour, self.patterns[material if 0 <= material < len(self.patterns) else -1]


class Floor(NamedTuple):
    """A half-space: a point (N, m) of its plane, the outward normal, its colour and pattern."""

    p: FloatArray
    normal: FloatArray
    colour: Colour
    pattern: int


def solid_faces(solid: Solid, paint: Paint) -> Any:
    """Return FACE (n) of a solid in its own frame, about zero, without half-spaces."""
    parts = facets(solid)
    rows = blank_faces(len(parts.corners))
    rows["corners"] = parts.corners
    rows["sided"] = np.where(parts.sided != 0, CLOSED, 0)
    for material in np.unique(parts.material):
        of = parts.material == material
        rows["colour"][of], rows["pattern"][of] = paint.of(int(material))
    rows["normals"] = smooth_normals(parts.corners)
    return cut(rows)


def cut(rows: Any) -> Any:
    """Return FACE with long, slanted triangles cut into pieces. They fill little of their bounding box, which makes ray casting slow."""
    for _ in range(_CUTS):
        corners = rows["corners"].astype(np.float64)
        edges = np.linalg.norm(corners[:, (1, 2, 0)] - corners, axis=2)
        box = np.ptp(corners, axis=1)
        around = box[:, 0] * box[:, 1] + box[:, 1] * box[:, 2] + box[:, 2] * box[:, 0]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        empty = (edges.max(axis=1) > _SHORT_M) & (around > _EMPTY * area)
        if not empty.any() or len(rows) + int(empty.sum()) > _MOST_CUT:
            break
        whole, first = rows[empty], edges[empty].argmax(axis=1)
        each, ends = np.arange(len(whole)), (first, (first + 1) % 3)
        halves = whole.copy(), whole.copy()
        for name in ("corners", "normals", "uv"):
            middle = 0.5 * (whole[name][each, ends[0]] + whole[name][each, ends[1]])
            halves[0][name][each, ends[1]], halves[1][name][each, ends[0]] = middle, middle
        rows = np.concatenate((rows[~empty], *halves))
    return rows


_SHORT_M, _EMPTY = 0.5, 10.0
_CUTS, _MOST_CUT = 12, 400_000
"""Shortest edge to cut, largest ratio of the areas of box and triangle; and limits on the number of rounds and triangles."""


def floors(solid: Solid, paint: Paint) -> list[Floor]:
    """Return the half-spaces of a solid."""
    found = []
    for placed in solid.shapes:
        if isinstance(placed.shape, HalfSpace):
            material = solid.material if placed.material < 0 else placed.material
            found.append(Floor(np.array(placed.p), -placed.R[:, 2], *paint.of(material)))
    return found


def blank_faces(count: int) -> Any:
    """Return FACE (n) without pattern and texture."""
    rows: Any = np.zeros(count, FACE)
    rows["texture"], rows["sided"] = -1, 1
    return rows


def smooth_normals(corners: FloatArray) -> FloatArray:
    """Return (n, 3, 3) unit normals at the corners of triangles (n, 3, 3): means over the faces that meet there without an edge between."""
    n = len(corners)
    if n == 0:
        return np.zeros((0, 3, 3))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0.0)
    span = max(float(np.ptp(corners.reshape(-1, 3), axis=0).max()), 1e-6)
    # Corners whose distance is within rounding are the same place.
    cells = np.round(corners.reshape(-1, 3) / (1e-6 * span)).astype(np.int64)
    order = np.lexsort(cells.T)
    fresh = np.ones(3 * n, np.bool_)
    fresh[1:] = (np.diff(cells[order], axis=0) != 0).any(axis=1)
    starts: IntArray = np.append(np.flatnonzero(fresh), 3 * n)
    out: FloatArray = np.empty((3 * n, 3))
    average_normals(unit, size[:, 0], order, starts, CREASE, out)
    return out.reshape(n, 3, 3)


_MOST_AT_POINT = 512
"""Most faces at one place that are averaged. If there are more, it is a fan around an axis."""


@entry
def average_normals(unit: Array, weight: Array, order: Array, starts: Array, crease: float, out: Array) -> None:
    """Average the normals at each place.

    Args:
        unit, weight: (n, 3) normals of triangles, and (n) twice their areas.
        order: (3 n) corners, sorted so that those of a place are neighbours; corner 3 t + k belongs to triangle t.
        starts: (m + 1) start of each place in `order`.
        crease: cosine of the angle above which there is an edge.
        out: (3 n, 3) receives the normals.
    """
    for place in range(len(starts) - 1):
        first, last = starts[place], starts[place + 1]
        for a in range(first, last):
            t = order[a] // 3
            x = y = z = 0.0
            for b in range(first, min(last, first + _MOST_AT_POINT)):
                s = order[b] // 3
                if unit[t, 0] * unit[s, 0] + unit[t, 1] * unit[s, 1] + unit[t, 2] * unit[s, 2] > crease:
                    x += weight[s] * unit[s, 0]
                    y += weight[s] * unit[s, 1]
                    z += weight[s] * unit[s, 2]
            length = math.sqrt(x * x + y * y + z * z)
            if length <= 0.0:
                x, y, z, length = unit[t, 0], unit[t, 1], unit[t, 2], 1.0
            out[order[a], 0], out[order[a], 1], out[order[a], 2] = x / length, y / length, z / length
