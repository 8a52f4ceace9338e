"""Contact points between two features, and the selection of the few that a solver needs (compiled).

A contact has the columns of `contacts.NUMBERS`; its key is kept in another array.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.collision.contacts import NUMBERS
from uwserver.physics.geometry.slots import RING, Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import dot

CANDIDATES = 256
"""Most points of one pair before they are reduced."""
FULL = 96
"""Number of points from which on they are thinned out, as on a mesh much finer than the body."""
KEPT = 4
"""Points kept of each group of like normals."""
SAME_DEPTH = 2e-3
"""m; points that are nearly as deep as the deepest, by this, are preferred to points farther out."""
FLAT = 1.0 - 5e-6
"""Cosine above which a direction counts as that of a face: 3 mrad, the rounding of an engine in bad cases."""
_LIKE = 0.866
"""Cosine between the normals of one group: 30 degrees."""
_CROSSING = 256
"""Codes from this on belong to crossings of edges, those below to corners."""


class Work(NamedTuple):
    """Work space for one pair.

    Attributes:
        ring, codes: corners (k, 3) of the feature that is cut, and a number for each.
        kept, kept_codes: the same for the part that remains after a cut.
        cut, cut_codes: the same for the feature that cuts.
        contacts, keys: (CANDIDATES, NUMBERS) and (CANDIDATES) found so far.
        t, face: (3) normals.
    """

    ring: Array
    codes: Array
    kept: Array
    kept_codes: Array
    cut: Array
    cut_codes: Array
    contacts: Array
    keys: Array
    t: Array
    face: Array


@compiled
def new_work() -> Work:
    """Return work space for any pair. It is made of few blocks of memory, as each takes a tenth of a microsecond."""
    rows, codes = np.empty((9 * RING + 2, 3)), np.empty(9 * RING + CANDIDATES, np.int64)
    return Work(
        rows[: 4 * RING], codes[: 4 * RING], rows[4 * RING : 8 * RING], codes[4 * RING : 8 * RING],
        rows[8 * RING : 9 * RING], codes[8 * RING : 9 * RING],
        np.empty((CANDIDATES, NUMBERS)), codes[9 * RING :], rows[9 * RING], rows[9 * RING + 1],
    )  # fmt: skip


@compiled
def cut_by_triangle(shapes: Shapes, k: int, t: Array, work: Work) -> None:
    """Make triangle k of a mesh the feature that cuts, counter-clockwise about t: its normal, or the opposite for the other side of a sheet."""
    cut, across = work.cut, work.face
    for i in range(3):
        for c in range(3):
            cut[c, i] = shapes.vertices[shapes.triangles[k, c], i]
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        across[i] = (cut[1, j] - cut[0, j]) * (cut[2, m] - cut[0, m]) - (cut[1, m] - cut[0, m]) * (
            cut[2, j] - cut[0, j]
        )
    if dot(across, t) < 0.0:  # the other side of a sheet
        for i in range(3):
            cut[1, i], cut[2, i] = cut[2, i], cut[1, i]


@compiled
def clip(work: Work, count: int, cuts: int, t: Array) -> int:
    """Clip the polygon work.ring of `count` corners by the sides of another, projected along t. Return its number of corners.

    Sutherland and Hodgman 1974. work.cut, of `cuts` corners, is counter-clockwise about t; with two corners it is a line, cut at its ends.
    """
    ring, codes, cut, kept, kept_codes = work.ring, work.codes, work.cut, work.kept, work.kept_codes
    for e in range(cuts):
        a, b = e, (e + 1) % cuts
        sx, sy, sz = cut[b, 0] - cut[a, 0], cut[b, 1] - cut[a, 1], cut[b, 2] - cut[a, 2]
        if cuts != 2:
            sx, sy, sz = t[1] * sz - t[2] * sy, t[2] * sx - t[0] * sz, t[0] * sy - t[1] * sx
        length = math.sqrt(sx * sx + sy * sy + sz * sz)
        offset = sx * cut[a, 0] + sy * cut[a, 1] + sz * cut[a, 2]
        n, j = 0, count - 1
        # A corner on the border belongs to both sides.
        before = sx * ring[j, 0] + sy * ring[j, 1] + sz * ring[j, 2] - offset + 1e-9 * length if count > 0 else 0.0
        for k in range(count):
            now = sx * ring[k, 0] + sy * ring[k, 1] + sz * ring[k, 2] - offset + 1e-9 * length
            if (now >= 0.0) != (before >= 0.0) and n < len(ring):
                part = before / (before - now)
                for i in range(3):
                    kept[n, i] = ring[j, i] + part * (ring[k, i] - ring[j, i])
                first, second = min(codes[j], codes[k]), max(codes[j], codes[k])
                kept_codes[n] = _CROSSING + (first * 65_599 + second * 257 + 7 * e) % 65_521
                n += 1
            if now >= 0.0 and n < len(ring):
                kept[n, 0], kept[n, 1], kept[n, 2], kept_codes[n] = ring[k, 0], ring[k, 1], ring[k, 2], codes[k]
                n += 1
            j, before = k, now
        count = n
        for k in range(count):
            ring[k, 0], ring[k, 1], ring[k, 2], codes[k] = kept[k, 0], kept[k, 1], kept[k, 2], kept_codes[k]
    return count


@compiled
def add_polygon(work: Work, count: int, origin: Array, t: Array, on_a: bool, code: int, reach: float, n: int) -> int:
    """Add the corners of the clipped polygon, which are over the plane through `origin` with the outward normal t, to n contacts.

    Args:
        on_a: the polygon is of a and the plane of b; otherwise the other way round.
        code: that of the feature under a crossing; the key of a corner does not depend on it.
        reach: m; farther corners are left out.

    Returns:
        The number of contacts.
    """
    ring, codes, contacts, keys = work.ring, work.codes, work.contacts, work.keys
    for k in range(count):
        gap = 0.0
        for i in range(3):
            gap += (ring[k, i] - origin[i]) * t[i]
        if gap > reach or n >= len(contacts):
            continue
        key = codes[k] + _CROSSING * _facing(t)
        if codes[k] >= _CROSSING or not on_a:
            key = (codes[k] + 16) * 2_654_435_761 + code * 40_503
        for i in range(3):
            contacts[n, i] = ring[k, i] - 0.5 * gap * t[i]
            contacts[n, 3 + i] = t[i] if on_a else -t[i]
        contacts[n, 6] = gap
        keys[n] = key % (1 << 34)
        n += 1
    return n


@compiled
def _facing(t: Array) -> int:
    """Return the axis along which t mainly points, and its sense, as 0 to 5. So a corner on floor and wall has two keys."""
    axis = 0
    for i in range(1, 3):
        if abs(t[i]) > abs(t[axis]):
            axis = i
    return 2 * axis + (1 if t[axis] < 0.0 else 0)


@compiled
def add_point(work: Work, x: Array, normal: Array, top_b: float, gap: float, key: int, n: int) -> int:
    """Add one contact to n others: at x, moved along the normal to midway between the surfaces. The surface of b is at x . normal = top_b."""
    contacts, keys = work.contacts, work.keys
    if n >= len(contacts):
        return n
    lift = top_b + 0.5 * gap - dot(x, normal)
    for i in range(3):
        contacts[n, i], contacts[n, 3 + i] = x[i] + lift * normal[i], normal[i]
    contacts[n, 6] = gap
    keys[n] = key % (1 << 34)
    return n + 1


@compiled
def reduce(contacts: Array, keys: Array, n: int, chosen: Array) -> int:
    """Choose at most `KEPT` contacts of each group of like normals; write their numbers to `chosen`, in order. Return their number.

    A group begins with the deepest contact that is in no group yet. The deepest is chosen first, then the ones that are most spread out. Contacts
    that are almost as deep come before all others, so that a body rests on the points that it touches.
    """
    free = np.ones(n, np.bool_)
    for k in range(n):
        for j in range(k):
            if free[j] and free[k] and _duplicates(contacts[j], contacts[k], keys[j] == keys[k]):
                free[j if _before(contacts, keys, k, j) else k] = False
    total = 0
    while True:
        deepest = -1
        for k in range(n):
            if free[k] and (deepest < 0 or _before(contacts, keys, k, deepest)):
                deepest = k
        if deepest < 0 or total + KEPT > len(chosen):
            return total
        picked = total
        chosen[total] = deepest
        free[deepest] = False
        total += 1
        for limit in (SAME_DEPTH, 1e300):
            while total - picked < KEPT:
                best = _most_spread(contacts, n, free, chosen[picked:total], limit)
                if best < 0:
                    break
                chosen[total] = best
                free[best] = False
                total += 1
        for k in range(n):
            if free[k] and dot(contacts[k, 3:6], contacts[deepest, 3:6]) > _LIKE:
                free[k] = False


@compiled
def _duplicates(a: Array, b: Array, same_feature: bool) -> bool:
    """Return whether two contacts are the same: at one place or of one feature, and with like normals."""
    if dot(a[3:6], b[3:6]) <= _LIKE:
        return False
    return same_feature or (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2 < 1e-12


@compiled
def thin_out(work: Work, n: int) -> int:
    """Move those of the n contacts that `reduce` would choose to the front. Return their number."""
    contacts, keys = work.contacts, work.keys
    chosen = np.empty(8 * KEPT, np.int64)
    count = reduce(contacts, keys, n, chosen)
    kept, kept_keys = contacts[chosen[:count]], keys[chosen[:count]]
    contacts[:count], keys[:count] = kept, kept_keys
    return count


@compiled
def _before(contacts: Array, keys: Array, k: int, other: int) -> bool:
    """Return whether a contact is deeper, or as deep with a lower key. Depths are compared to a nanometre, so that rounding does not decide."""
    a, b = contacts[k, 6], contacts[other, 6]
    return bool(a < b - 1e-9 or (a <= b + 1e-9 and keys[k] < keys[other]))


@compiled
def _most_spread(contacts: Array, n: int, free: Array, picked: Array, limit: float) -> int:
    """Return the free contact of the group that is farthest from the chosen ones and the lines between them; -1 if none is more than 1 mm away."""
    first = contacts[picked[0]]
    best, most = -1, 1e-3
    for k in range(n):
        if not free[k] or contacts[k, 6] > first[6] + limit or dot(contacts[k, 3:6], first[3:6]) <= _LIKE:
            continue
        spread = 1e300
        for j in range(len(picked)):
            for i in range(j if len(picked) > 1 else j + 1):
                spread = min(spread, _off_segment(contacts[picked[i]], contacts[picked[j]], contacts[k]))
        if spread > most * (1.0 + 1e-9):
            best, most = k, spread
    return best


@compiled
def _off_segment(a: Array, b: Array, x: Array) -> float:
    """Return the distance of x from the segment from a to b; the points are in the first three columns."""
    along = square = 0.0
    for i in range(3):
        along += (x[i] - a[i]) * (b[i] - a[i])
        square += (b[i] - a[i]) ** 2
    part = min(max(along / max(square, 1e-30), 0.0), 1.0)
    distance = 0.0
    for i in range(3):
        distance += (x[i] - a[i] - part * (b[i] - a[i])) ** 2
    return math.sqrt(distance)
