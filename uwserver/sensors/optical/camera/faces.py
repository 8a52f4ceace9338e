"""Triangles as a camera sees them: corners, smooth normals, colours, and what is painted on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.geometry.shapes import HalfSpace, Solid
from uwserver.physics.geometry.tessellation import facets
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import entry
from uwserver.units import rad

Colour = tuple[float, float, float]
"""Red, green, blue, linear, 0..1."""

PLAIN, SEABED, GROWTH, TILES = 0, 1, 2, 3
"""Patterns: none; sand, mud and stones; growth on what stands in the sea; the tiles of a pool."""

FACE = np.dtype(
    [
        ("corners", "f4", (3, 3)),  # in the frame of its scene, about the scene's centre, m
        ("normals", "f4", (3, 3)),  # unit, outward, at the corners
        ("uv", "f4", (3, 2)),  # of its texture at the corners
        ("colour", "f4", (3,)),
        ("texel", "f4"),  # m from one texel to the next
        ("texture", "i4"),  # number, -1 for none
        ("pattern", "i4"),
        ("sided", "i4"),  # 1: only the outside is lit; CLOSED: besides, no ray comes from inside
        ("thing", "i4"),  # row of `picture.THING`
    ]
)
"""A triangle, counter-clockwise from outside."""

CLOSED = 2
"""Of a face of a solid."""

CREASE = math.cos(rad(40.0))
"""Faces that meet at a greater angle have an edge between them."""


class Paint(NamedTuple):
    """What a solid is painted with.

    Attributes:
        colours: by number of material.
        patterns: likewise.
    """

    colours: Sequence[Colour]
    patterns: Sequence[int] = (PLAIN,)

    def of(self, material: int) -> Colour:
        """Of a material by number; the last for one that has none."""
        return self.colours[material if 0 <= material < len(self.colours) else -1]

    def pattern_of(self, material: int) -> int:
        """Of a material by number; the last for one that has none."""
        return self.patterns[material if 0 <= material < len(self.patterns) else -1]


class Floor(NamedTuple):
    """A half-space: a point (N, m) of its plane, the outward normal, its colour and pattern."""

    p: FloatArray
    normal: FloatArray
    colour: Colour
    pattern: int


def solid_faces(solid: Solid, paint: Paint) -> Any:
    """FACE (n) of a solid in its own frame, about zero; half-spaces are left out."""
    parts = facets(solid)
    rows = blank_faces(len(parts.corners))
    rows["corners"] = parts.corners
    rows["sided"] = np.where(parts.sided != 0, CLOSED, 0)
    for material in np.unique(parts.material):
        of = parts.material == material
        rows["colour"][of], rows["pattern"][of] = paint.of(int(material)), paint.pattern_of(int(material))
    rows["normals"] = smooth_normals(parts.corners)
    return cut(rows)


def cut(rows: Any) -> Any:
    """FACE with those cut across that fill little of the box about them, as of pipes that lie askew: an engine of such boxes finds them slowly."""
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
"""Shorter edges are not cut; times that a box may be as large as its triangle; and where it ends."""


def floors(solid: Solid, paint: Paint) -> list[Floor]:
    """The half-spaces of a solid."""
    found = []
    for placed in solid.shapes:
        if isinstance(placed.shape, HalfSpace):
            material = solid.material if placed.material < 0 else placed.material
            found.append(Floor(np.array(placed.p), -placed.R[:, 2], paint.of(material), paint.pattern_of(material)))
    return found


def blank_faces(count: int) -> Any:
    """FACE (n) without pattern and texture."""
    rows: Any = np.zeros(count, FACE)
    rows["texture"], rows["sided"] = -1, 1
    return rows


def smooth_normals(corners: FloatArray) -> FloatArray:
    """(n, 3, 3) unit normals at the corners of triangles (n, 3, 3): means over those faces that meet there without an edge between them."""
    n = len(corners)
    if n == 0:
        return np.zeros((0, 3, 3))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0.0)
    span = max(float(np.ptp(corners.reshape(-1, 3), axis=0).max()), 1e-6)
    # Corners that lie as near as rounding are one place.
    cells = np.round(corners.reshape(-1, 3) / (1e-6 * span)).astype(np.int64)
    order = np.lexsort(cells.T)
    fresh = np.ones(3 * n, np.bool_)
    fresh[1:] = (np.diff(cells[order], axis=0) != 0).any(axis=1)
    starts: IntArray = np.append(np.flatnonzero(fresh), 3 * n)
    out: FloatArray = np.empty((3 * n, 3))
    average_normals(unit, size[:, 0], order, starts, CREASE, out)
    return out.reshape(n, 3, 3)


_MOST_AT_POINT = 512
"""Faces at one place that are averaged; more are a fan about an axis."""


@entry
def average_normals(unit: Array, weight: Array, order: Array, starts: Array, crease: float, out: Array) -> None:
    """Means of normals at each place.

    Args:
        unit, weight: (n, 3) normals of triangles, and (n) twice their areas.
        order: (3 n) corners, those of a place side by side; corner 3 t + k belongs to triangle t.
        starts: (m + 1) where each place begins.
        crease: cosine of the angle from which there is an edge.
        out: (3 n, 3) receives them.
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
