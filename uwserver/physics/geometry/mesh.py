"""Which triangles of a mesh lie at a point or in a box, and what their common surface allows as a contact normal (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.linear import dot

AT_POINT = 32
"""Most triangles that may meet at one point."""


@compiled
def _span(low: float, high: float, origin: float, size: float, cells: int, axis: int, span: Array) -> None:
    """First and last cell of an interval along an axis, held inside the grid."""
    span[axis, 0] = min(max(math.floor((low - origin) / size), 0), cells - 1)
    span[axis, 1] = min(max(math.floor((high - origin) / size), 0), cells - 1)


@entry
def fill_cells(vertices: Array, faces: Array, origin: Array, size: float, cells: Array) -> tuple[Array, Array]:
    """Triangles by cell of a regular grid: `start` (cells + 1) and the triangle numbers between two starts."""
    count = cells[0] * cells[1] * cells[2]
    start = np.zeros(count + 1, np.int64)
    span = np.zeros((3, 2), np.int64)
    members = np.zeros(0, np.int64)
    filled = np.zeros(count, np.int64)
    for sweep in range(2):
        for k in range(len(faces)):
            for i in range(3):
                a, b, c = vertices[faces[k, 0], i], vertices[faces[k, 1], i], vertices[faces[k, 2], i]
                # A hair wider, so that a point on a border finds its triangle from both sides.
                low, high = min(a, b, c) - 1e-3 * size, max(a, b, c) + 1e-3 * size
                _span(low, high, origin[i], size, cells[i], i, span)
            for x in range(span[0, 0], span[0, 1] + 1):
                for y in range(span[1, 0], span[1, 1] + 1):
                    for z in range(span[2, 0], span[2, 1] + 1):
                        cell = (x * cells[1] + y) * cells[2] + z
                        if sweep == 0:
                            start[cell + 1] += 1
                        else:
                            members[start[cell] + filled[cell]] = k
                            filled[cell] += 1
        if sweep == 0:
            start = np.cumsum(start)
            members = np.zeros(start[count], np.int64)
    return start, members


@compiled
def any_triangle_in(shapes: Shapes, s: int, low: Array, high: Array) -> bool:
    """Whether the box around any triangle of the mesh in a slot meets the box from `low` to `high` (N)."""
    slot, cell_start = shapes.slots[s], shapes.cell_start
    span = np.zeros((3, 2), np.int64)
    for i in range(3):
        if high[i] < slot.centre[i] - slot.half[i] or low[i] > slot.centre[i] + slot.half[i]:
            return False
        _span(low[i], high[i], slot.cell_origin[i], slot.cell_size, slot.cells[i], i, span)
    for x in range(span[0, 0], span[0, 1] + 1):
        for y in range(span[1, 0], span[1, 1] + 1):
            for z in range(span[2, 0], span[2, 1] + 1):
                cell = slot.cell_first + (x * slot.cells[1] + y) * slot.cells[2] + z
                for m in range(cell_start[cell], cell_start[cell + 1]):
                    if _boxes_meet(shapes.triangles[shapes.cell_triangles[m]], shapes.vertices, low, high):
                        return True
    return False


@compiled
def _boxes_meet(triangle: Array, vertices: Array, low: Array, high: Array) -> bool:
    for i in range(3):
        a, b, c = vertices[triangle[0], i], vertices[triangle[1], i], vertices[triangle[2], i]
        if min(a, b, c) > high[i] or max(a, b, c) < low[i]:
            return False
    return True


@compiled
def distance_to_triangle(x: Array, a: Array, b: Array, c: Array) -> float:
    """Distance (m) of a point from a triangle. Ericson, Real-Time Collision Detection (2005), 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (x[i] - a[i])
        d2 += ac * (x[i] - a[i])
        d3 += ab * (x[i] - b[i])
        d4 += ac * (x[i] - b[i])
        d5 += ab * (x[i] - c[i])
        d6 += ac * (x[i] - c[i])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v = w = 0.0  # nearest = a + v (b - a) + w (c - a)
    if d1 <= 0.0 and d2 <= 0.0:
        v = 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    square = 0.0
    for i in range(3):
        square += (x[i] - a[i] - v * (b[i] - a[i]) - w * (c[i] - a[i])) ** 2
    return math.sqrt(square)


@compiled
def triangles_at(shapes: Shapes, x: Array, near: float, found: Array) -> int:
    """Triangles of all meshes within `near` (m) of a point, into `found` (AT_POINT); tiles of one seabed so know their neighbours."""
    slots, vertices, triangles, cell_start = shapes.slots, shapes.vertices, shapes.triangles, shapes.cell_start
    count = 0
    span = np.zeros((3, 2), np.int64)
    for s in range(len(slots)):
        slot = slots[s]
        if slot.cells[0] == 0:
            continue
        inside = True
        for i in range(3):
            inside = inside and abs(x[i] - slot.centre[i]) <= slot.half[i] + near
            _span(x[i] - near, x[i] + near, slot.cell_origin[i], slot.cell_size, slot.cells[i], i, span)
        if not inside:
            continue
        for cx in range(span[0, 0], span[0, 1] + 1):
            for cy in range(span[1, 0], span[1, 1] + 1):
                for cz in range(span[2, 0], span[2, 1] + 1):
                    cell = slot.cell_first + (cx * slot.cells[1] + cy) * slot.cells[2] + cz
                    for m in range(cell_start[cell], cell_start[cell + 1]):
                        k = shapes.cell_triangles[m]
                        known = False
                        for j in range(count):
                            known = known or found[j] == k
                        a, b, c = vertices[triangles[k, 0]], vertices[triangles[k, 1]], vertices[triangles[k, 2]]
                        if not known and count < AT_POINT and distance_to_triangle(x, a, b, c) <= near:
                            found[count] = k
                            count += 1
    return count


@compiled
def in_normal_cone(shapes: Shapes, x: Array, n: Array, found: Array, count: int) -> bool:
    """Whether n can be the outward normal of a contact on the surface at x, where the triangles found[:count] meet.

    It can if no neighbour rises above the plane through x: true on a ridge for all normals between those of its sides, false for any
    slanted normal on a flat or hollow edge, where a body would catch on nothing.
    """
    facing = 0.0
    for j in range(count):
        k = found[j]
        facing += dot(shapes.triangle_normals[k], n)
        for i in range(3):
            v = shapes.vertices[shapes.triangles[k, i]]
            dx, dy, dz = v[0] - x[0], v[1] - x[1], v[2] - x[2]
            if dx * n[0] + dy * n[1] + dz * n[2] > 2e-3 * math.sqrt(dx * dx + dy * dy + dz * dz) + 1e-6:
                return False
    return facing > 0.0
