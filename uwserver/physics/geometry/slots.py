"""Shapes as rows for the compiled contact geometry, and their faces, edges and corners in a direction (compiled).

A shape is a SLOT row at P (3) with attitude R (3, 3) in N. Directions are unit vectors in N.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.layout import Forms, columns
from uwserver.physics.kernel.linear import dot

SPHERE, CAPSULE, CYLINDER, POLYHEDRON, HALF_SPACE, MESH = range(6)
"""Kinds of shapes. The first three are round about their axis x."""

SLOT = np.dtype(
    [
        ("kind", "i8"),
        ("ident", "i8"),  # identifies the shape in keys of contacts, unlike its place in the array
        ("row", "i8"),  # of the body in the state array; -1: static
        ("solid", "i8"),
        ("p", "f8", (3,)),  # of the shape in its solid
        ("R", "f8", (3, 3)),
        ("q", "f8", (4,)),  # w x y z of the engine's shape in the solid
        ("radius", "f8"),
        ("half_length", "f8"),
        ("centre", "f8", (3,)),  # of the box around the shape, in the shape's frame
        ("half", "f8", (3,)),
        ("vertex_first", "i8"),
        ("vertex_count", "i8"),
        ("face_first", "i8"),  # polyhedron: faces; mesh: triangles
        ("face_count", "i8"),
        ("cell_first", "i8"),  # mesh: its grid of cells
        ("cell_origin", "f8", (3,)),
        ("cell_size", "f8"),
        ("cells", "i8", (3,)),
        ("oriented", "i8"),
        ("friction", "f8"),
        ("restitution", "f8"),
    ],
    align=True,
)
RING = 64
"""Most corners of a face."""
RIM = 16
"""Number of corners that represent the rim of a cylinder."""
_END_ON = 0.7
"""Cosine between axis and direction above which a cylinder or capsule shows its end instead of its side."""


class Shapes(NamedTuple):
    """All shapes of a world at their present places, and the arrays to which their rows refer.

    Attributes:
        slots: (n) SLOT.
        P, R: (n, 3) and (n, 3, 3) poses in N.
        vertices: (v, 3) of polyhedra, each in its own frame, and of static meshes, in N.
        face_normals, face_start, face_vertices: (f, 3) outward, in the shape's frame; corners of face k are
            face_vertices[face_start[k]:face_start[k + 1]], counter-clockwise from outside.
        triangles, triangle_normals: (t, 3) vertex numbers of meshes; in N.
        cell_start, cell_triangles: likewise triangles of each cell of the meshes' grids.
    """

    slots: Array
    P: Array
    R: Array
    vertices: Array
    face_normals: Array
    face_start: Array
    face_vertices: Array
    triangles: Array
    triangle_normals: Array
    cell_start: Array
    cell_triangles: Array


SHAPES: Forms = {
    "slots": SLOT,
    "P": columns(np.float64, 3),
    "R": columns(np.float64, 3, 3),
    "vertices": columns(np.float64, 3),
    "face_normals": columns(np.float64, 3),
    "face_start": columns(np.int64),
    "face_vertices": columns(np.int64),
    "triangles": columns(np.int64, 3),
    "triangle_normals": columns(np.float64, 3),
    "cell_start": columns(np.int64),
    "cell_triangles": columns(np.int64),
}


@compiled
def support_face(slot: Any, R: Array, d: Array, face_normals: Array, normal: Array) -> float:
    """Find the plane face that points along d most, and write its outward normal to `normal` (3). Return the cosine between the two; -2 for a
    round shape."""
    if slot.kind == CYLINDER:
        cosine = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
        for i in range(3):
            normal[i] = R[i, 0] if cosine >= 0.0 else -R[i, 0]
        return float(abs(cosine))
    if slot.kind != POLYHEDRON:
        return -2.0
    best = _face_along(slot, R, d, face_normals)
    for i in range(3):
        normal[i] = dot(R[i], face_normals[best])
    return dot(normal, d)


@compiled
def _face_along(slot: Any, R: Array, d: Array, face_normals: Array) -> int:
    dx = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
    dy = R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]
    dz = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
    best, most = slot.face_first, -2.0
    for f in range(slot.face_first, slot.face_first + slot.face_count):
        cosine = face_normals[f, 0] * dx + face_normals[f, 1] * dy + face_normals[f, 2] * dz
        if cosine > most + 1e-12:  # of equal ones take the first, whatever the rounding
            best, most = f, cosine
    return int(best)


@compiled
def support_feature(shapes: Shapes, s: int, d: Array, ring: Array, codes: Array) -> int:
    """Find the feature of the shape in a slot that points along d: the corners of a face (counter-clockwise from outside), the ends of a line, or one
    point, and write it to `ring`.

    `codes` receives a number for each corner that stays the same from tick to tick. Return the number of corners.
    """
    slot, P, R = shapes.slots[s], shapes.P[s], shapes.R[s]
    if slot.kind == POLYHEDRON:
        f, face_start = _face_along(slot, R, d, shapes.face_normals), shapes.face_start
        count = min(face_start[f + 1] - face_start[f], RING)
        for k in range(count):
            v = shapes.face_vertices[face_start[f] + k]
            codes[k] = v - slot.vertex_first
            for i in range(3):
                ring[k, i] = P[i] + dot(R[i], shapes.vertices[v])
        return int(count)
    cosine = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
    if slot.kind == CYLINDER and abs(cosine) > _END_ON:
        return _rim(slot, P, R, d, cosine, ring, codes)
    ends = slot.kind != SPHERE and abs(cosine) <= _END_ON
    count = 2 if ends else 1
    across = math.sqrt(max(1.0 - cosine * cosine, 1e-30))
    for k in range(count):
        along = 0.0 if slot.kind == SPHERE else slot.half_length
        if (k == 1) if ends else (cosine < 0.0):
            along = -along
        codes[k] = k
        for i in range(3):
            # The end of a capsule is a ball. The lowest line on the side of a cylinder lies perpendicular to the axis.
            out = (d[i] - cosine * R[i, 0]) / across if slot.kind == CYLINDER else d[i]
            ring[k, i] = P[i] + along * R[i, 0] + slot.radius * out
    return count


@compiled
def _rim(slot: Any, P: Array, R: Array, d: Array, cosine: float, ring: Array, codes: Array) -> int:
    """Write corners on the rim of a cylinder's end. The first is the one that reaches farthest along d, or on the cylinder's own axis y if the end
    lies flat."""
    y = R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]
    z = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
    # A pure function can have no hysteresis. Below this tilt the rim is flat to 1e-3 of the radius.
    first = math.atan2(z, y) if y * y + z * z > 1e-6 else 0.0
    end = slot.half_length if cosine >= 0.0 else -slot.half_length
    for k in range(RIM):
        angle = first + (k if cosine >= 0.0 else -k) * 2.0 * math.pi / RIM
        c, s = slot.radius * math.cos(angle), slot.radius * math.sin(angle)
        codes[k] = k
        for i in range(3):
            ring[k, i] = P[i] + end * R[i, 0] + c * R[i, 1] + s * R[i, 2]
    return RIM


@compiled
def support(slot: Any, P: Array, R: Array, d: Array, vertices: Array) -> float:
    """Return the support function of a convex shape: the largest x . d over all its points x."""
    base = P[0] * d[0] + P[1] * d[1] + P[2] * d[2]
    cosine = R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]
    if slot.kind == SPHERE:
        return float(base + slot.radius)
    if slot.kind == CAPSULE:
        return float(base + abs(cosine) * slot.half_length + slot.radius)
    if slot.kind == CYLINDER:
        return float(base + abs(cosine) * slot.half_length + slot.radius * math.sqrt(max(1.0 - cosine * cosine, 0.0)))
    dy = R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]
    dz = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
    most = -1e300
    for v in range(slot.vertex_first, slot.vertex_first + slot.vertex_count):
        most = max(most, vertices[v, 0] * cosine + vertices[v, 1] * dy + vertices[v, 2] * dz)
    return float(base + most)
