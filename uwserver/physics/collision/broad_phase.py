"""Which shapes come near others in a tick: boxes around them, grown by the way that a body can go (compiled).

So a body far from everything solid costs a few comparisons and no call into an engine. A box that is too large costs time and never changes
a contact, as contacts are judged by their own gap.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import carray

from uwserver.physics.dynamics.fossen import rotation
from uwserver.physics.geometry.mesh import any_triangle_in
from uwserver.physics.geometry.rows import SLOT
from uwserver.physics.kernel.compiled import compiled, inlined
from uwserver.physics.kernel.handles import pointer_at
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.physics.kernel.linear import dot

Array = Any  # numpy array inside compiled code

_HALF_SPACE, _MESH = 4, 5  # as in solid_rows


@compiled
def place(slot: Any, p: Array, R: Array, P_out: Array, R_out: Array) -> None:
    """Pose in N of a shape whose solid stands at p with attitude R."""
    for i in range(3):
        P_out[i] = p[i] + dot(R[i], slot.p)
        for j in range(3):
            R_out[i, j] = R[i, 0] * slot.R[0, j] + R[i, 1] * slot.R[1, j] + R[i, 2] * slot.R[2, j]


@compiled
def bound(slot: Any, P: Array, R: Array, reach: float, low: Array, high: Array) -> None:
    """The box in N around a placed shape, `reach` (m) larger on every side."""
    for i in range(3):
        centre = P[i] + dot(R[i], slot.centre)
        half = abs(R[i, 0]) * slot.half[0] + abs(R[i, 1]) * slot.half[1] + abs(R[i, 2]) * slot.half[2] + reach
        low[i], high[i] = centre - half, centre + half


@compiled
def move(
    slots: Array, bodies: Array, state: Array, dt: float, margin: float, Ps: Array, Rs: Array, Qs: Array, reach: Array,
    low: Array, high: Array, body_low: Array, body_high: Array,
) -> None:  # fmt: skip
    """Poses, reaches and boxes of all shapes of moving bodies, and the box around each body. One whose state is not finite is nowhere.

    Args:
        bodies: (m, 3) first slot, count of slots, row in the state, in rising order of the slots.
        margin: m, added to the way that the body can go in dt.
        Qs: receives the attitudes of the engine's shapes, x y z w.
    """
    R = Rs[0].copy()
    for b in range(len(bodies)):
        first, count, row = bodies[b]
        x = state[row]
        rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
        speed = math.sqrt(x[NU] ** 2 + x[NU + 1] ** 2 + x[NU + 2] ** 2)
        turn = math.sqrt(x[NU + 3] ** 2 + x[NU + 4] ** 2 + x[NU + 5] ** 2)
        finite = True
        for i in range(len(x)):
            finite = finite and math.isfinite(x[i])
        radius = 0.0
        for s in range(first, first + count):
            slot = slots[s]
            arm, size = 0.0, 0.0
            for i in range(3):
                arm += slot.p[i] ** 2
                size += (abs(slot.centre[i]) + slot.half[i]) ** 2
            radius = max(radius, math.sqrt(arm) + math.sqrt(size))
        for i in range(3):
            body_low[b, i], body_high[b, i] = 1e300, -1e300
        for s in range(first, first + count):
            reach[s] = margin + dt * (speed + turn * radius)
            place(slots[s], x[P : P + 3], R, Ps[s], Rs[s])
            _turn(x[Q : Q + 4], slots[s].q, Qs[s])
            bound(slots[s], Ps[s], Rs[s], reach[s], low[s], high[s])
            if not finite:
                low[s], high[s] = 1e300, -1e300
            for i in range(3):
                body_low[b, i] = min(body_low[b, i], low[s, i])
                body_high[b, i] = max(body_high[b, i], high[s, i])


@compiled
def _turn(a: Array, b: Array, xyzw: Array) -> None:
    """Hamilton product of two quaternions w x y z, as the engine writes it."""
    xyzw[3] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    xyzw[0] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    xyzw[1] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    xyzw[2] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@compiled
def overlap(low_a: Array, high_a: Array, low_b: Array, high_b: Array) -> bool:
    """Whether two boxes meet."""
    apart = False
    for i in range(3):
        apart = apart or low_a[i] > high_b[i] or low_b[i] > high_a[i]
    return not apart


@compiled
def _below(slot: Any, P: Array, R: Array, low: Array, high: Array) -> bool:
    """Whether any corner of a box is inside a half-space."""
    depth = 0.0
    for i in range(3):
        depth += (high[i] if R[i, 2] > 0.0 else low[i]) * R[i, 2] - P[i] * R[i, 2]
    return depth >= 0.0


@compiled
def _find_company(low: Array, high: Array, order: Array, company: Array) -> None:
    """company[b]: whether the box of body b meets that of another. Sweep along x: `order` keeps its sense from tick to tick, nothing else."""
    n = len(order)
    for i in range(1, n):
        b, k = order[i], i
        while k > 0 and low[order[k - 1], 0] > low[b, 0]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = b
    for i in range(n):
        company[i] = False
    for i in range(n):
        b = order[i]
        for j in range(i + 1, n):
            c = order[j]
            if low[c, 0] > high[b, 0]:
                break
            if (
                low[c, 1] <= high[b, 1]
                and low[b, 1] <= high[c, 1]
                and low[c, 2] <= high[b, 2]
                and low[b, 2] <= high[c, 2]
            ):
                company[b] = company[c] = True


@compiled
def near_pairs(
    slots: Array, bodies: Array, fixed: Array, Ps: Array, Rs: Array, low: Array, high: Array, body_low: Array,
    body_high: Array, company: Array, vertices: Array, triangles: Array, cell_start: Array, cell_triangles: Array, gate: bool,
    pairs: Array,
) -> int:  # fmt: skip
    """Pairs of slots (a moving, b static or of a later body) whose boxes meet, into `pairs` (k, 2) as far as they fit.

    Args:
        fixed: slots of static shapes, in rising order.
        company: (m) whether a body's box meets that of another body.
        gate: False takes every pair, for tests.

    Returns:
        How many there are.
    """
    count = 0
    for b in range(len(bodies)):
        first, size = bodies[b, 0], bodies[b, 1]
        for f in range(len(fixed)):
            t = fixed[f]
            endless = slots[t].kind == _HALF_SPACE
            if gate and not endless and not overlap(body_low[b], body_high[b], low[t], high[t]):
                continue
            for s in range(first, first + size):
                if endless:
                    hit = _below(slots[t], Ps[t], Rs[t], low[s], high[s])
                elif slots[t].kind == _MESH:
                    hit = any_triangle_in(slots[t], low[s], high[s], vertices, triangles, cell_start, cell_triangles)
                else:
                    hit = overlap(low[s], high[s], low[t], high[t])
                if hit or not gate:
                    if count < len(pairs):
                        pairs[count, 0], pairs[count, 1] = s, t
                    count += 1
        if gate and not company[b]:
            continue
        for c in range(b + 1, len(bodies)):
            if gate and not overlap(body_low[b], body_high[b], body_low[c], body_high[c]):
                continue
            for s in range(first, first + size):
                for t in range(bodies[c, 0], bodies[c, 0] + bodies[c, 1]):
                    if not gate or overlap(low[s], high[s], low[t], high[t]):
                        if count < len(pairs):
                            pairs[count, 0], pairs[count, 1] = s, t
                        count += 1
    return count


class Search(NamedTuple):
    """What a search works on, in the order of its table.

    Attributes:
        slots, vertices, triangles, cell_start, cell_triangles: as in `solid_rows.Rows`.
        others: as `move` and `near_pairs` take them.
    """

    slots: Any
    bodies: Any
    fixed: Any
    Ps: Any
    Rs: Any
    Qs: Any
    reach: Any
    low: Any
    high: Any
    body_low: Any
    body_high: Any
    order: Any
    company: Any
    vertices: Any
    triangles: Any
    cell_start: Any
    cell_triangles: Any


@inlined
def _search_at(table: Array) -> Search:
    n, m = table[0, 1], table[1, 1]
    return Search(
        carray(pointer_at(table, 0), (n,), SLOT),
        carray(pointer_at(table, 1), (m, 3), np.int64),
        carray(pointer_at(table, 2), (table[2, 1],), np.int64),
        carray(pointer_at(table, 3), (n, 3), np.float64),
        carray(pointer_at(table, 4), (n, 3, 3), np.float64),
        carray(pointer_at(table, 5), (n, 4), np.float64),
        carray(pointer_at(table, 6), (n,), np.float64),
        carray(pointer_at(table, 7), (n, 3), np.float64),
        carray(pointer_at(table, 8), (n, 3), np.float64),
        carray(pointer_at(table, 9), (m, 3), np.float64),
        carray(pointer_at(table, 10), (m, 3), np.float64),
        carray(pointer_at(table, 11), (m,), np.int64),
        carray(pointer_at(table, 12), (m,), np.bool_),
        carray(pointer_at(table, 13), (table[13, 1], 3), np.float64),
        carray(pointer_at(table, 14), (table[14, 1], 3), np.int64),
        carray(pointer_at(table, 15), (table[15, 1],), np.int64),
        carray(pointer_at(table, 16), (table[16, 1],), np.int64),
    )


@compiled
def search(table: Array, state: Array, dt: float, margin: float, gate: bool, pairs: Array) -> int:
    """`move`, then `near_pairs`.

    Args:
        table: addresses (`layout`) of a `Search`.
        others: as there.
    """
    s = _search_at(table)
    move(
        s.slots, s.bodies, state, dt, margin, s.Ps, s.Rs, s.Qs, s.reach, s.low, s.high, s.body_low, s.body_high
    )  # fmt: skip
    _find_company(s.body_low, s.body_high, s.order, s.company)
    return near_pairs(
        s.slots, s.bodies, s.fixed, s.Ps, s.Rs, s.low, s.high, s.body_low, s.body_high, s.company, s.vertices, s.triangles,
        s.cell_start, s.cell_triangles, gate, pairs,
    )  # fmt: skip
