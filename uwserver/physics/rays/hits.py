"""Exact hits of rays: on planes and small solids by looking at each, on triangles that an engine has picked (compiled, float64).

All functions keep, in the answer, the nearest hit of each ray that is not farther than a limit: `distance` (n, inf for none), `normal` (n, 3),
`bodies` and `material` (n).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.dynamics.fossen import rotation
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.layout import P, Q
from uwserver.physics.kernel.linear import dot

Array = Any  # numpy array inside compiled code

_FARTHEST = 1e30
"""m; the engine's numbers are float32."""
ROUNDING = 1e-6
"""What float32 cannot tell apart, as a part of the coordinates."""


@compiled
def look(
    origin: Array, direction: Array, limit: float, planes: Array, state: Array, carried: Array, sides: Array, distance: Array,
    normal: Array, bodies: Array, material: Array,
) -> None:  # fmt: skip
    """Begin an answer: half-spaces and moving solids of few triangles, looked at one by one.

    Args:
        origin, direction: (n, 3) of the rays in N.
        limit: m; farther things are not seen.
        planes, carried, sides: what there is, as `hit_rows` has it.
        state: (m, 13) of the bodies.
        distance, normal, bodies, material: the answer.
    """
    for i in range(len(distance)):
        distance[i] = math.inf
        normal[i, 0] = normal[i, 1] = normal[i, 2] = 0.0
        bodies[i] = material[i] = -1
    _meet_planes(origin, direction, limit, planes, distance, normal, bodies, material)
    _meet_bodies(origin, direction, limit, state, carried, sides, distance, normal, bodies, material)


@compiled
def _meet_planes(
    origin: Array, direction: Array, limit: float, planes: Array, distance: Array, normal: Array, bodies: Array, material: Array,
) -> None:  # fmt: skip
    """Hits on the outside of half-spaces."""
    for plane in planes:
        for i in range(len(origin)):
            approach = height = 0.0
            for j in range(3):
                approach += plane.normal[j] * direction[i, j]
                height += plane.normal[j] * (origin[i, j] - plane.point[j])
            if approach < 0.0 and height >= 0.0:
                reached = -height / approach
                if reached < distance[i] and reached <= limit:
                    distance[i] = reached
                    for j in range(3):
                        normal[i, j] = plane.normal[j]
                    bodies[i], material[i] = plane.body, plane.material


@compiled
def meet_level(
    height: float, direction: Array, limit: float, body: int, distance: Array, normal: Array, bodies: Array, material: Array,
) -> None:  # fmt: skip
    """Hits of rays that go up on the level `height` (m) above their common origin, seen from below; `body` is its material too."""
    for i in range(len(direction)):
        if direction[i, 2] < 0.0:
            reached = -height / direction[i, 2]
            if reached < distance[i] and reached <= limit:
                distance[i] = reached
                normal[i, 0], normal[i, 1], normal[i, 2] = 0.0, 0.0, 1.0
                bodies[i] = material[i] = body


@compiled
def _face(sides: Array, first: int, count: int, origin: Array, facing: Array) -> int:
    """Which triangles can be seen from a point of their frame: rows of `facing` (count, 15) with the number of each, its plane's height, its
    normal, whether it has a hidden side, and the normals of the three planes through the point and its edges. Returns how many."""
    found = 0
    ox, oy, oz = origin[0], origin[1], origin[2]
    for t in range(first, first + count):
        side = sides[t]
        nx, ny, nz = side.normal[0], side.normal[1], side.normal[2]
        height = nx * (side.corners[0, 0] - ox) + ny * (side.corners[0, 1] - oy) + nz * (side.corners[0, 2] - oz)
        if side.sided != 0 and height > 0.0:
            continue
        row = facing[found]
        row[0], row[1], row[2], row[3], row[4], row[5] = t, height, nx, ny, nz, side.sided
        for k in range(3):
            m = (k + 1) % 3
            ax, ay, az = side.corners[k, 0] - ox, side.corners[k, 1] - oy, side.corners[k, 2] - oz
            bx, by, bz = side.corners[m, 0] - ox, side.corners[m, 1] - oy, side.corners[m, 2] - oz
            # Of two triangles that share an edge one has exactly the negative of the other: no ray slips through.
            row[6 + 3 * k], row[7 + 3 * k], row[8 + 3 * k] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        found += 1
    return found


@compiled
def _meet_bodies(
    origin: Array, direction: Array, limit: float, state: Array, carried: Array, sides: Array, distance: Array, normal: Array,
    bodies: Array, material: Array,
) -> None:  # fmt: skip
    """Hits on moving solids of few triangles, one by one; what cannot be seen from where a ray starts is left out once for all rays that
    start there."""
    R, away, start, d = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    facing = np.empty((len(sides), 15))
    for solid in carried:
        x = state[solid.row]
        rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
        radius, count, square, last = solid.radius, 0, 0.0, -1
        for i in range(len(origin)):
            if (
                last < 0
                or origin[i, 0] != origin[last, 0]
                or origin[i, 1] != origin[last, 1]
                or origin[i, 2] != origin[last, 2]
            ):
                last, count = i, 0
                for j in range(3):
                    away[j] = x[P + j] + dot(R[j], solid.centre) - origin[i, j]
                    start[j] = 0.0
                    for k in range(3):
                        start[j] += R[k, j] * (origin[i, k] - x[P + k])
                square = dot(away, away)
                if math.sqrt(square) - radius <= limit:
                    count = _face(sides, solid.first, solid.count, start, facing)
            if count == 0:
                continue
            along = away[0] * direction[i, 0] + away[1] * direction[i, 1] + away[2] * direction[i, 2]
            if along < -radius or square - along * along > radius * radius:
                continue
            for j in range(3):
                d[j] = R[0, j] * direction[i, 0] + R[1, j] * direction[i, 1] + R[2, j] * direction[i, 2]
            found = _nearest(d[0], d[1], d[2], facing, count, min(limit, distance[i]))
            if found >= 0:
                row = facing[found]
                approach = row[2] * d[0] + row[3] * d[1] + row[4] * d[2]
                sign = 1.0 if approach < 0.0 else -1.0
                distance[i] = row[1] / approach
                for j in range(3):
                    normal[i, j] = sign * (R[j, 0] * row[2] + R[j, 1] * row[3] + R[j, 2] * row[4])
                bodies[i], material[i] = solid.body, sides[int(row[0])].material


@compiled
def _nearest(x: float, y: float, z: float, facing: Array, count: int, limit: float) -> int:
    """The row of the nearest triangle that a ray of direction (x, y, z) meets within the limit; -1 for none."""
    found = -1
    for k in range(count):
        approach = facing[k, 2] * x + facing[k, 3] * y + facing[k, 4] * z
        if approach == 0.0 or (approach > 0.0 and facing[k, 5] != 0.0):
            continue
        reached = facing[k, 1] / approach
        if not 0.0 <= reached <= limit:
            continue
        u = facing[k, 6] * x + facing[k, 7] * y + facing[k, 8] * z
        v = facing[k, 9] * x + facing[k, 10] * y + facing[k, 11] * z
        w = facing[k, 12] * x + facing[k, 13] * y + facing[k, 14] * z
        if (u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0):
            found, limit = k, reached
    return found


@compiled
def enter(
    origin: Array, direction: Array, x: Array, centre: Array, half: Array, limit: float, distance: Array, R: Array, start: Array,
    towards: Array, rays: Array, engine: Array,
) -> int:  # fmt: skip
    """Bring rays that pass a box before what they have met so far into its frame, for the engine too.

    Args:
        x: (13) state that places the frame.
        centre, half: of the box in its frame; the engine's origin is the centre.
        R: (3, 3) receives the attitude of the frame.
        start, towards: (n, 3) receive origins, about the centre, and directions.
        rays: (n) receives their places in the answer.
        engine: (n, 7) receives origins, directions and limits in float32.

    Returns:
        How many.
    """
    rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
    count = 0
    for i in range(len(origin)):
        near, far = 0.0, min(limit, distance[i])
        slack = 0.0
        for j in range(3):
            s = d = 0.0
            for k in range(3):
                s += R[k, j] * (origin[i, k] - x[P + k])
                d += R[k, j] * direction[i, k]
            s -= centre[j]
            start[count, j], towards[count, j] = s, d
            slack = max(slack, ROUNDING * (abs(s) + half[j]))
        for j in range(3):
            s, d, edge = start[count, j], towards[count, j], half[j] + slack
            if d != 0.0:
                first, second = (-edge - s) / d, (edge - s) / d
                near, far = max(near, min(first, second)), min(far, max(first, second))
            elif abs(s) > edge:
                far = -1.0
        if not near <= far:
            continue
        for j in range(3):
            engine[count, j], engine[count, 3 + j] = start[count, j], towards[count, j]
        engine[count, 6] = min(far * (1.0 + ROUNDING) + 4.0 * slack, _FARTHEST)
        rays[count] = i
        count += 1
    return count


@compiled
def settle(
    origin: Array, direction: Array, rays: Array, picked: Array, start: Array, limit: float, sides: Array, owners: Array, R: Array,
    body: int, distance: Array, normal: Array, bodies: Array, material: Array, again: Array,
) -> int:  # fmt: skip
    """Hits on the triangles that the engine has picked.

    Args:
        origin, direction: (m, 3) of the rays in the frame of the triangles.
        rays: (m) their places in the answer.
        picked: (m) triangle of each, -1 for none.
        start: (m) where the engine began to look, m along the ray.
        sides: triangles, as `hit_rows.SIDE`.
        owners: (t) ids of what they belong to.
        R: (3, 3) turns a normal into N.
        body: id of what is hit; -1: the triangle's owner.
        again: (m) receives the rays (by number 0..m-1) that met a side which cannot be seen, and must look on behind it.

    Returns:
        How many must; `start` says from where.
    """
    count = 0
    for k in range(len(picked)):
        t = picked[k]
        if t < 0:
            continue
        side = sides[t]
        approach = dot(side.normal, direction[k])
        if approach == 0.0:
            continue
        height = 0.0
        for j in range(3):
            height += side.normal[j] * (side.corners[0, j] - origin[k, j])
        reached = height / approach
        if approach > 0.0 and side.sided != 0:
            start[k] = max(reached, start[k])
            again[count] = k
            count += 1
            continue
        i = rays[k]
        if not (0.0 <= reached < distance[i] and reached <= limit):
            continue
        distance[i] = reached
        sign = 1.0 if approach < 0.0 else -1.0
        for j in range(3):
            normal[i, j] = sign * dot(R[j], side.normal)
        bodies[i], material[i] = body if body >= 0 else owners[t], side.material
    return count
