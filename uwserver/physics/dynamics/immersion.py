"""Submerged volume, and its centre, of boxes and spheres that the water surface cuts (compiled).

Near a body the surface is a plane: z = 0 of N, or in waves the plane that touches the surface at the body (`layout.FLOW_PLANE`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.layout import FLOW_KIND, FLOW_PLANE, FLOW_T, WAVY

# Faces of a box as corner indices, counter-clockwise seen from outside; bit i of a corner's index selects the sign of axis i.
_FACES = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])


@compiled
def sphere_fraction(depth: float, radius: float, up: Array, offset: Array) -> float:
    """Return the submerged part of a sphere whose centre is `depth` (m, positive down) below the surface.

    `offset` (3) receives the centre of the submerged part relative to the sphere's centre, along `up` (3), the unit normal of the surface.
    Spherical cap of height h: V = pi h^2 (3r - h) / 3, centroid 3 (2r - h)^2 / (4 (3r - h)) from the centre.
    """
    offset[0] = offset[1] = offset[2] = 0.0
    if depth >= radius:
        return 1.0
    if depth <= -radius:
        return 0.0
    h = depth + radius
    fraction = h * h * (3.0 * radius - h) / (4.0 * radius**3)
    below = 3.0 * (2.0 * radius - h) ** 2 / (4.0 * (3.0 * radius - h))
    for i in range(3):
        offset[i] = -up[i] * below
    return fraction


@compiled
def box_fraction(depth: float, half: Array, up: Array, offset: Array) -> float:
    """Return the submerged part of a box whose centre is `depth` (m, positive down) below a plane surface; exact for any attitude.

    `half` (3) are the half edges, `up` (3) the surface's unit normal in the box's axes, `offset` (3) receives the centre of the submerged
    part relative to the box's centre. Divergence theorem over the clipped faces, with the apex of all tetrahedra on the water plane, so
    that the cut itself contributes nothing.
    """
    offset[0] = offset[1] = offset[2] = 0.0
    reach = abs(up[0]) * half[0] + abs(up[1]) * half[1] + abs(up[2]) * half[2]
    if depth >= reach:
        return 1.0
    if depth <= -reach:
        return 0.0
    ax, ay, az = up[0] * depth, up[1] * depth, up[2] * depth  # apex: the point of the plane above the centre
    volume = mx = my = mz = 0.0
    polygon = np.empty((8, 3))
    for face in range(6):
        n = _clip_face(face, half, up, depth, polygon)
        for k in range(1, n - 1):
            x0, y0, z0 = polygon[0, 0] - ax, polygon[0, 1] - ay, polygon[0, 2] - az
            x1, y1, z1 = polygon[k, 0] - ax, polygon[k, 1] - ay, polygon[k, 2] - az
            x2, y2, z2 = polygon[k + 1, 0] - ax, polygon[k + 1, 1] - ay, polygon[k + 1, 2] - az
            v = (x0 * (y1 * z2 - z1 * y2) + y0 * (z1 * x2 - x1 * z2) + z0 * (x1 * y2 - y1 * x2)) / 6.0
            volume += v
            mx += v * (x0 + x1 + x2) / 4.0
            my += v * (y0 + y1 + y2) / 4.0
            mz += v * (z0 + z1 + z2) / 4.0
    full = 8.0 * half[0] * half[1] * half[2]
    if volume <= 1e-15 * full:
        return 0.0
    offset[0], offset[1], offset[2] = ax + mx / volume, ay + my / volume, az + mz / volume
    return volume / full


@compiled
def _clip_face(face: int, half: Array, up: Array, depth: float, polygon: Array) -> int:
    """Write the part of a face below the plane up . x = depth to `polygon`, and return its number of corners (Sutherland and Hodgman)."""
    n = 0
    for k in range(4):
        a, b = _FACES[face, k], _FACES[face, (k + 1) % 4]
        a0 = half[0] if a & 1 else -half[0]
        a1 = half[1] if a & 2 else -half[1]
        a2 = half[2] if a & 4 else -half[2]
        b0 = half[0] if b & 1 else -half[0]
        b1 = half[1] if b & 2 else -half[1]
        b2 = half[2] if b & 4 else -half[2]
        above_a = up[0] * a0 + up[1] * a1 + up[2] * a2 - depth
        above_b = up[0] * b0 + up[1] * b1 + up[2] * b2 - depth
        if above_a <= 0.0:
            polygon[n, 0], polygon[n, 1], polygon[n, 2] = a0, a1, a2
            n += 1
        if (above_a < 0.0 < above_b) or (above_b < 0.0 < above_a):
            s = above_a / (above_a - above_b)
            polygon[n, 0] = a0 + s * (b0 - a0)
            polygon[n, 1] = a1 + s * (b1 - a1)
            polygon[n, 2] = a2 + s * (b2 - a2)
            n += 1
    return n


@compiled
def disc_fraction(depth: float, radius: float) -> float:
    """Return the submerged part of a vertical propeller disc of `radius` (m) whose hub is `depth` (m, positive down) below the surface."""
    if depth >= radius:
        return 1.0
    if depth <= -radius:
        return 0.0
    s = depth / radius
    return 0.5 + (math.asin(s) + s * math.sqrt(1.0 - s * s)) / math.pi


@compiled
def depth_below(flow: Array, x: float, y: float, z: float, t: float) -> float:
    """Return the distance (m, positive below) of a point in N from the plane of the surface at time t (s)."""
    if flow[FLOW_KIND] < WAVY:
        return z
    sx, sy = flow[FLOW_PLANE + 1], flow[FLOW_PLANE + 2]
    elevation = flow[FLOW_PLANE] + sx * x + sy * y + flow[FLOW_PLANE + 3] * (t - flow[FLOW_T])
    return (z + elevation) / math.sqrt(1.0 + sx * sx + sy * sy)


@compiled
def upward(flow: Array, R: Array, up: Array) -> None:
    """Write the unit normal of the surface, out of the water, in B to `up` (3); R (3, 3) is R_NB."""
    for i in range(3):
        up[i] = -R[2, i]
    if flow[FLOW_KIND] == WAVY:
        sx, sy = flow[FLOW_PLANE + 1], flow[FLOW_PLANE + 2]
        norm = math.sqrt(1.0 + sx * sx + sy * sy)
        for i in range(3):
            up[i] = (up[i] - sx * R[0, i] - sy * R[1, i]) / norm


@compiled
def immersion(body: Any, shapes: Array, depth: float, center: Array, scratch: Array) -> float:
    """Return the submerged fraction of a body's displaced volume, and write the centre of buoyancy in B to `center` (3).

    Args:
        body: a BODY record.
        shapes: all SHAPE records.
        depth: depth of the body origin below the plane of the surface, m.
        center: (3) out, m in B.
        scratch: (2, 3) the surface's unit normal in B (`upward`), and work space.
    """
    for i in range(3):
        center[i] = body.r_b[i]
    if body.shape_count == 0 or depth > body.radius:
        return 1.0
    up, offset = scratch[0], scratch[1]
    fraction = cx = cy = cz = 0.0
    for k in range(body.shape_first, body.shape_first + body.shape_count):
        shape = shapes[k]
        c = shape.center
        below = depth - (up[0] * c[0] + up[1] * c[1] + up[2] * c[2])
        if shape.kind == 0:
            f = box_fraction(below, shape.half, up, offset)
        else:
            f = sphere_fraction(below, shape.half[0], up, offset)
        w = f * shape.share
        fraction += w
        cx += w * (c[0] + offset[0])
        cy += w * (c[1] + offset[1])
        cz += w * (c[2] + offset[2])
    if fraction <= 0.0:
        return 0.0
    center[0], center[1], center[2] = cx / fraction, cy / fraction, cz / fraction
    return fraction
