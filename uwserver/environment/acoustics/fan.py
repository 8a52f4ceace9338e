"""A fan of rays through a whole profile, computed once, with their horizontal distances from node to node. So the distance of a ray between two
depths is a difference.

The rays of the fan are those that just turn at a node, with others between and above them. A ray is identified by its turning speed 1 / p. For two
ends in the sea, `angles` chooses rays that bound what the rays between them do, and `ways` returns their distances.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.environment.acoustics.layers import ENDLESS_M, Medium, slowness
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry, inlined

WIDEST = 0.02
"""Largest angle between neighbouring rays that turn, rad."""
_STEEP = 0.1
"""Angle between neighbouring rays that pass all nodes, rad."""
_RATIO = 0.5 * WIDEST * WIDEST
"""Largest difference of the logarithms of neighbouring turning speeds: it corresponds to an angle of `WIDEST` near the turning point."""
MOST_NODES = 1024
"""Most nodes of a profile for which the tables of the fan are kept (16 MB); for finer profiles distances are computed when needed."""
_FAR_M = 1e7
"""Limit for the distance in one layer, in which a ray along a layer of constant speed would never leave it; larger than any sea, and small enough
that sums are exact to 1e-9 m."""
_STRAIGHT_DOWN = 1e30
"""Turning speed of a vertical ray, m/s."""


class Fan(NamedTuple):
    """Rays (r) and nodes (n) of a profile.

    Attributes:
        turning: (r) sound speed at which each ray turns, m/s, ascending.
        row: (n) the ray that just turns at a node.
        way: (r, n) horizontal distance from the first node to each node, m, without layers that the ray does not pass; empty for a fine profile.
        delay: (r, n) travel time over that distance less distance times slowness 1 / turning, s.
    """

    turning: Array
    row: Array
    way: Array
    delay: Array


@inlined
def sine(turning: float, c: float) -> float:
    """Return the sine of the grazing angle of a ray where the sound speed is c; exactly 0 where it turns, and beyond."""
    p = 1.0 / turning
    return math.sqrt(max((turning - c) * p * (1.0 + c * p), 0.0))


@inlined
def _layer(
    turning: float, c0: float, c1: float, thick: float, k: float, near: float, far: float
) -> tuple[float, float]:
    """Return the horizontal distance of a ray through a layer, m, and its delay there, s; k = (c0 + c1) thick."""
    if near + far <= 0.0:
        return ENDLESS_M, 0.0
    p = 1.0 / turning
    x = min(p * k / (near + far), ENDLESS_M)
    return x, thick * slowness(p, c0, c1, near, far) - p * x


@entry
def make_fan(depth: Array, speed: Array) -> tuple[Array, Array, Array, Array]:
    """Return the fan of a profile: depths (n, m, ascending) and sound speeds (n, m/s)."""
    n, nodes, steps = len(depth), np.unique(speed), math.ceil(0.5 * math.pi / _STEEP)
    turning = np.empty(len(nodes) + steps + int(math.log(nodes[-1] / nodes[0]) / _RATIO))
    size = 0
    for i in range(len(nodes)):
        parts = int(math.log(nodes[i] / nodes[i - 1]) / _RATIO) + 1 if i else 1
        for k in range(1, parts):
            turning[size] = nodes[i - 1] * (nodes[i] / nodes[i - 1]) ** (k / parts)
            size += 1
        turning[size] = nodes[i]
        size += 1
    for i in range(1, steps):
        turning[size] = nodes[-1] / math.cos(0.5 * math.pi * i / steps)
        size += 1
    turning[size] = _STRAIGHT_DOWN
    turning = turning[: size + 1]
    row = np.searchsorted(turning, speed)
    kept = (len(turning), n) if n <= MOST_NODES else (0, 0)
    way, delay = np.zeros(kept), np.zeros(kept)
    for r in range(len(way)):
        near = sine(turning[r], speed[0])
        for i in range(1, n):
            c0, c1, thick, far = speed[i - 1], speed[i], depth[i] - depth[i - 1], sine(turning[r], speed[i])
            x, late = 0.0, 0.0
            if max(c0, c1) <= turning[r]:
                x, late = _layer(turning[r], c0, c1, thick, (c0 + c1) * thick, near, far)
            way[r, i] = way[r, i - 1] + min(x, _FAR_M)
            delay[r, i] = delay[r, i - 1] + late
            near = far
    return turning, row, way, delay


class Nodes(NamedTuple):
    """Relation between the nodes of a medium (n) and those of its profile.

    Attributes:
        own: number of each node in the profile; -1 if it is not a node of the profile.
        next, last: the first node at or below each that is in the profile, and the last one at or above; n and -1 if there is none.
    """

    own: Array
    next: Array
    last: Array


@compiled
def find_nodes(m: Medium, depth: Array, speed: Array) -> Nodes:
    """Find the nodes of a profile in the medium that was made from it."""
    n, j = len(m.z), 0
    own, after, before = np.full(n, -1), np.empty(n, np.int64), np.empty(n, np.int64)
    for node in range(n):
        while j < len(depth) - 1 and depth[j] < m.z[node]:
            j += 1
        if depth[j] == m.z[node] and speed[j] == m.c[node]:
            own[node] = j
        before[node] = node if own[node] >= 0 else (before[node - 1] if node else -1)
    for node in range(n - 1, -1, -1):
        after[node] = node if own[node] >= 0 else (after[node + 1] if node < n - 1 else n)
    return Nodes(own, after, before)


@inlined
def _direct(z: Array, c: Array, k: Array, turning: float, begin: int, end: int, late: bool) -> float:
    """Return the distance of a ray between two nodes (m), `begin` above `end`, or with `late` its delay (s), summed over the layers."""
    total, near = 0.0, sine(turning, c[begin])
    for node in range(begin + 1, end + 1):
        far = sine(turning, c[node])
        if late:
            total += _layer(turning, c[node - 1], c[node], z[node] - z[node - 1], k[node - 1], near, far)[1]
        elif near + far > 0.0:
            total += min(k[node - 1] / (turning * (near + far)), ENDLESS_M)
        else:
            total += ENDLESS_M
        near = far
    return total


class Angles(NamedTuple):
    """Rays (n) that bound the intervals of a search, the flattest first.

    Attributes:
        turning: sound speed at which each turns, m/s.
        row: number in the fan; -1 if the ray is not in the fan.
        vertex: (n, 2) nodes above and below that slightly steeper rays do not pass; -1 if they reach surface or bottom.
        to_surface, to_bottom: the first ray from which on all steeper rays reach the surface, and the bottom.
    """

    turning: Array
    row: Array
    vertex: Array
    to_surface: int
    to_bottom: int


@compiled
def _critical(m: Medium, begin: int, end: int, out: Array) -> int:
    """Write the nodes of one side that are faster than all nodes before them into `out`; return their number."""
    count, fastest, step = 0, m.fastest, (1 if end > begin else -1)
    node = begin
    while node != end:
        node += step
        if m.c[node] > fastest:
            fastest = m.c[node]
            out[count] = node
            count += 1
    return count


@inlined
def angle_of(fastest: float, turning: float) -> float:
    """Return the grazing angle, where the sound speed is `fastest`, of a ray that turns at `turning`, rad."""
    return math.atan2(math.sqrt((turning - fastest) * (turning + fastest)), fastest)


@compiled
def angles(m: Medium, fan: Fan, nodes: Nodes) -> Angles:
    """Return the rays for the two ends of a medium: those that just turn at its nodes, with rays of the fan where these are far apart."""
    n = len(m.c)
    above, below = np.empty(n, np.int64), np.empty(n, np.int64)
    highs, lows = _critical(m, m.upper, 0, above), _critical(m, m.lower, n - 1, below)
    room = highs + lows + len(fan.turning) + 1
    turning, row, passed = np.empty(room), np.full(room, -1), np.full((room, 2), -1)
    turning[0], size, i, j = m.fastest, 1, 0, 0
    for node in range(m.upper, m.lower + 1):
        if m.c[node] == m.fastest and nodes.own[node] >= 0:
            row[0] = fan.row[nodes.own[node]]
    while i < highs or j < lows:
        up = m.c[above[i]] if i < highs else math.inf
        down = m.c[below[j]] if j < lows else math.inf
        c, node = min(up, down), above[i] if up <= down else below[j]
        size = _fill_gap(m.fastest, fan.turning, turning, row, size, c)
        turning[size] = c
        if nodes.own[node] >= 0:
            row[size] = fan.row[nodes.own[node]]
        if up == c:
            passed[size, 0] = above[i]
            i += 1
        if down == c:
            passed[size, 1] = below[j]
            j += 1
        size += 1
    size = _fill_gap(m.fastest, fan.turning, turning, row, size, _STRAIGHT_DOWN)
    turning[size], row[size] = _STRAIGHT_DOWN, len(fan.turning) - 1
    size += 1
    vertex = np.full((size, 2), -1)
    to_surface, to_bottom = 0, 0
    for k in range(size - 2, -1, -1):
        for side in range(2):
            vertex[k, side] = passed[k + 1, side] if passed[k + 1, side] >= 0 else vertex[k + 1, side]
    for k in range(size):
        to_surface, to_bottom = k if passed[k, 0] >= 0 else to_surface, k if passed[k, 1] >= 0 else to_bottom
    return Angles(turning[:size], row[:size], vertex, to_surface, to_bottom)


@inlined
def _fill_gap(fastest: float, fan: Array, turning: Array, row: Array, size: int, c: float) -> int:
    """Insert rays of the fan between the last ray and the one that turns at c, if these are far apart. Return the number of rays."""
    if c <= turning[size - 1] * (1.0 + _RATIO):
        return size
    start = sine(turning[size - 1], fastest)
    if sine(c, fastest) - start <= WIDEST * fastest / c:
        return size
    before, r = start, np.searchsorted(fan, turning[size - 1], "right")
    while r < len(fan) and fan[r - 1] < c:
        # The difference of two angles is at most that of their sines over the smaller of their cosines.
        here = sine(fan[r], fastest)
        if here - start > WIDEST * fastest / fan[r] and before > start:
            turning[size], row[size] = fan[r - 1], r - 1
            start, size = before, size + 1
        before, r = here, r + 1
    return size


@inlined
def _inside(node: int, side: int, last: int) -> int:
    """Return the last node before the vertex `node` of a ray on one side; for -1 (no vertex) the end of the profile."""
    if node < 0:
        return last if side else 0
    return node - 1 if side else node + 1


@compiled
def ways(m: Medium, fan: Fan, nodes: Nodes, rays: Angles, begin: int, end: int, order: int, out: Array) -> None:
    """Compute the distances of the rays at both ends of some intervals, m: A, its turning arc, D, B, its turning arc.

    If no reflection is wanted (`order` 0), A and B of rays that would be reflected are endless. Arrays are unpacked once, as each array that is
    passed to a function takes as long as a layer.

    Args:
        m, fan, nodes: those of the sea.
        rays: that bound the intervals.
        begin, end: range of intervals.
        order: most reflections.
        out: (n >= end - begin, 2, 5) receives the distances, those of the flatter ray first.
    """
    z, c, k, g, table, own, after, before = m.z, m.c, m.k, m.g, fan.way, nodes.own, nodes.next, nodes.last
    turnings, rows, vertex, last, kept = rays.turning, rays.row, rays.vertex, len(m.c) - 1, len(fan.way) > 0
    for interval in range(begin, end):
        for one in range(2):
            ray, turning, row = interval - begin, turnings[interval + one], rows[interval + one]
            for part in range(3):
                at, start, stop, known = 2, m.upper, m.lower, one == 0 and ray > 0
                if part:
                    side = part - 1
                    v = vertex[interval, side]
                    inside, at = _inside(v, side, last), 3 * side
                    known = known and v == vertex[interval - 1, side]
                if known:  # the same ray as the steeper one of the interval before
                    out[ray, one, at] = out[ray - 1, 1, at]
                    if part:
                        out[ray, one, at + 1] = out[ray - 1, 1, at + 1]
                    continue
                if part:
                    if order == 0 and interval >= (rays.to_bottom if side else rays.to_surface):
                        out[ray, one, at], out[ray, one, at + 1] = ENDLESS_M, 0.0
                        continue
                    start, stop = (m.lower, inside) if side else (inside, m.upper)
                    out[ray, one, at + 1] = sine(turning, c[inside]) * turning / g[min(v, inside)] if v >= 0 else 0.0
                i, j = after[start], before[stop]
                if row < 0 or not kept or i >= j:
                    out[ray, one, at] = _direct(z, c, k, turning, start, stop, False)
                    continue
                way = table[row, own[j]] - table[row, own[i]]
                if start < i:
                    way += _direct(z, c, k, turning, start, i, False)
                if j < stop:
                    way += _direct(z, c, k, turning, j, stop, False)
                out[ray, one, at] = way


@inlined
def delays_of(
    z: Array, c: Array, k: Array, g: Array, table: Array, own: Array, after: Array, before: Array, upper: int, lower: int, turning: float,
    row: int, above: int, below: int
) -> tuple[float, float, float]:  # fmt: skip
    """Return travel time less distance times slowness (s) of a ray of the fan on A, D and B.

    Args:
        z, c, k, g, upper, lower: those of the medium. Its arrays are separate arguments, as passing a tuple of them takes longer than this function.
        table, row: delays of the fan, and the number of the ray in it.
        own, after, before: those of the nodes.
        turning: turning of the ray, m/s.
        above, below: nodes before which the ray turns; -1 if it does not turn.
    """
    up, middle, down = 0.0, 0.0, 0.0
    for part in range(3):
        v = above if part == 0 else (below if part == 2 else -1)
        inside = lower if part == 1 else _inside(v, part // 2, len(c) - 1)
        start, stop = (inside, upper) if part == 0 else ((upper, inside) if part == 1 else (lower, inside))
        first, final = after[start], before[stop]
        if first >= final:
            late = _direct(z, c, k, turning, start, stop, True)
        else:
            late = table[row, own[final]] - table[row, own[first]]
            if start < first:
                late += _direct(z, c, k, turning, start, first, True)
            if final < stop:
                late += _direct(z, c, k, turning, final, stop, True)
        if v >= 0:
            s = sine(turning, c[inside])
            late += (math.atanh(s) - s) / g[min(v, inside)]
        if part == 0:
            up = late
        elif part == 1:
            middle = late
        else:
            down = late
    return up, middle, down
