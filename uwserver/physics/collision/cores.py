"""Closest points of the cores of two convex shapes, by the algorithm of Gilbert, Johnson and Keerthi 1988 (compiled).

A ball is a point with a radius, and a capsule is a segment with a radius. So cores have only corners and edges, and the algorithm ends after finitely
many steps. Only a cylinder has a round rim, which `closest` handles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.geometry.slots import CAPSULE, CYLINDER, POLYHEDRON, SPHERE, Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import dot, triangle_weights

TOUCHING = 1e-6
"""m; cores nearer than this count as overlapping, as their closest points give no direction."""
FAR = 1e300
_STEPS = 96
_SAME = 1e-7
"""m; corners that are nearer to each other than this, as on a rim, count as one: a simplex of both would be degenerate."""


class Simplex(NamedTuple):
    """A copy of the simplex of `Cores`, with the same fields."""

    size: Array
    W: Array
    A: Array
    B: Array
    codes: Array
    weights: Array


class Cores(NamedTuple):
    """Two shapes, and a simplex of the difference of their cores: its corner k is A[k] - B[k].

    Attributes:
        a, b: (1) slots; b < 0 for the triangle in `corners`.
        corners: (3, 3) corners of that triangle, in N.
        shift: (3) by which a is moved, m.
        lines: (2) 1 if a cylinder is replaced by its axis.
        size: (1) corners of the simplex.
        W, A, B: (4, 3); `codes` (4, 2) numbers of the corners of the two shapes.
        weights: (4) of the closest point.
        n: (3) unit direction from b to a, in and out.
        xa, xb: (3) closest points of the shifted core of a, and of that of b.
        kept: the simplex of the previous step.
        v, last: (3) the point of each simplex that is nearest to the origin.
        trial, ends: (4) and (2, 3) work space.
    """

    a: Array
    b: Array
    corners: Array
    shift: Array
    lines: Array
    size: Array
    W: Array
    A: Array
    B: Array
    codes: Array
    weights: Array
    n: Array
    xa: Array
    xb: Array
    kept: Simplex
    v: Array
    last: Array
    trial: Array
    ends: Array


@compiled
def new_cores() -> Cores:
    """Return work space for any pair. It is made of few blocks of memory, as each takes a tenth of a microsecond."""
    rows, numbers, codes, weights = np.zeros((35, 3)), np.zeros(8, np.int64), np.zeros((8, 2), np.int64), np.zeros(12)
    kept = Simplex(numbers[0:1], rows[0:4], rows[4:8], rows[8:12], codes[0:4], weights[0:4])
    return Cores(
        numbers[1:2], numbers[2:3], rows[12:15], rows[15], numbers[3:5], numbers[5:6], rows[16:20], rows[20:24], rows[24:28], codes[4:8],
        weights[4:8], rows[28], rows[29], rows[30], kept, rows[31], rows[32], weights[8:12], rows[33:35],
    )  # fmt: skip


@compiled
def core_radius(shapes: Shapes, s: int, line: int) -> float:
    """Return by how much a shape is larger than its core, m."""
    if s < 0:
        return 0.0
    slot = shapes.slots[s]
    round_core = slot.kind == SPHERE or slot.kind == CAPSULE or (slot.kind == CYLINDER and line != 0)
    return float(slot.radius) if round_core else 0.0


@compiled
def farthest(shapes: Shapes, s: int, corners: Array, line: int, sign: float, d: Array, x: Array) -> int:
    """Write the point of a core that lies farthest along sign * d to x. Return its number, -1 on a rim."""
    if s < 0:
        best, most = 0, -FAR
        for k in range(3):
            reach = sign * dot(corners[k], d)
            if reach > most:
                best, most = k, reach
        for i in range(3):
            x[i] = corners[best, i]
        return best
    slot, P, R = shapes.slots[s], shapes.P[s], shapes.R[s]
    dx = sign * (R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2])
    dy = sign * (R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2])
    dz = sign * (R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2])
    if slot.kind == POLYHEDRON:
        first = slot.vertex_first
        best, most = first, -FAR
        for v in range(first, first + slot.vertex_count):
            reach = shapes.vertices[v, 0] * dx + shapes.vertices[v, 1] * dy + shapes.vertices[v, 2] * dz
            if reach > most:
                best, most = v, reach
        for i in range(3):
            x[i] = P[i] + dot(R[i], shapes.vertices[best])
        return int(best - first)
    along = 0.0
    if slot.kind != SPHERE:
        along = slot.half_length if dx >= 0.0 else -slot.half_length
    for i in range(3):
        x[i] = P[i] + along * R[i, 0]
    if slot.kind == CYLINDER and line == 0:
        across = math.sqrt(dy * dy + dz * dz)
        if across > 0.0:
            for i in range(3):
                x[i] += slot.radius * (R[i, 1] * dy + R[i, 2] * dz) / across
        return -1
    return 0 if dx >= 0.0 else 1


@compiled
def core_gap(shapes: Shapes, cores: Cores, n: Array) -> float:
    """Return the gap between the cores along n, without the shift, m."""
    xa, xb = cores.ends[0], cores.ends[1]
    farthest(shapes, cores.a[0], cores.corners, cores.lines[0], -1.0, n, xa)
    farthest(shapes, cores.b[0], cores.corners, cores.lines[1], 1.0, n, xb)
    gap = 0.0
    for i in range(3):
        gap += (xa[i] - xb[i]) * n[i]
    return gap


@compiled
def _add_corner(shapes: Shapes, cores: Cores, v: Array) -> bool:
    """Append the corner of the difference that lies farthest along -v to the simplex. Return False if the simplex contains it already."""
    k = cores.size[0]
    W, codes = cores.W, cores.codes
    codes[k, 0] = farthest(shapes, cores.a[0], cores.corners, cores.lines[0], -1.0, v, cores.A[k])
    codes[k, 1] = farthest(shapes, cores.b[0], cores.corners, cores.lines[1], 1.0, v, cores.B[k])
    for i in range(3):
        cores.A[k, i] += cores.shift[i]
        W[k, i] = cores.A[k, i] - cores.B[k, i]
    nearest = FAR
    for j in range(k):
        nearest = min(nearest, (W[j, 0] - W[k, 0]) ** 2 + (W[j, 1] - W[k, 1]) ** 2 + (W[j, 2] - W[k, 2]) ** 2)
    return nearest >= _SAME * _SAME


@compiled
def _on_triangle(a: Array, b: Array, c: Array, weights: Array) -> None:
    """Write the weights (3) of the point of a triangle that is nearest to the origin."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 -= ab * a[i]
        d2 -= ac * a[i]
        d3 -= ab * b[i]
        d4 -= ac * b[i]
        d5 -= ab * c[i]
        d6 -= ac * c[i]
    v, w = triangle_weights(d1, d2, d3, d4, d5, d6)
    weights[0], weights[1], weights[2] = 1.0 - v - w, v, w


@compiled
def _outside(p: Array, q: Array, r: Array, other: Array) -> bool:
    """Return whether the origin and the fourth corner of a tetrahedron lie on two sides of a face. For a flat tetrahedron they do."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    here = -(nx * p[0] + ny * p[1] + nz * p[2])
    there = nx * (other[0] - p[0]) + ny * (other[1] - p[1]) + nz * (other[2] - p[2])
    wx, wy, wz = other[0] - p[0], other[1] - p[1], other[2] - p[2]
    flat = 1e-14 * math.sqrt((nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz))
    return bool(abs(there) <= flat or here * there < 0.0)


@compiled
def _nearest(cores: Cores, v: Array) -> bool:
    """Find the point v of the simplex nearest to the origin, and drop the corners that it does not need. Return False if the origin is inside."""
    W, weights, count = cores.W, cores.weights, cores.size[0]
    trial, best = cores.trial, FAR
    if count == 1:
        weights[0] = 1.0
    elif count == 2:
        along = square = 0.0
        for i in range(3):
            along -= W[0, i] * (W[1, i] - W[0, i])
            square += (W[1, i] - W[0, i]) ** 2
        weights[1] = min(max(along / square, 0.0), 1.0)
        weights[0] = 1.0 - weights[1]
    elif count == 3:
        _on_triangle(W[0], W[1], W[2], weights)
    else:
        some = False
        for skip in range(4):
            i, j, k = (1 if skip == 0 else 0), (2 if skip <= 1 else 1), (3 if skip <= 2 else 2)
            if not _outside(W[i], W[j], W[k], W[skip]):
                continue
            _on_triangle(W[i], W[j], W[k], trial)
            square = 0.0
            for m in range(3):
                square += (trial[0] * W[i, m] + trial[1] * W[j, m] + trial[2] * W[k, m]) ** 2
            if square < best:
                some, best = True, square
                weights[i], weights[j], weights[k], weights[skip] = trial[0], trial[1], trial[2], 0.0
        if not some:
            return False
    kept = 0
    v[0] = v[1] = v[2] = 0.0
    for k in range(count):
        if weights[k] > 0.0:
            weights[kept] = weights[k]
            for i in range(3):
                W[kept, i], cores.A[kept, i], cores.B[kept, i] = W[k, i], cores.A[k, i], cores.B[k, i]
                v[i] += weights[kept] * W[kept, i]
            cores.codes[kept, 0], cores.codes[kept, 1] = cores.codes[k, 0], cores.codes[k, 1]
            kept += 1
    cores.size[0] = kept
    return True


@compiled
def _copy(one: Cores | Simplex, v: Array, to: Cores | Simplex, to_v: Array) -> None:
    """Copy a simplex and its nearest point."""
    to.size[0] = one.size[0]
    for k in range(one.size[0]):
        to.codes[k, 0], to.codes[k, 1], to.weights[k] = one.codes[k, 0], one.codes[k, 1], one.weights[k]
        for i in range(3):
            to.W[k, i], to.A[k, i], to.B[k, i] = one.W[k, i], one.A[k, i], one.B[k, i]
    for i in range(3):
        to_v[i] = v[i]


@compiled
def core_distance(shapes: Shapes, cores: Cores, reach: float) -> float:
    """Return the distance of the cores, and set n, xa and xb. Return 0 if they overlap, `FAR` if they are farther apart than reach (m)."""
    v, kept, last = cores.v, cores.kept, cores.last
    for i in range(3):
        v[i] = cores.n[i]
    cores.size[0] = 0
    _add_corner(shapes, cores, v)
    cores.size[0] = 1
    _nearest(cores, v)
    square = dot(v, v)
    for _ in range(_STEPS):
        if square < TOUCHING * TOUCHING:
            return 0.0
        new = _add_corner(shapes, cores, v)
        lowest = dot(v, cores.W[cores.size[0]])
        if lowest > 0.0 and lowest * lowest > reach * reach * square:
            return FAR
        if not new or square - lowest <= 1e-15 * square:
            break
        _copy(cores, v, kept, last)
        cores.size[0] += 1
        if not _nearest(cores, v):
            return 0.0
        if dot(v, v) >= square:  # no nearer, because of rounding
            _copy(kept, last, cores, v)
            break
        square = dot(v, v)
    _conclude(cores, v)
    # The gap of the supports along n is the most accurate value of the distance, as n has the smallest error.
    return core_gap(shapes, cores, cores.n) + dot(cores.shift, cores.n)


@compiled
def _conclude(cores: Cores, v: Array) -> None:
    """Set closest points and direction of a finished simplex. The direction of one with three corners is its normal, which stays exact at small
    distances."""
    n, W = cores.n, cores.W
    for i in range(3):
        cores.xa[i] = cores.xb[i] = 0.0
        for k in range(cores.size[0]):
            cores.xa[i] += cores.weights[k] * cores.A[k, i]
            cores.xb[i] += cores.weights[k] * cores.B[k, i]
    length = math.sqrt(dot(v, v))
    for i in range(3):
        n[i] = v[i] / length
    # On the border of the triangle the nearest point lies on an edge, and the third corner is there only because of rounding.
    if cores.size[0] != 3 or min(cores.weights[0], cores.weights[1], cores.weights[2]) < 1e-9:
        return
    ux, uy, uz = W[1, 0] - W[0, 0], W[1, 1] - W[0, 1], W[1, 2] - W[0, 2]
    wx, wy, wz = W[2, 0] - W[0, 0], W[2, 1] - W[0, 1], W[2, 2] - W[0, 2]
    cx, cy, cz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    area = math.sqrt(cx * cx + cy * cy + cz * cz)
    if area < 1e-6 * math.sqrt((ux * ux + uy * uy + uz * uz) * (wx * wx + wy * wy + wz * wz)):
        return
    along = (cx * v[0] + cy * v[1] + cz * v[2]) / area
    if abs(along) < (1.0 - 1e-6) * length:
        return
    if along < 0.0:
        area = -area
    n[0], n[1], n[2] = cx / area, cy / area, cz / area
