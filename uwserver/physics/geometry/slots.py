"""Shapes as the compiled contact geometry has them: one SLOT row each, and the arrays that the rows refer to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.layout import Forms, columns

SPHERE, CAPSULE, CYLINDER, POLYHEDRON, HALF_SPACE, MESH = range(6)
"""Kinds of shapes; the first three are round about axis x."""

SLOT = np.dtype(
    [
        ("kind", "i8"),
        ("ident", "i8"),  # never used twice in a world, unlike the place in the array
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


class Shapes(NamedTuple):
    """All shapes of a world where they are, and what their rows refer to.

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
