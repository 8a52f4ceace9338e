"""Exact hits of rays: on planes and small solids one by one, and on triangles that an engine has picked (compiled, float64).

All functions store in `raycast.Hits` the nearest hit of each ray that is not beyond a limit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import arrays_at
from uwserver.physics.kernel.layout import Forms, P, Q, columns
from uwserver.physics.kernel.linear import dot, rotation
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.rows import CARRIED, PLANE, SIDE, Simple

_FARTHEST = 1e30
"""m; a limit that float32, the type of the engine's numbers, can hold."""
ROUNDING = 1e-6
"""Rounding of float32, relative to the coordinates."""
UNKNOWN = -1


SIMPLE: Forms = {"planes": PLANE, "carried": CARRIED, "sides": SIDE}
"""The table of what is intersected one by one."""

_simple_at = arrays_at(Simple, SIMPLE)


@compiled
def miss(hits: Hits) -> None:
    """Begin an answer in which no ray hits anything."""
    for k in range(len(hits.distance)):
        hits.distance[k], hits.body[k], hits.material[k] = math.inf, -1, -1
        hits.normal[k, 0] = hits.normal[k, 1] = hits.normal[k, 2] = 0.0


@entry
def intersect_simple(
    table: Array, origin: Array, direction: Array, limit: float, state: Array, past: Array,
    distance: Array, normal: Array, body: Array, material: Array,
) -> None:  # fmt: skip
    """Begin an answer with the hits on half-spaces and on moving solids of few triangles, which are intersected one by one.

    Args:
        table: made by `SIMPLE`.
        origin, direction: (n, 3) of the rays in N.
        limit: m; farther things are not hit.
        state: (m, 13) of the bodies.
        past: (n) for each ray the row of a body whose solids it does not hit, or an empty array.
        distance, normal, body, material: of `Hits`, receive the answer.
    """
    begin(table, origin, direction, limit, state, past, Hits(distance, normal, body, material))


@compiled
def begin(table: Array, origin: Array, direction: Array, limit: float, state: Array, past: Array, hits: Hits) -> None:
    """Do what `intersect_simple` does, called from a kernel."""
    simple = _simple_at(table)
    miss(hits)
    _intersect_planes(origin, direction, limit, simple.planes, hits)
    _intersect_carried(origin, direction, limit, simple, state, past, hits)


@compiled
def record(
    hits: Hits, i: int, reached: float, approach: float, R: Array, normal: Array, body: int, material: int
) -> None:
    """Store a hit of ray i on a triangle whose normal (3) is given in a frame with the attitude R; the stored one points against the ray."""
    hits.distance[i] = reached
    sign = 1.0 if approach < 0.0 else -1.0
    for j in range(3):
        hits.normal[i, j] = sign * dot(R[j], normal)
    hits.body[i], hits.material[i] = body, material


@compiled
def _intersect_planes(origin: Array, direction: Array, limit: float, planes: Array, hits: Hits) -> None:
    """Find hits on the outside of half-spaces."""
    distance, normal = hits.distance, hits.normal
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
                    hits.body[i], hits.material[i] = plane.body, plane.material


@entry
def intersect_level(
    height: float,
    direction: Array,
    limit: float,
    level: int,
    distance: Array,
    normal: Array,
    body: Array,
    material: Array,
) -> None:
    """Find hits of rising rays on the level `height` (m) above their common origin, from below; `level` is its body and its material."""
    for i in range(len(direction)):
        if direction[i, 2] < 0.0:
            reached = -height / direction[i, 2]
            if reached < distance[i] and reached <= limit:
                distance[i] = reached
                normal[i, 0], normal[i, 1], normal[i, 2] = 0.0, 0.0, 1.0
                body[i] = material[i] = level


@compiled
def _facing(sides: Array, first: int, count: int, origin: Array, facing: Array) -> int:
    """Find the triangles that face a point of their frame (back-face culling).

    `facing` (count, 15) receives a row for each: its number, the height of its plane, its normal, whether it has a hidden side, and the normals of
    the three planes through the point and its edges. Return the number of rows.
    """
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
            # For two triangles that share an edge, these are exactly the negatives of each other. So no ray slips through.
            row[6 + 3 * k], row[7 + 3 * k], row[8 + 3 * k] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        found += 1
    return found


@compiled
def _intersect_carried(
    origin: Array, direction: Array, limit: float, simple: Simple, state: Array, past: Array, hits: Hits
) -> None:
    """Find hits on moving solids of few triangles, one by one. Triangles that do not face the start of a ray are excluded once for all rays that
    start there, as soon as one of them comes near: few of the rays of a swarm do."""
    carried, sides, distance = simple.carried, simple.sides, hits.distance
    R, middle, away, start, d = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    facing = np.empty((len(sides), 15))
    for solid in carried:
        x = state[solid.row]
        rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
        for j in range(3):
            middle[j] = x[P + j] + dot(R[j], solid.centre)
        radius, count, square, last = solid.radius, 0, 0.0, -1
        for i in range(len(origin)):
            if len(past) > 0 and past[i] == solid.row:
                continue
            if (
                last < 0
                or origin[i, 0] != origin[last, 0]
                or origin[i, 1] != origin[last, 1]
                or origin[i, 2] != origin[last, 2]
            ):
                last, count = i, UNKNOWN
                for j in range(3):
                    away[j] = middle[j] - origin[i, j]
                square = dot(away, away)
            if count == 0 or math.sqrt(square) - radius > limit:
                continue
            along = away[0] * direction[i, 0] + away[1] * direction[i, 1] + away[2] * direction[i, 2]
            if along < -radius or square - along * along > radius * radius:
                continue
            if count == UNKNOWN:
                for j in range(3):
                    start[j] = 0.0
                    for k in range(3):
                        start[j] += R[k, j] * (origin[i, k] - x[P + k])
                count = _facing(sides, solid.first, solid.count, start, facing)
            for j in range(3):
                d[j] = R[0, j] * direction[i, 0] + R[1, j] * direction[i, 1] + R[2, j] * direction[i, 2]
            found = _nearest(d[0], d[1], d[2], facing, count, min(limit, distance[i]))
            if found >= 0:
                row = facing[found]
                approach = row[2] * d[0] + row[3] * d[1] + row[4] * d[2]
                record(hits, i, row[1] / approach, approach, R, row[2:5], solid.body, sides[int(row[0])].material)


@compiled
def _nearest(x: float, y: float, z: float, facing: Array, count: int, limit: float) -> int:
    """Return the row of the nearest triangle that a ray of direction (x, y, z) meets within the limit; -1 for none."""
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


class Batch(NamedTuple):
    """The triangles of an engine, and the rays that go to it.

    Attributes:
        sides: (t) triangles, SIDE.
        owners: (t) ids of the solids to which they belong.
        box: (2, 3) centre and half sizes of the box around them in their frame; the engine's origin is the centre.
        R: (3, 3) attitude of that frame in N.
        start, towards: (n, 3) origins of the rays in it, about the centre, and directions.
        rays: (n) their places in the answer.
        ahead: (n) distance along the ray from which the engine begins, m.
        engine: (n, 7) origins, directions and limits in float32.
    """

    sides: Array
    owners: Array
    box: Array
    R: Array
    start: Array
    towards: Array
    rays: Array
    ahead: Array
    engine: Array


BATCH: Forms = {
    "sides": SIDE,
    "owners": columns(np.int64),
    "box": columns(np.float64, 3),
    "R": columns(np.float64, 3),
    "start": columns(np.float64, 3),
    "towards": columns(np.float64, 3),
    "rays": columns(np.int64),
    "ahead": columns(np.float64),
    "engine": columns(np.float32, 7),
}

_batch_at = arrays_at(Batch, BATCH)


@compiled
def bring(
    origin: Array, direction: Array, x: Array, R: Array, centre: Array, half: Array, start: Array, towards: Array
) -> float:
    """Transform a ray to the frame of a surface.

    Args:
        origin, direction: (3) of the ray in N.
        x, R: (13) state that places the frame, and its attitude.
        centre, half: (3) of the box around the surface.
        start, towards: (3) out, about the centre.

    Returns:
        The distance from the box at which a ray may still hit its content, because of the rounding of float32, m.
    """
    slack = 0.0
    for j in range(3):
        s = d = 0.0
        for k in range(3):
            s += R[k, j] * (origin[k] - x[P + k])
            d += R[k, j] * direction[k]
        s -= centre[j]
        start[j], towards[j] = s, d
        slack = max(slack, ROUNDING * (abs(s) + half[j]))
    return slack


@compiled
def enters(start: Array, towards: Array, half: Array, slack: float, limit: float) -> float:
    """Return the distance (m) up to which a ray is in a box; -1 if it does not pass the box within the limit (the slab test)."""
    near, far = 0.0, limit
    for j in range(3):
        s, d, edge = start[j], towards[j], half[j] + slack
        if d != 0.0:
            first, second = (-edge - s) / d, (edge - s) / d
            near, far = max(near, min(first, second)), min(far, max(first, second))
        elif abs(s) > edge:
            far = -1.0
    return far if near <= far else -1.0


@compiled
def met_side(side: Any, start: Array, towards: Array) -> tuple[float, float]:
    """Return the component of a ray's direction along the outward normal of a triangle, 0 if the ray runs along its plane, and the distance at
    which it meets the plane."""
    approach, height = dot(side.normal, towards), 0.0
    if approach == 0.0:
        return 0.0, math.inf
    for j in range(3):
        height += side.normal[j] * (side.corners[0, j] - start[j])
    return approach, height / approach


@entry
def select_rays(table: Array, origin: Array, direction: Array, limit: float, x: Array, distance: Array) -> int:
    """Transform the rays that pass a box, before their present hits, to its frame.

    Args:
        table: made by `BATCH`; receives the rays.
        origin, direction, limit: those of the rays, in N.
        x: (13) state that places the frame.
        distance: (n) of their present hits.

    Returns:
        The number of these rays.
    """
    batch = _batch_at(table)
    R, start, towards, engine, centre, half = (
        batch.R,
        batch.start,
        batch.towards,
        batch.engine,
        batch.box[0],
        batch.box[1],
    )
    rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)
    count = 0
    for i in range(len(origin)):
        slack = bring(origin[i], direction[i], x, R, centre, half, start[count], towards[count])
        far = enters(start[count], towards[count], half, slack, min(limit, distance[i]))
        if far < 0.0:
            continue
        for j in range(3):
            engine[count, j], engine[count, 3 + j] = start[count, j], towards[count, j]
        engine[count, 6] = min(far * (1.0 + ROUNDING) + 4.0 * slack, _FARTHEST)
        batch.rays[count], batch.ahead[count] = i, 0.0
        count += 1
    return count


@entry
def refine(
    table: Array, picked: Array, limit: float, body: int, distance: Array, normal: Array, bodies: Array, material: Array
) -> int:
    """Compute exact hits on the triangles that the engine has picked.

    Args:
        table: made by `BATCH`. Rays that ray_targets a hidden side must continue behind it: they move to the front of the batch.
        picked: (m) triangle of each ray, -1 for none.
        limit: m; farther things are not hit.
        body: id of what is hit; -1: the triangle's owner.
        distance, normal, bodies, material: of `Hits`, in and out.

    Returns:
        The number of rays that must continue; `ahead` says from where.
    """
    batch, hits = _batch_at(table), Hits(distance, normal, bodies, material)
    start, towards = batch.start, batch.towards
    count = 0
    for k in range(len(picked)):
        t = picked[k]
        if t < 0:
            continue
        side, i = batch.sides[t], batch.rays[k]
        approach, reached = met_side(side, start[k], towards[k])
        if approach == 0.0:
            continue
        if approach > 0.0 and side.sided != 0:
            batch.ahead[count], batch.rays[count] = max(reached, batch.ahead[k]), i
            for j in range(3):
                start[count, j], towards[count, j] = start[k, j], towards[k, j]
            count += 1
            continue
        if not (0.0 <= reached < distance[i] and reached <= limit):
            continue
        owner = body if body >= 0 else batch.owners[t]
        record(hits, i, reached, approach, batch.R, side.normal, owner, side.material)
    return count
