"""Exact hits of rays whose triangles an engine has picked (compiled, float64)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.compiled import compiled

Array = Any  # numpy array inside compiled code


@compiled
def settle(
    origin: Array, direction: Array, rays: Array, picked: Array, start: Array, corners: Array, sided: Array, R: Array,
    body: int, owners: Array, materials: Array, distance: Array, normal: Array, bodies: Array, material: Array, again: Array,
) -> int:  # fmt: skip
    """Keep the hits that are nearer than what each ray has met so far.

    Args:
        origin, direction: (m, 3) of the rays in the frame of the triangles.
        rays: (m) their places in the answer.
        picked: (m) triangle of each, -1 for none.
        start: (m) where the engine began to look, m along the ray.
        corners: (t, 3, 3); sided, owners, materials: (t).
        body: id of what is hit; -1: the triangle's owner.
        R: (3, 3) turns a normal into N.
        distance, normal, bodies, material: the answer, filled in.
        again: (m) receives the rays (by number 0..m-1) that met a side which cannot be seen, and must look on behind it.

    Returns:
        How many must; `start` says from where.
    """
    count = 0
    for k in range(len(picked)):
        t = picked[k]
        if t < 0:
            continue
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        approach = nx * direction[k, 0] + ny * direction[k, 1] + nz * direction[k, 2]
        if approach == 0.0:
            continue
        height = nx * (a[0] - origin[k, 0]) + ny * (a[1] - origin[k, 1]) + nz * (a[2] - origin[k, 2])
        reached = height / approach
        if approach > 0.0 and sided[t] != 0:
            start[k] = max(reached, start[k])
            again[count] = k
            count += 1
            continue
        i = rays[k]
        if reached < 0.0 or reached >= distance[i]:
            continue
        scale = (1.0 if approach < 0.0 else -1.0) / math.sqrt(nx * nx + ny * ny + nz * nz)
        distance[i] = reached
        for j in range(3):
            normal[i, j] = scale * (R[j, 0] * nx + R[j, 1] * ny + R[j, 2] * nz)
        bodies[i], material[i] = body if body >= 0 else owners[t], materials[t]
    return count


@compiled
def passing(origin: Array, direction: Array, centre: Array, radius: float, distance: Array, rays: Array) -> int:
    """Rays that pass within `radius` of a point before what they have met so far, into `rays` (n). Returns their count."""
    count = 0
    for i in range(len(origin)):
        along = square = 0.0
        for j in range(3):
            away = centre[j] - origin[i, j]
            along += away * direction[i, j]
            square += away * away
        if along < -radius or along - radius > distance[i] or square - along * along > radius * radius:
            continue
        rays[count] = i
        count += 1
    return count


@compiled
def meet_plane(
    origin: Array, direction: Array, point: Array, normal: Array, body: int, number: int, distance: Array, normals: Array,
    bodies: Array, material: Array,
) -> None:  # fmt: skip
    """Keep the hits on the outside of a half-space through `point` with the outward `normal`."""
    for i in range(len(origin)):
        approach = height = 0.0
        for j in range(3):
            approach += normal[j] * direction[i, j]
            height += normal[j] * (origin[i, j] - point[j])
        if approach < 0.0 and height >= 0.0 and -height / approach < distance[i]:
            distance[i] = -height / approach
            for j in range(3):
                normals[i, j] = normal[j]
            bodies[i], material[i] = body, number
