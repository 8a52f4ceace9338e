"""Finds the direction in which two near shapes touch: exactly from the shapes if they are apart, from the answer of an engine if they overlap
(compiled).

For shapes that are apart it is the line between their closest points, and no engine is needed. For convex shapes that overlap an engine gives the
shortest way out, with its own rounding. Here that is made exact: with one shape moved out along it and a little farther, the shapes are apart again,
and the line between their closest points is the exact way out nearest to the engine's answer. A triangle has few ways out, along its normal or over
one of its edges: they are tried in turn.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.collision.broad_phase import SEARCH
from uwserver.physics.collision.closest import shape_distance
from uwserver.physics.collision.cores import FAR, Cores, core_gap, core_radius, new_cores
from uwserver.physics.collision.faces import SHALLOW, out_of_face, over_triangle, triangle_side
from uwserver.physics.collision.manifold import Work, new_work
from uwserver.physics.geometry.mesh import triangles_in
from uwserver.physics.geometry.slots import HALF_SPACE, MESH, Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, arrays_at
from uwserver.physics.kernel.linear import dot

LINE = 7
"""Columns of a line: direction (3) from b to a, point on b (3), gap."""
_CLEAR = 1e-3
"""m; the gap to which overlapping shapes are moved apart."""
_TURNS = 32
_SETTLED = 1e-11
"""A direction that turns by less than this from one turn to the next is exact: the rest is rounding."""

_shapes_at = arrays_at(Shapes, SEARCH)
_reach_at, _low_at, _high_at = array_at(SEARCH, "reach"), array_at(SEARCH, "low"), array_at(SEARCH, "high")


@compiled
def _set_pair(shapes: Shapes, a: int, b: int, triangle: int, cores: Cores) -> None:
    cores.a[0], cores.b[0] = a, b if triangle < 0 else -1
    cores.shift[:] = 0.0
    if triangle >= 0:
        for c in range(3):
            for i in range(3):
                cores.corners[c, i] = shapes.vertices[shapes.triangles[triangle, c], i]


@compiled
def start_direction(shapes: Shapes, a: int, b: int, triangle: int, n: Array) -> None:
    """Write a first direction to n (3): the normal of a triangle, outward or towards the shape, or the direction between the centres of two
    shapes."""
    if triangle >= 0:
        triangle_side(shapes, a, b, triangle, n)
        return
    for i in range(3):
        n[i] = shapes.P[a, i] + dot(shapes.R[a, i], shapes.slots[a].centre)
        n[i] -= shapes.P[b, i] + dot(shapes.R[b, i], shapes.slots[b].centre)
    square = dot(n, n)
    if square > 1e-12:
        for i in range(3):
            n[i] /= math.sqrt(square)
    else:
        n[0], n[1], n[2] = 0.0, 0.0, -1.0


@compiled
def apart(shapes: Shapes, a: int, b: int, triangle: int, reach: float, cores: Cores, line: Array) -> int:
    """Find the line between two shapes, or a shape and a triangle. Return 1 if there is one, 0 if they are farther apart than reach (m), -1 if
    they overlap."""
    _set_pair(shapes, a, b, triangle, cores)
    start_direction(shapes, a, b, triangle, cores.n)
    distance = shape_distance(shapes, cores, reach)
    for i in range(3):
        line[i] = cores.n[i]
    if distance == 0.0:
        line[3:] = 0.0
        return -1
    radius_b = core_radius(shapes, cores.b[0], cores.lines[1])
    gap = distance - core_radius(shapes, cores.a[0], cores.lines[0]) - radius_b
    if distance == FAR or gap > reach:
        return 0
    for i in range(3):
        line[3 + i] = cores.xb[i] + radius_b * cores.n[i]
    line[6] = gap
    return 1


@compiled
def way_out(shapes: Shapes, a: int, b: int, triangle: int, cores: Cores, line: Array) -> bool:
    """Make the direction of a line exact, along which two overlapping shapes come apart. Return False if it is no way out; the line then stays as
    it is."""
    _set_pair(shapes, a, b, triangle, cores)
    n, best = line[:3].copy(), -FAR
    found = False
    for _ in range(_TURNS):
        cores.lines[:] = 0
        move = _CLEAR - core_gap(shapes, cores, n)
        for i in range(3):
            cores.shift[i], cores.n[i] = move * n[i], n[i]
        distance = shape_distance(shapes, cores, FAR)
        if distance == 0.0:
            break
        radius_a, radius_b = core_radius(shapes, a, cores.lines[0]), core_radius(shapes, cores.b[0], cores.lines[1])
        gap = core_gap(shapes, cores, cores.n) - radius_a - radius_b
        if gap < best - 1e-12:
            break
        found, best = True, gap
        turned = 0.0
        for i in range(3):
            turned = max(turned, abs(cores.n[i] - n[i]))
            n[i] = line[i] = cores.n[i]
            line[3 + i] = cores.xb[i] + radius_b * n[i]
        line[6] = gap
        if turned < _SETTLED:
            break
    return found


@compiled
def out_of_triangle(shapes: Shapes, a: int, b: int, triangle: int, cores: Cores, line: Array) -> bool:
    """Find the shortest way out of a triangle that a shape overlaps. Return False if there is none."""
    other, normal = np.zeros(LINE), np.empty(3)
    start_direction(shapes, a, b, triangle, line[:3])
    for i in range(3):
        normal[i] = line[i]
    found = way_out(shapes, a, b, triangle, cores, line)
    if found and line[6] > SHALLOW:
        return True
    for e in range(3):
        square = 0.0
        u, v = shapes.vertices[shapes.triangles[triangle, e]], shapes.vertices[shapes.triangles[triangle, (e + 1) % 3]]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            other[i] = (v[j] - u[j]) * shapes.triangle_normals[triangle, k] - (v[k] - u[k]) * shapes.triangle_normals[
                triangle, j
            ]
            square += other[i] ** 2
        for i in range(3):
            other[i] /= math.sqrt(square)
        if not way_out(shapes, a, b, triangle, cores, other):
            continue
        # Never to the inner side of a seabed.
        if shapes.slots[b].oriented != 0 and dot(other[:3], normal) < -1e-9:
            continue
        if not found or other[6] > line[6] + 1e-9:
            for i in range(LINE):
                line[i] = other[i]
            found = True
    return found


@compiled
def _add_line(
    shapes: Shapes, a: int, b: int, triangle: int, reach: float, cores: Cores, work: Work, line: Array, lines: Array, overlapping: Array,
    total: int,
) -> int:  # fmt: skip
    outcome = over_triangle(shapes, a, b, triangle, reach, cores, work, line) if triangle >= 0 else -1
    if outcome < 0:
        outcome = apart(shapes, a, b, triangle, reach, cores, line)
    if outcome < 0 and triangle >= 0:
        outcome = 1 if out_of_triangle(shapes, a, b, triangle, cores, line) else 0
    elif outcome < 0 and out_of_face(shapes, a, b, cores, work, line):
        outcome = 1
    if outcome == 0:
        return total
    if total < len(lines):
        lines[total] = line
        overlapping[total] = outcome < 0
    return total + 1


@entry
def find_lines(table: Array, pairs: Array, first: Array, lines: Array, overlapping: Array) -> int:
    """Find the lines between all near pairs.

    Args:
        table: made by `broad_phase.SEARCH`.
        pairs: (m, 2) slots; a mesh stands second.
        first: (m + 1) receives where each pair's lines begin.
        lines: (k, LINE) receives them as far as they fit; for convex shapes that overlap, a first direction in case the engine gives none.
        overlapping: (k) receives which lines are of that kind.

    Returns:
        The number of lines.
    """
    shapes, reach, low, high = _shapes_at(table), _reach_at(table), _low_at(table), _high_at(table)
    cores, work, near, line = new_cores(), new_work(), np.empty(256, np.int64), np.empty(LINE)
    total = 0
    for i in range(len(pairs)):
        a, b = pairs[i]
        first[i] = total
        far = reach[a] + reach[b]
        if shapes.slots[b].kind == HALF_SPACE:
            continue
        if shapes.slots[b].kind != MESH:
            total = _add_line(shapes, a, b, -1, far, cores, work, line, lines, overlapping, total)
            continue
        count = triangles_in(shapes, b, low[a], high[a], near)
        if count > len(near):
            near = np.empty(2 * count, np.int64)
            count = triangles_in(shapes, b, low[a], high[a], near)
        for k in range(count):
            total = _add_line(shapes, a, b, near[k], far, cores, work, line, lines, overlapping, total)
    first[len(pairs)] = total
    return total


@entry
def refine_lines(table: Array, pairs: Array, first: Array, lines: Array, overlapping: Array) -> int:
    """Make the lines of overlapping shapes exact, whose directions an engine has given; arguments as for `find_lines`.

    Return the number of lines that cannot be made exact: their gap becomes inf, and they give no contact.
    """
    shapes, cores = _shapes_at(table), new_cores()
    failed = 0
    for i in range(len(pairs)):
        a, b = pairs[i]
        for k in range(first[i], first[i + 1]):
            if not overlapping[k] or way_out(shapes, a, b, -1, cores, lines[k]):
                continue
            start_direction(shapes, a, b, -1, lines[k, :3])
            if not way_out(shapes, a, b, -1, cores, lines[k]):
                lines[k, 6] = math.inf
                failed += 1
    return failed
