"""Turns shapes of a scene into Foxglove's primitives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from uwserver.adapter.foxglove.codec import cube, cylinder, entity, model, sphere, triangles
from uwserver.frames import Quat, Vec3, multiply, rotate
from uwserver.ports import ModelFileView, ShapeView

Files = Callable[[str], bytes]
"""Returns the bytes for a hash; KeyError if the hash is not known."""

MOST_TRIANGLES = 100_000
"""Most triangles of a shape. Viewers in a browser stall with more, and the message would have megabytes, so larger meshes are simplified."""

_HALF = math.sqrt(0.5)
_Z_TO_X: Quat = (_HALF, 0.0, _HALF, 0.0)
"""Cylinders of uwserver lie along x, those of Foxglove stand along z."""
_Y_UP: Quat = (0.0, 1.0, 0.0, 0.0)
_Z_UP: Quat = (_HALF, _HALF, 0.0, 0.0)
"""Rotations from a file's frame to forward, right, down. Viewers assume that a glTF file has y up, as its standard says, and turn it to z up
themselves; these rotations continue from there."""
_PLANE_M, _PLANE_THICK_M = 400.0, 0.02
_CUBE, _SPHERE, _CYLINDER, _TRIANGLES, _MODEL = 8, 9, 10, 12, 14


def entity_of(
    t_ns: int,
    frame: str,
    name: str,
    shapes: Iterable[ShapeView],
    model_file: ModelFileView | None,
    meshes: Files,
    files: Files,
) -> bytes:
    """Encode a thing in its frame: its model if it has one, or else its shapes."""
    found: dict[int, list[bytes]] = {}
    if model_file is not None:
        q = multiply(model_file.q, _Y_UP if model_file.up == "y" else _Z_UP)
        found[_MODEL] = [model(model_file.p, q, model_file.scale, files(model_file.sha256))]
    else:
        for shape in shapes:
            for number, part in _primitives(shape, meshes):
                found.setdefault(number, []).append(part)
    return entity(t_ns, frame, name, found)


def _primitives(shape: ShapeView, meshes: Files) -> list[tuple[int, bytes]]:
    p, q, rgb = shape.p, shape.q, shape.colour
    if shape.kind == "box" and shape.size is not None:
        return [(_CUBE, cube(p, q, shape.size, rgb))]
    if shape.kind == "plane":
        down = rotate(q, (0.0, 0.0, 0.5 * _PLANE_THICK_M))
        return [(_CUBE, cube(_moved(p, down), q, (_PLANE_M, _PLANE_M, _PLANE_THICK_M), rgb))]
    if shape.kind == "mesh" and shape.mesh is not None:
        vertices, corners = _mesh(meshes(shape.mesh))
        return [(_TRIANGLES, triangles(p, q, vertices, corners, rgb))]
    if shape.radius is None:
        return []
    wide = 2.0 * shape.radius
    ball: Vec3 = (wide, wide, wide)
    if shape.kind == "sphere" or shape.length is None:
        return [(_SPHERE, sphere(p, q, ball, rgb))]
    parts = [(_CYLINDER, cylinder(p, multiply(q, _Z_TO_X), (wide, wide, shape.length), rgb))]
    if shape.kind == "capsule":
        for side in (-0.5, 0.5):
            parts.append((_SPHERE, sphere(_moved(p, rotate(q, (side * shape.length, 0.0, 0.0))), q, ball, rgb)))
    return parts


def _moved(p: Vec3, by: Vec3) -> Vec3:
    return p[0] + by[0], p[1] + by[1], p[2] + by[2]


def _mesh(
    packed: bytes,
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.float32]], np.ndarray[tuple[int, ...], np.dtype[np.uint32]]]:
    """Return vertices and triangles of a mesh as the web view gets it: u32 numbers of both, f32 vertices, u32 triangles."""
    n, m = np.frombuffer(packed, "<u4", 2).tolist()
    vertices = np.frombuffer(packed, "<f4", 3 * n, 8).reshape(n, 3)
    corners = np.frombuffer(packed, "<u4", 3 * m, 8 + 12 * n).reshape(m, 3)
    if m <= MOST_TRIANGLES:
        return vertices, corners
    return _coarser(vertices, corners)


def _coarser(
    vertices: np.ndarray[tuple[int, ...], np.dtype[np.float32]],
    corners: np.ndarray[tuple[int, ...], np.dtype[np.uint32]],
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.float32]], np.ndarray[tuple[int, ...], np.dtype[np.uint32]]]:
    """Return a mesh with fewer triangles.

    The vertices in a cell of a grid become one (Rossignac and Borrel 1993), and triangles without area are removed.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    edge = max(float((high - low).max()), 1e-6) / (MOST_TRIANGLES / 2.0) ** 0.5
    while True:
        place = np.floor((vertices - low) / edge).astype(np.int64)
        _, first, number = np.unique(place, axis=0, return_index=True, return_inverse=True)
        merged = number.reshape(-1)[corners].astype(np.uint32)
        a, b, c = merged.T
        kept = merged[(a != b) & (b != c) & (c != a)]
        if len(kept) <= MOST_TRIANGLES:
            return vertices[first], kept
        # This ends when the whole mesh is in one cell, at the latest.
        edge *= 1.2
