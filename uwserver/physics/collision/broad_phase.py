"""Finds shapes that come near others in a tick, by boxes around them that are enlarged by the distance that a body can move (compiled).

So a body far from everything solid costs a few comparisons and no call of an engine. A box that is too large costs time and never changes a contact,
as contacts are judged by their own gap.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.geometry.mesh import any_triangle_in
from uwserver.physics.geometry.slots import HALF_SPACE, MESH, SHAPES, Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import arrays_at
from uwserver.physics.kernel.layout import NU, Forms, P, Q, columns
from uwserver.physics.kernel.linear import dot, product, rotation


class Search(NamedTuple):
    """The data of a search, beside the shapes.

    Attributes:
        bodies: (m, 3) first slot, count of slots, row in the state, in rising order of the slots.
        fixed: slots of static shapes, in rising order.
        radius: (m) of a ball about each body's origin that holds its shapes, m.
        Q: (n, 4) attitudes of the engine's shapes, x y z w. Those of a body, and the poses and boxes of its shapes, are updated only if it is near
            something.
        reach: (n) by how much the box of each shape is larger than the shape, m.
        low, high: (n, 3) boxes around the shapes, in N.
        body_low, body_high: (m, 3) boxes around the bodies: around their balls, or around their shapes if they are near something.
        order: (m) bodies in the order of the last sorting.
        overlapping: (m) whether the box around a body's ball meets that of another body.
        near: (m) whether it meets any other box.
    """

    bodies: Array
    fixed: Array
    radius: Array
    Q: Array
    reach: Array
    low: Array
    high: Array
    body_low: Array
    body_high: Array
    order: Array
    overlapping: Array
    near: Array


SEARCH: Forms = {
    **SHAPES,
    "bodies": columns(np.int64, 3),
    "fixed": columns(np.int64),
    "radius": columns(np.float64),
    "Q": columns(np.float64, 4),
    "reach": columns(np.float64),
    "low": columns(np.float64, 3),
    "high": columns(np.float64, 3),
    "body_low": columns(np.float64, 3),
    "body_high": columns(np.float64, 3),
    "order": columns(np.int64),
    "overlapping": columns(np.bool_),
    "near": columns(np.bool_),
}
"""The table for a search and for `narrow_phase`."""

_shapes_at, _search_at = arrays_at(Shapes, SEARCH), arrays_at(Search, SEARCH)


@compiled
def place(slot: Any, p: Array, R: Array, P_out: Array, R_out: Array) -> None:
    """Write the pose in N of a shape whose solid is at p with attitude R."""
    for i in range(3):
        P_out[i] = p[i] + dot(R[i], slot.p)
        for j in range(3):
            R_out[i, j] = R[i, 0] * slot.R[0, j] + R[i, 1] * slot.R[1, j] + R[i, 2] * slot.R[2, j]


def radius_of(slots: Any) -> float:
    """Return the radius (m) of a ball about a body's origin that holds its shapes, given as records."""
    arms, sizes = np.linalg.norm(slots["p"], axis=1), np.linalg.norm(np.abs(slots["centre"]) + slots["half"], axis=1)
    return float(np.max(arms + sizes, initial=0.0))


@compiled
def bound(slot: Any, P: Array, R: Array, reach: float, low: Array, high: Array) -> None:
    """Write the box in N around a placed shape, `reach` (m) larger on every side."""
    for i in range(3):
        centre = P[i] + dot(R[i], slot.centre)
        half = abs(R[i, 0]) * slot.half[0] + abs(R[i, 1]) * slot.half[1] + abs(R[i, 2]) * slot.half[2] + reach
        low[i], high[i] = centre - half, centre + half


@compiled
def overlap(low_a: Array, high_a: Array, low_b: Array, high_b: Array) -> bool:
    """Return whether two boxes meet."""
    apart = False
    for i in range(3):
        apart = apart or low_a[i] > high_b[i] or low_b[i] > high_a[i]
    return not apart


@compiled
def _below(P: Array, R: Array, low: Array, high: Array) -> bool:
    """Return whether any corner of a box is inside a half-space."""
    depth = 0.0
    for i in range(3):
        depth += (high[i] if R[i, 2] > 0.0 else low[i]) * R[i, 2] - P[i] * R[i, 2]
    return depth >= 0.0


@compiled
def _bound_bodies(search: Search, state: Array, dt: float, margin: float) -> None:
    """Set the boxes around the balls that hold bodies, enlarged by the distance that they can move. A body whose state is not finite gets a box
    that meets nothing."""
    low, high = search.body_low, search.body_high
    for b in range(len(search.bodies)):
        first, count, row = search.bodies[b]
        x = state[row]
        speed = math.sqrt(x[NU] ** 2 + x[NU + 1] ** 2 + x[NU + 2] ** 2)
        rate = math.sqrt(x[NU + 3] ** 2 + x[NU + 4] ** 2 + x[NU + 5] ** 2)
        reach = margin + dt * (speed + rate * search.radius[b])
        for s in range(first, first + count):
            search.reach[s] = reach
        finite = True
        for i in range(len(x)):
            finite = finite and math.isfinite(x[i])
        for i in range(3):
            low[b, i] = x[P + i] - search.radius[b] - reach if finite else 1e300
            high[b, i] = x[P + i] + search.radius[b] + reach if finite else -1e300


@compiled
def _find_near(shapes: Shapes, search: Search, gate: bool) -> None:
    """Find the bodies whose boxes meet that of another body or of a static shape."""
    slots, fixed, body_low, body_high = shapes.slots, search.fixed, search.body_low, search.body_high
    for b in range(len(search.bodies)):
        near = not gate or bool(search.overlapping[b])
        for f in range(len(fixed)):
            if near:
                break
            t = fixed[f]
            if slots[t].kind == HALF_SPACE:
                near = _below(shapes.P[t], shapes.R[t], body_low[b], body_high[b])
            else:
                near = overlap(body_low[b], body_high[b], search.low[t], search.high[t])
        search.near[b] = near


@compiled
def _place_near(shapes: Shapes, search: Search, state: Array) -> None:
    """Set poses, attitudes for the engine and boxes of the shapes of bodies that are near something, and the boxes around these bodies."""
    slots, low, high, body_low, body_high = shapes.slots, search.low, search.high, search.body_low, search.body_high
    R, engine = shapes.R[0].copy(), search.Q
    for b in range(len(search.bodies)):
        if not search.near[b]:
            continue
        first, count, row = search.bodies[b]
        x = state[row]
        rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
        nowhere = body_low[b, 0] > body_high[b, 0]
        for i in range(3):
            body_low[b, i], body_high[b, i] = 1e300, -1e300
        for s in range(first, first + count):
            place(slots[s], x[P : P + 3], R, shapes.P[s], shapes.R[s])
            q = slots[s].q
            engine[s, 3], engine[s, 0], engine[s, 1], engine[s, 2] = product(
                x[Q], x[Q + 1], x[Q + 2], x[Q + 3], q[0], q[1], q[2], q[3]
            )
            bound(slots[s], shapes.P[s], shapes.R[s], search.reach[s], low[s], high[s])
            if nowhere:
                low[s], high[s] = 1e300, -1e300
            for i in range(3):
                body_low[b, i] = min(body_low[b, i], low[s, i])
                body_high[b, i] = max(body_high[b, i], high[s, i])


@compiled
def sweep(search: Search) -> None:
    """Find the bodies whose boxes meet that of another body, by sweep and prune along x. Of the last tick only `order` is used."""
    low, high, order, overlapping = search.body_low, search.body_high, search.order, search.overlapping
    n = len(order)
    for i in range(1, n):
        b, k = order[i], i
        while k > 0 and low[order[k - 1], 0] > low[b, 0]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = b
    for i in range(n):
        overlapping[i] = False
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
                overlapping[b] = overlapping[c] = True


@compiled
def overlapping_pairs(shapes: Shapes, search: Search, gate: bool, pairs: Array) -> int:
    """Write the pairs of slots (a moving, b static or of a later body) whose boxes meet to `pairs` (k, 2), as far as they fit.

    Args:
        gate: False gives every pair, for tests.

    Returns:
        How many there are.
    """
    slots, bodies, fixed, low, high = shapes.slots, search.bodies, search.fixed, search.low, search.high
    body_low, body_high = search.body_low, search.body_high
    count = 0
    for b in range(len(bodies)):
        if not search.near[b]:
            continue
        first, size = bodies[b, 0], bodies[b, 1]
        for f in range(len(fixed)):
            t = fixed[f]
            endless = slots[t].kind == HALF_SPACE
            if gate and not endless and not overlap(body_low[b], body_high[b], low[t], high[t]):
                continue
            for s in range(first, first + size):
                if endless:
                    hit = _below(shapes.P[t], shapes.R[t], low[s], high[s])
                elif slots[t].kind == MESH:
                    hit = any_triangle_in(shapes, t, low[s], high[s])
                else:
                    hit = overlap(low[s], high[s], low[t], high[t])
                if hit or not gate:
                    if count < len(pairs):
                        pairs[count, 0], pairs[count, 1] = s, t
                    count += 1
        if gate and not search.overlapping[b]:
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


@entry
def find_pairs(table: Array, state: Array, dt: float, margin: float, gate: bool, pairs: Array) -> int:
    """Find pairs of shapes that may touch within a tick, and move the shapes of bodies that are near something to their present places.

    Args:
        table: made by `SEARCH`.
        state: (n, 13) states of the bodies.
        dt: length of the tick, s.
        margin: m, added to the way that a body can go in dt.
        gate: False gives every pair, for tests.
        pairs: (k, 2) receives slots, as far as they fit.

    Returns:
        How many there are.
    """
    shapes, search = _shapes_at(table), _search_at(table)
    _bound_bodies(search, state, dt, margin)
    sweep(search)
    _find_near(shapes, search, gate)
    _place_near(shapes, search, state)
    return int(overlapping_pairs(shapes, search, gate, pairs))
