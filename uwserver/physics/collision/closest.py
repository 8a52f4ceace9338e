"""Closest points of two convex shapes, exact to rounding (compiled).

`cores` finds those of shapes with corners and edges. On the round rim of a cylinder its steps would get shorter without end; there, Newton's method
on the two curves that meet takes over. A cylinder that shows its side is replaced by its axis with a radius.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.collision.cores import FAR, TOUCHING, Cores, core_distance, core_gap, core_radius
from uwserver.physics.geometry.slots import CYLINDER, Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import dot

_SIDEWAYS = 1e-3
"""Cosine between axis and direction below which a cylinder may show its side. If it does, the cosine must be below _SQUARE with the axis in place
of the cylinder."""
_SQUARE = 1e-9


@compiled
def shape_distance(shapes: Shapes, cores: Cores, reach: float) -> float:
    """Return the distance of the cores of two shapes as `core_distance` does, also for cylinders. The distance of the shapes is smaller by
    `core_radius` of both.

    Args:
        reach: m, between the shapes.
    """
    cores.lines[:] = 0
    a, b = cores.a[0], cores.b[0]
    round_parts = core_radius(shapes, a, 0) + core_radius(shapes, b, 0)
    distance = core_distance(shapes, cores, reach + round_parts)
    if distance == 0.0 or distance == FAR:
        return distance
    a_round = shapes.slots[a].kind == CYLINDER
    b_round = b >= 0 and shapes.slots[b].kind == CYLINDER
    if not a_round and not b_round:
        return distance
    a_side = a_round and abs(_cosine(shapes, a, cores.n)) < _SIDEWAYS
    b_side = b_round and abs(_cosine(shapes, b, cores.n)) < _SIDEWAYS
    for attempt in range(3):  # both show their sides, or the one, or the other
        use_a, use_b = a_side and attempt != 2, b_side and attempt != 1
        if not use_a and not use_b:
            continue
        cores.lines[0], cores.lines[1] = 1 if use_a else 0, 1 if use_b else 0
        again = _polish(shapes, cores, core_distance(shapes, cores, FAR))
        bad = again == 0.0
        bad = bad or (use_a and abs(_cosine(shapes, a, cores.n)) > _SQUARE)
        bad = bad or (use_b and abs(_cosine(shapes, b, cores.n)) > _SQUARE)
        if not bad:
            return again
    if a_side or b_side:
        cores.lines[:] = 0
        distance = core_distance(shapes, cores, FAR)
    return _polish(shapes, cores, distance)


@compiled
def _cosine(shapes: Shapes, s: int, n: Array) -> float:
    R = shapes.R[s]
    return float(R[0, 0] * n[0] + R[1, 0] * n[1] + R[2, 0] * n[2])


@compiled
def _curve(shapes: Shapes, cores: Cores, side: int, curve: Array) -> int:
    """Return the kind of feature of a core on which the closest point lies: 0 a point, 1 a line, 2 a rim, 3 a face. Write its point or centre, and
    axes, to `curve` (3, 3).

    A point of a line is curve[0] + u curve[1]; one of a rim is curve[0] + cos(u) curve[1] + sin(u) curve[2]. The closest point has u = 0.
    """
    s, corners, codes = (
        (cores.a[0], cores.A, cores.codes[:, 0]) if side == 0 else (cores.b[0], cores.B, cores.codes[:, 1])
    )
    x = cores.xa if side == 0 else cores.xb
    if s >= 0 and shapes.slots[s].kind == CYLINDER and cores.lines[side] == 0:
        slot, P, R = shapes.slots[s], shapes.P[s], shapes.R[s]
        cosine = _cosine(shapes, s, cores.n) * (-1.0 if side == 0 else 1.0)
        if abs(cosine) > 1.0 - 1e-12:
            return 3
        y = z = 0.0
        end = slot.half_length if cosine >= 0.0 else -slot.half_length
        for i in range(3):
            curve[0, i] = P[i] + end * R[i, 0] + (cores.shift[i] if side == 0 else 0.0)
        for i in range(3):
            y += R[i, 1] * (x[i] - curve[0, i])
            z += R[i, 2] * (x[i] - curve[0, i])
        across = math.sqrt(y * y + z * z)
        if across < 0.5 * slot.radius:
            return 3
        y, z = y / across * slot.radius, z / across * slot.radius
        for i in range(3):
            curve[1, i], curve[2, i] = y * R[i, 1] + z * R[i, 2], y * R[i, 2] - z * R[i, 1]
        return 2
    second = -1
    for k in range(1, cores.size[0]):
        if codes[k] != codes[0]:
            if second >= 0 and codes[k] != codes[second]:
                return 3
            second = k
    for i in range(3):
        curve[0, i] = x[i]
        curve[1, i] = corners[second, i] - corners[0, i] if second >= 0 else 0.0
    return 1 if second >= 0 else 0


@compiled
def _at(kind: int, curve: Array, u: float, x: Array, slope: Array, bend: Array) -> None:
    """Write the point x and the first and second derivative of a curve at u."""
    c, s = math.cos(u), math.sin(u)
    for i in range(3):
        if kind == 2:
            turned = c * curve[1, i] + s * curve[2, i]
            x[i], slope[i], bend[i] = curve[0, i] + turned, c * curve[2, i] - s * curve[1, i], -turned
        else:
            x[i], slope[i], bend[i] = curve[0, i] + u * curve[1, i], curve[1, i], 0.0


@compiled
def _polish(shapes: Shapes, cores: Cores, distance: float) -> float:
    """Find the closest points of two curves, of which one is a rim, by Newton's method. Faces and lines stay as they are."""
    if distance == 0.0:
        return 0.0
    curve_a, curve_b = np.zeros((3, 3)), np.zeros((3, 3))
    kind_a, kind_b = _curve(shapes, cores, 0, curve_a), _curve(shapes, cores, 1, curve_b)
    if kind_a == 3 or kind_b == 3 or (kind_a != 2 and kind_b != 2):
        return distance
    xa, da, ea = np.empty(3), np.empty(3), np.empty(3)
    xb, db, eb = np.empty(3), np.empty(3), np.empty(3)
    u = w = 0.0
    for _ in range(12):
        _at(kind_a, curve_a, u, xa, da, ea)
        _at(kind_b, curve_b, w, xb, db, eb)
        gu = gw = huu = huw = hww = 0.0
        for i in range(3):
            r = xa[i] - xb[i]
            gu += r * da[i]
            gw -= r * db[i]
            huu += da[i] * da[i] + r * ea[i]
            huw -= da[i] * db[i]
            hww += db[i] * db[i] - r * eb[i]
        if kind_a == 0:
            huu, huw = 1.0, 0.0
        if kind_b == 0:
            hww, huw = 1.0, 0.0
        determinant = huu * hww - huw * huw
        if huu <= 0.0 or determinant <= 1e-9 * huu * hww:
            return distance
        du, dw = -(hww * gu - huw * gw) / determinant, -(huu * gw - huw * gu) / determinant
        u, w = u + du, w + dw
        if abs(du) + abs(dw) < 1e-15:
            break
    if abs(u) + abs(w) > 1e-3:  # no longer the same feature
        return distance
    _at(kind_a, curve_a, u, xa, da, ea)
    _at(kind_b, curve_b, w, xb, db, eb)
    square = 0.0
    for i in range(3):
        square += (xa[i] - xb[i]) ** 2
    length = math.sqrt(square)
    if length < TOUCHING:
        return distance
    for i in range(3):
        cores.xa[i], cores.xb[i], cores.n[i] = xa[i], xb[i], (xa[i] - xb[i]) / length
    return core_gap(shapes, cores, cores.n) + dot(cores.shift, cores.n)
