"""A tree of boxes around triangles (compiled, float64): for sensors that are read in compiled code, and as a picker if Embree is not installed.

It is a perfect binary tree in one array, like a heap: the children of box k are 2 k + 1 and 2 k + 2. Each box is divided at the median of its
triangles' centres along its longest side, until few triangles are left in each.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.layout import Forms, columns

_LEAF = 4
"""Most triangles of a leaf."""
DEEPEST = 64
"""Most boxes that wait on the stack while a ray is followed."""
_ROUNDING = 1e-15


class Tree(NamedTuple):
    """Triangles in a tree.

    Attributes:
        corners: (t, 3, 3) of the triangles.
        sided: (t) 1: only the outside, from which the corners are counter-clockwise, is hit.
        boxes: (2 m - 1, 2, 3) low and high corners.
        first: (m + 1) where each leaf's triangles begin in `order`.
        order: (t) numbers of the triangles.
    """

    corners: Array
    sided: Array
    boxes: Array
    first: Array
    order: Array


TREE: Forms = {
    "corners": columns(np.float64, 3, 3),
    "sided": columns(np.int64),
    "boxes": columns(np.float64, 2, 3),
    "first": columns(np.int64),
    "order": columns(np.int64),
}
"""The table of the arrays of a tree."""


def grow(corners: FloatArray, sided: IntArray | None = None) -> Tree:
    """Return the tree of triangles (t, 3, 3). Each is hit from either side unless it is `sided` (t)."""
    n = len(corners)
    depth = max(math.ceil(math.log2(max(n, 1) / _LEAF)), 0)
    sided = np.zeros(n, np.int64) if sided is None else np.ascontiguousarray(sided, np.int64)
    tree = Tree(
        np.ascontiguousarray(corners, np.float64), sided, np.empty((2 ** (depth + 1) - 1, 2, 3)), np.zeros(2**depth + 1, np.int64), np.arange(n),
    )  # fmt: skip
    build(tree.corners, tree.boxes, tree.first, tree.order)
    return tree


class TreePicker:
    """The tree as a `surfaces.Picker`."""

    def __init__(self, corners: FloatArray) -> None:
        self._tree = grow(corners)

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """Implement `surfaces.Picker.pick`."""
        n = len(origin)
        picked: IntArray = np.empty(n, np.int32)
        limits = np.full(n, np.inf) if limit is None else np.ascontiguousarray(limit, np.float64)
        start, towards = np.ascontiguousarray(origin, np.float64), np.ascontiguousarray(direction, np.float64)
        pick_nearest(*self._tree, start, towards, limits, picked)
        return picked


@entry
def build(corners: Array, boxes: Array, first: Array, order: Array) -> None:
    """Fill a tree.

    Args:
        corners: (t, 3, 3) of the triangles.
        boxes: (2 m - 1, 2, 3) receives low and high corners.
        first: (m + 1) receives where each leaf's triangles begin in `order`.
        order: (t) numbers of the triangles, in any order; they are sorted by leaf.
    """
    leaves = len(first) - 1
    begin, end = np.zeros(len(boxes), np.int64), np.zeros(len(boxes), np.int64)
    end[0] = len(order)
    for k in range(len(boxes)):
        for i in range(3):
            boxes[k, 0, i], boxes[k, 1, i] = math.inf, -math.inf
        for m in range(begin[k], end[k]):
            for c in range(3):
                for i in range(3):
                    x = corners[order[m], c, i]
                    boxes[k, 0, i], boxes[k, 1, i] = min(boxes[k, 0, i], x), max(boxes[k, 1, i], x)
        if k >= leaves - 1:
            first[k - leaves + 1], first[k - leaves + 2] = begin[k], end[k]
            continue
        axis = 0
        for i in range(1, 3):
            if boxes[k, 1, i] - boxes[k, 0, i] > boxes[k, 1, axis] - boxes[k, 0, axis]:
                axis = i
        members = order[begin[k] : end[k]].copy()
        middles = np.empty(len(members))
        for m in range(len(members)):
            t = members[m]
            middles[m] = corners[t, 0, axis] + corners[t, 1, axis] + corners[t, 2, axis]
        order[begin[k] : end[k]] = members[np.argsort(middles, kind="mergesort")]
        middle = (begin[k] + end[k]) // 2
        begin[2 * k + 1], end[2 * k + 1], begin[2 * k + 2], end[2 * k + 2] = begin[k], middle, middle, end[k]


@compiled
def _entered(box: Array, o: Array, ix: float, iy: float, iz: float, limit: float) -> float:
    """Return the distance along a ray at which it enters a box, from the inverses of its direction; inf if it misses the box or enters beyond the
    limit (the slab test)."""
    ax, bx = (box[0, 0] - o[0]) * ix, (box[1, 0] - o[0]) * ix
    ay, by = (box[0, 1] - o[1]) * iy, (box[1, 1] - o[1]) * iy
    az, bz = (box[0, 2] - o[2]) * iz, (box[1, 2] - o[2]) * iz
    near = max(0.0, min(ax, bx), min(ay, by), min(az, bz))
    far = min(limit, max(ax, bx), max(ay, by), max(az, bz))
    # The margin is for rounding: the box of a level seabed has no thickness.
    return near if near <= far * (1.0 + 1e-12) + 1e-12 else math.inf


@compiled
def _side(corners: Array, t: int, j: int, k: int, o: Array, d: Array) -> float:
    """Return on which side of edge j k of a triangle a ray passes. For two triangles that share an edge, the values are exactly the negatives of
    each other."""
    ax, ay, az = corners[t, j, 0] - o[0], corners[t, j, 1] - o[1], corners[t, j, 2] - o[2]
    bx, by, bz = corners[t, k, 0] - o[0], corners[t, k, 1] - o[1], corners[t, k, 2] - o[2]
    return float(d[0] * (ay * bz - az * by) + d[1] * (az * bx - ax * bz) + d[2] * (ax * by - ay * bx))


@compiled
def _reached(corners: Array, sided: int, t: int, o: Array, d: Array) -> float:
    """Return the distance along a ray at which it meets a triangle, from either side or from the outside alone; inf if it misses it. No ray slips
    through a common edge."""
    u, v, w = _side(corners, t, 1, 2, o, d), _side(corners, t, 2, 0, o, d), _side(corners, t, 0, 1, o, d)
    total, farthest = u + v + w, 0.0
    if sided != 0 and total > 0.0:
        return math.inf
    for c in range(3):
        far = 0.0
        for i in range(3):
            far += (corners[t, c, i] - o[i]) ** 2
        farthest = max(farthest, far)
    # For a ray through a corner all sides may be wrong by rounding.
    slack = _ROUNDING * farthest
    if total == 0.0 or (min(u, v, w) < -slack and max(u, v, w) > slack):
        return math.inf
    along = square = 0.0
    for i in range(3):
        along += d[i] * (u * (corners[t, 0, i] - o[i]) + v * (corners[t, 1, i] - o[i]) + w * (corners[t, 2, i] - o[i]))
        square += d[i] * d[i]
    reached = along / (total * square)
    return reached if reached >= 0.0 else math.inf


@compiled
def nearest_of(tree: Tree, o: Array, d: Array, limit: float, todo: Array, entry_at: Array) -> int:
    """Return the number of the triangle that a ray meets first.

    Args:
        tree: tree of all triangles.
        o, d: (3) where the ray starts, and its direction.
        limit: m; farther triangles are not looked for.
        todo, entry_at: (`DEEPEST`) work space: boxes that wait, and where the ray enters them.

    Returns:
        -1 for none.
    """
    ix, iy, iz = (
        (1.0 / d[0] if d[0] != 0.0 else 1e300),
        (1.0 / d[1] if d[1] != 0.0 else 1e300),
        (1.0 / d[2] if d[2] != 0.0 else 1e300),
    )
    boxes, first, order = tree.boxes, tree.first, tree.order
    inner = len(first) - 2  # boxes that are not leaves
    nearest, best, size = limit, -1, 1
    todo[0], entry_at[0] = 0, _entered(boxes[0], o, ix, iy, iz, nearest)
    while size > 0:
        size -= 1
        box = todo[size]
        if entry_at[size] > nearest or entry_at[size] == math.inf:
            continue
        if box >= inner:
            leaf = box - inner
            for m in range(first[leaf], first[leaf + 1]):
                reached = _reached(tree.corners, tree.sided[order[m]], order[m], o, d)
                if reached < nearest or (reached == nearest and reached < math.inf and best < 0):
                    nearest, best = reached, order[m]
            continue
        left, right = 2 * box + 1, 2 * box + 2
        a, b = _entered(boxes[left], o, ix, iy, iz, nearest), _entered(boxes[right], o, ix, iy, iz, nearest)
        if a < b:  # the nearer one comes off the stack first
            left, right, a, b = right, left, b, a
        todo[size], entry_at[size], todo[size + 1], entry_at[size + 1] = left, a, right, b
        size += 2
    return best


@entry
def pick_nearest(
    corners: Array, sided: Array, boxes: Array, first: Array, order: Array, origin: Array, direction: Array, limit: Array, picked: Array
) -> None:  # fmt: skip
    """Find the triangle that each ray meets first.

    Args:
        corners, sided, boxes, first, order: those of a `Tree`.
        origin, direction: (n, 3) of the rays.
        limit: (n) m; farther triangles are not looked for.
        picked: (n) receives their numbers, -1 for none.
    """
    tree = Tree(corners, sided, boxes, first, order)
    todo, entry_at = np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    for k in range(len(origin)):
        picked[k] = nearest_of(tree, origin[k], direction[k], limit[k], todo, entry_at)
