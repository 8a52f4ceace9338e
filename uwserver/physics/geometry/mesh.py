"""Finds the triangles of a mesh at a point or in a box, and decides which contact normals their common surface allows (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.geometry.slots import Shapes
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.linear import dot, triangle_weights

AT_POINT = 32
"""Most triangles that may meet at one point."""


@compiled
def _span(low: float, high: float, origin: float, size: float, cells: int, axis: int, span: Array) -> None:
    """Write the first and last cell of an interval along an axis to span[axis]; both are limited to the grid."""
    span[axis, 0] = min(max(math.floor((low - origin) / size), 0), cells - 1)
    span[axis, 1] = min(max(math.floor((high - origin) / size), 0), cells - 1)


@entry
def fill_cells(vertices: Array, faces: Array, origin: Array, size: float, cells: Array) -> tuple[Array, Array]:
    """Sort triangles into the cells of a regular grid. Return `start` (cells + 1) and the triangle numbers: those of cell k stand between start[k]
    and start[k + 1]."""
    count = cells[0] * cells[1] * cells[2]
    start = np.zeros(count + 1, np.int64)
    span = np.zeros((3, 2), np.int64)
    members = np.zeros(0, np.int64)
    filled = np.zeros(count, np.int64)
    for sweep in range(2):
        for k in range(len(faces)):
            for i in range(3):
                a, b, c = vertices[faces[k, 0], i], vertices[faces[k, 1], i], vertices[faces[k, 2], i]
                # Slightly wider, so that a point on the border of a cell finds its triangle from both sides.
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
    """Return whether the box around any triangle of the mesh in a slot overlaps the box from `low` to `high` (N)."""
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
def triangles_in(shapes: Shapes, s: int, low: Array, high: Array, found: Array) -> int:
    """Find the triangles of the mesh in a slot whose boxes meet the box from `low` to `high` (N), each once, and write them to `found` as far as they
    fit. Return how many there are.

    A triangle stands in several cells. It is counted in the first of those that it shares with the box.
    """
    slot, start = shapes.slots[s], shapes.cell_start
    span, begin, here = np.zeros((3, 2), np.int64), np.zeros((3, 2), np.int64), np.empty(3, np.int64)
    count = 0
    for i in range(3):
        if high[i] < slot.centre[i] - slot.half[i] or low[i] > slot.centre[i] + slot.half[i]:
            return 0
        _span(low[i], high[i], slot.cell_origin[i], slot.cell_size, slot.cells[i], i, span)
    for cx in range(span[0, 0], span[0, 1] + 1):
        for cy in range(span[1, 0], span[1, 1] + 1):
            for cz in range(span[2, 0], span[2, 1] + 1):
                here[0], here[1], here[2] = cx, cy, cz
                cell = slot.cell_first + (cx * slot.cells[1] + cy) * slot.cells[2] + cz
                for m in range(start[cell], start[cell + 1]):
                    k = shapes.cell_triangles[m]
                    ours = True
                    for i in range(3):
                        p = shapes.vertices[shapes.triangles[k, 0], i]
                        q, r = shapes.vertices[shapes.triangles[k, 1], i], shapes.vertices[shapes.triangles[k, 2], i]
                        least, most = min(p, q, r), max(p, q, r)
                        ours = ours and least <= high[i] and most >= low[i]
                        # `fill_cells` widens triangles by as much.
                        wider = least - 1e-3 * slot.cell_size
                        _span(wider, wider, slot.cell_origin[i], slot.cell_size, slot.cells[i], i, begin)
                        ours = ours and here[i] == max(begin[i, 0], span[i, 0])
                    if ours:
                        if count < len(found):
                            found[count] = k
                        count += 1
    return count


@compiled
def distance_to_triangle(x: Array, a: Array, b: Array, c: Array) -> float:
    """Return the distance (m) of a point from a triangle."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (x[i] - a[i])
        d2 += ac * (x[i] - a[i])
        d3 += ab * (x[i] - b[i])
        d4 += ac * (x[i] - b[i])
        d5 += ab * (x[i] - c[i])
        d6 += ac * (x[i] - c[i])
    v, w = triangle_weights(d1, d2, d3, d4, d5, d6)
    square = 0.0
    for i in range(3):
        square += (x[i] - a[i] - v * (b[i] - a[i]) - w * (c[i] - a[i])) ** 2
    return math.sqrt(square)


@compiled
def triangles_at(shapes: Shapes, x: Array, near: float, found: Array) -> int:
    """Write the triangles of all meshes within `near` (m) of a point to `found` (AT_POINT), and return their number. As all meshes are searched,
    neighbours across the tiles of a seabed are found too."""
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
    """Return whether n can be the outward normal of a contact on the surface at x, where the triangles found[:count] meet.

    It can if no neighbour rises above the plane through x. This is true on a ridge for all normals between those of its sides, and false for any
    slanted normal on a flat or hollow edge, where a body must not get caught.
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
