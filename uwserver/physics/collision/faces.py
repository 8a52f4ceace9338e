"""Finds the line of shapes that lie on a face of another, or at most a millimetre deep in it, without a search (compiled).

Almost all contacts at rest are of this kind, and their line is the normal of the face: for convex shapes that just overlap the best of the normals of
their faces, for a triangle its own. The result is as exact as the shapes. All other cases are left to `directions`.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.collision.cores import FAR, Cores, core_radius, farthest
from uwserver.physics.collision.manifold import FLAT, Work, clip, cut_by_triangle
from uwserver.physics.geometry.slots import (
    CAPSULE,
    CYLINDER,
    POLYHEDRON,
    Shapes,
    support,
    support_face,
    support_feature,
)
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import dot

SHALLOW = -1e-3
"""m; a shape that is no deeper than this in a face, along its normal, leaves it along the normal."""
_LEVEL = 3e-3
"""Cosine between the axis of a round shape and a normal below which the shape lies on its side; as `FLAT`."""
_MOST = 4096
"""Largest product of corners and faces. For larger pairs the search for the best face would take longer than an engine."""


@compiled
def triangle_side(shapes: Shapes, a: int, b: int, triangle: int, n: Array) -> None:
    """Write to n (3) the normal of a triangle: outward, or towards the middle of shape a if the mesh is a sheet."""
    height = 0.0
    for i in range(3):
        x = shapes.P[a, i] + dot(shapes.R[a, i], shapes.slots[a].centre)
        n[i] = shapes.triangle_normals[triangle, i]
        height += (x - shapes.vertices[shapes.triangles[triangle, 0], i]) * n[i]
    if height < 0.0 and shapes.slots[b].oriented == 0:
        for i in range(3):
            n[i] = -n[i]


@compiled
def _lowest_over(shapes: Shapes, s: int, cuts: int, t: Array, cores: Cores, work: Work, x: Array) -> float:
    """Find the lowest point x (3) of a shape over the feature that cuts, whose outward normal is t. Return its height (m); FAR if no point is over
    it."""
    slot, R, ring, d = shapes.slots[s], shapes.R[s], work.ring, cores.trial
    for i in range(3):
        d[i] = -t[i]
    flat = support_face(slot, R, d, shapes.face_normals, work.face) >= FLAT
    if slot.kind == CYLINDER or slot.kind == CAPSULE:
        flat = flat or abs(R[0, 0] * t[0] + R[1, 0] * t[1] + R[2, 0] * t[2]) < _LEVEL
    size = 1
    if flat:
        size = support_feature(shapes, s, d, ring, work.codes)
    else:
        farthest(shapes, s, cores.corners, 0, 1.0, d, x)
        radius = core_radius(shapes, s, 0)
        for i in range(3):
            ring[0, i] = x[i] - radius * t[i]
    low, size = FAR, clip(work, size, cuts, t)
    for k in range(size):
        height = dot(ring[k], t) - dot(work.cut[0], t)
        if height < low:
            low = height
            for i in range(3):
                x[i] = ring[k, i]
    return low


@compiled
def _gap_along(shapes: Shapes, s: int, n: Array, origin: Array, d: Array) -> float:
    """Return the distance (m) of a shape beyond the plane through `origin` with the normal n; d (3) is work space."""
    for i in range(3):
        d[i] = -n[i]
    return -support(shapes.slots[s], shapes.P[s], shapes.R[s], d, shapes.vertices) - dot(origin, n)


@compiled
def _is_beside(shapes: Shapes, s: int, reach: float, t: Array, cores: Cores, work: Work) -> bool:
    """Return whether a shape is farther than reach (m) beyond a side of the triangle that cuts, whose normal is t."""
    cut, across = work.cut, work.face
    for e in range(3):
        f = (e + 1) % 3
        x, y, z = cut[f, 0] - cut[e, 0], cut[f, 1] - cut[e, 1], cut[f, 2] - cut[e, 2]
        across[0], across[1], across[2] = y * t[2] - z * t[1], z * t[0] - x * t[2], x * t[1] - y * t[0]
        length = math.sqrt(dot(across, across))
        for i in range(3):
            across[i] /= length
        if _gap_along(shapes, s, across, cut[e], cores.trial) > reach:
            return True
    return False


@compiled
def over_triangle(
    shapes: Shapes, a: int, b: int, triangle: int, reach: float, cores: Cores, work: Work, line: Array
) -> int:
    """Find the line between a shape and a triangle if it lies along the triangle's normal. Return 1 if so, 0 if they are farther apart than reach
    (m).

    Return -1 if only a search can find the line.
    """
    n, x = line[:3], line[3:6]
    triangle_side(shapes, a, b, triangle, n)
    cut_by_triangle(shapes, triangle, n, work)
    gap = _gap_along(shapes, a, n, work.cut[0], cores.trial)
    if gap > reach or _is_beside(shapes, a, reach, n, cores, work):
        return 0
    if gap < SHALLOW:
        return -1
    gap = _lowest_over(shapes, a, 3, n, cores, work, x)
    if gap == FAR:
        return -1
    for i in range(3):
        x[i] -= gap * n[i]
    line[6] = gap
    return 1 if gap <= reach else 0


@compiled
def _best_face(shapes: Shapes, owner: int, other: int, normal: Array) -> float:
    """Find the face of a shape along whose outward normal (3) another shape is least deep in it. Return their gap along it; -FAR if the shape has
    no face."""
    slot, P, R = shapes.slots[owner], shapes.P[owner], shapes.R[owner]
    best, t = -FAR, np.empty(3)
    count = 2 if slot.kind == CYLINDER else (slot.face_count if slot.kind == POLYHEDRON else 0)
    for k in range(count):
        f = slot.face_first + k
        offset = slot.half_length
        if slot.kind == CYLINDER:
            for i in range(3):
                t[i] = R[i, 0] if k == 0 else -R[i, 0]
        else:
            for i in range(3):
                t[i] = dot(R[i], shapes.face_normals[f])
            offset = dot(shapes.face_normals[f], shapes.vertices[shapes.face_vertices[shapes.face_start[f]]])
        gap = -support(shapes.slots[other], shapes.P[other], shapes.R[other], -t, shapes.vertices) - offset - dot(P, t)
        if gap > best + 1e-12:  # of equal ones take the first, whatever the rounding
            best = gap
            for i in range(3):
                normal[i] = t[i]
    return best


@compiled
def out_of_face(shapes: Shapes, a: int, b: int, cores: Cores, work: Work, line: Array) -> bool:
    """Find the line between two convex shapes that just overlap, if it lies along the normal of a face that the other shape is over."""
    slots, t = shapes.slots, work.t
    size_a, size_b = slots[a].vertex_count * slots[b].face_count, slots[b].vertex_count * slots[a].face_count
    if size_a > _MOST or size_b > _MOST:
        return False
    n, x = line[:3], line[3:6]
    of_b, of_a = _best_face(shapes, b, a, n), _best_face(shapes, a, b, t)
    plane_of_b = of_b >= of_a - 1e-9
    gap = of_b if plane_of_b else of_a
    if gap < SHALLOW:
        return False
    if plane_of_b:
        for i in range(3):
            t[i] = n[i]
    owner, other = (b, a) if plane_of_b else (a, b)
    cuts = support_feature(shapes, owner, t, work.cut, work.cut_codes)
    height = _lowest_over(shapes, other, cuts, t, cores, work, x)
    if height == FAR:
        return False
    for i in range(3):
        n[i] = t[i] if plane_of_b else -t[i]
        if plane_of_b:
            x[i] -= height * t[i]
    line[6] = gap
    return True
