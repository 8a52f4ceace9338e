"""A tree of boxes as a picker of triangles, for machines without Embree (compiled, float64).

A perfect binary tree in one array, as of a heap: the children of box k are 2 k + 1 and 2 k + 2. Each box is halved at the median of its
triangles' middles along its longest side, until few are left in one.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.compiled import compiled, entry

_LEAF = 4
"""Most triangles of a leaf."""
_DEEPEST = 64
_ROUNDING = 1e-15


class TreePicker:
    """A `casting.Picker`."""

    def __init__(self, corners: FloatArray) -> None:
        n = len(corners)
        depth = max(math.ceil(math.log2(max(n, 1) / _LEAF)), 0)
        self._corners = np.ascontiguousarray(corners, np.float64)
        self._boxes = np.empty((2 ** (depth + 1) - 1, 2, 3))
        self._first, self._order = np.zeros(2**depth + 1, np.int64), np.arange(n)
        build(self._corners, self._boxes, self._first, self._order)

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """As `casting.Picker`."""
        n = len(origin)
        picked: IntArray = np.empty(n, np.int32)
        limits = np.full(n, np.inf) if limit is None else np.ascontiguousarray(limit, np.float64)
        start, towards = np.ascontiguousarray(origin, np.float64), np.ascontiguousarray(direction, np.float64)
        pick_nearest(self._corners, self._boxes, self._first, self._order, start, towards, limits, picked)
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
def _entered(box: Array, o: Array, inverse: Array, limit: float) -> float:
    """How far along a ray it enters a box; inf if it misses it or enters behind the limit (the slab test)."""
    near, far = 0.0, limit
    for i in range(3):
        a, b = (box[0, i] - o[i]) * inverse[i], (box[1, i] - o[i]) * inverse[i]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    # A flat box, as of a level seabed, is as thick as rounding.
    return near if near <= far * (1.0 + 1e-12) + 1e-12 else math.inf


@compiled
def _side(corners: Array, t: int, j: int, k: int, o: Array, d: Array) -> float:
    """On which side of edge j k of a triangle a ray passes. Of two triangles that share an edge one has exactly the negative of the other."""
    ax, ay, az = corners[t, j, 0] - o[0], corners[t, j, 1] - o[1], corners[t, j, 2] - o[2]
    bx, by, bz = corners[t, k, 0] - o[0], corners[t, k, 1] - o[1], corners[t, k, 2] - o[2]
    return float(d[0] * (ay * bz - az * by) + d[1] * (az * bx - ax * bz) + d[2] * (ax * by - ay * bx))


@compiled
def _reached(corners: Array, t: int, o: Array, d: Array) -> float:
    """How far along a ray it meets a triangle, from either side; inf if it misses it. No ray slips through where two meet."""
    u, v, w = _side(corners, t, 1, 2, o, d), _side(corners, t, 2, 0, o, d), _side(corners, t, 0, 1, o, d)
    total, farthest = u + v + w, 0.0
    for c in range(3):
        far = 0.0
        for i in range(3):
            far += (corners[t, c, i] - o[i]) ** 2
        farthest = max(farthest, far)
    # Through a corner all sides may be off by rounding.
    slack = _ROUNDING * farthest
    if total == 0.0 or (min(u, v, w) < -slack and max(u, v, w) > slack):
        return math.inf
    along = square = 0.0
    for i in range(3):
        along += d[i] * (u * (corners[t, 0, i] - o[i]) + v * (corners[t, 1, i] - o[i]) + w * (corners[t, 2, i] - o[i]))
        square += d[i] * d[i]
    reached = along / (total * square)
    return reached if reached >= 0.0 else math.inf


@entry
def pick_nearest(
    corners: Array, boxes: Array, first: Array, order: Array, origin: Array, direction: Array, limit: Array, picked: Array
) -> None:  # fmt: skip
    """The triangle that each ray meets first.

    Args:
        corners, boxes, first, order: of a tree, as `build` fills it.
        origin, direction: (n, 3) of the rays.
        limit: (n) m; farther triangles are not met.
        picked: (n) receives their numbers, -1 for none.
    """
    inverse, todo, entry_at = np.empty(3), np.empty(_DEEPEST, np.int64), np.empty(_DEEPEST)
    inner = len(first) - 2  # boxes that are not leaves
    for k in range(len(origin)):
        o, d, nearest, best = origin[k], direction[k], limit[k], -1
        for i in range(3):
            inverse[i] = 1.0 / d[i] if d[i] != 0.0 else 1e300
        size = 1
        todo[0], entry_at[0] = 0, _entered(boxes[0], o, inverse, nearest)
        while size > 0:
            size -= 1
            box = todo[size]
            if entry_at[size] > nearest or entry_at[size] == math.inf:
                continue
            if box >= inner:
                leaf = box - inner
                for m in range(first[leaf], first[leaf + 1]):
                    reached = _reached(corners, order[m], o, d)
                    if reached < nearest or (reached == nearest and reached < math.inf and best < 0):
                        nearest, best = reached, order[m]
                continue
            left, right = 2 * box + 1, 2 * box + 2
            a, b = _entered(boxes[left], o, inverse, nearest), _entered(boxes[right], o, inverse, nearest)
            if a < b:  # the nearer one comes off the stack first
                left, right, a, b = right, left, b, a
            todo[size], entry_at[size], todo[size + 1], entry_at[size + 1] = left, a, right, b
            size += 2
        picked[k] = best
