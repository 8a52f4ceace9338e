"""From what an engine says of near pairs to contacts (compiled).

Of each pair Bullet gives the directions in which the shapes are nearest, or least inside each other. All else is computed here from the
exact shapes, in float64 and from the poses alone: the gap along that direction, without the engine's margins; the true normal, where the
direction is that of a face to within the engine's rounding; all points of two features that lie flat on each other, where the engine knows
one; and no contact where a body would catch on an edge inside a smooth surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.collision.manifold import (
    CANDIDATES,
    FULL,
    KEPT,
    NUMBERS,
    add_point,
    add_ring,
    clip,
    reduce,
    thin_out,
)
from uwserver.physics.geometry.mesh import AT_POINT, supported, triangles_at
from uwserver.physics.geometry.support import RING, best_face, reach_along, ring_along
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.linear import dot

Array = Any  # numpy array inside compiled code

ENGINE_MARGIN = 1e-3
"""m; Bullet's points on a mesh lie this far outside it, but for spheres."""
_FLAT = 1.0 - 5e-6
"""Cosine above which a direction is that of a face: 3 mrad, the engine's rounding in bad cases."""
_POINT = 1 << 33
"""Keys of single points, beside those of corners and crossings."""
_HALF_SPACE, _MESH = 4, 5  # as in solid_rows


@compiled
def _flat_on(
    slots: Array, Ps: Array, Rs: Array, a: int, b: int, n: Array, reach: float, shapes: Any, work: Any, count: int
) -> int:
    """Contacts of two convex shapes whose nearest direction n (b to a) is that of a face of one; none if it is of neither."""
    vertices, face_normals, face_start, face_vertices = shapes
    ring, codes, cut, cut_codes, contacts, keys, t, face = work
    d = -n
    of_a = best_face(slots[a], Rs[a], d, face_normals, t)
    of_b = best_face(slots[b], Rs[b], n, face_normals, face)
    if max(of_a, of_b) < _FLAT:
        return _line_on_line(slots, Ps, Rs, a, b, n, reach, shapes, work, count)
    plane_of_b = of_b >= of_a - 1e-9
    if plane_of_b:
        t[:] = face
    plane, other = (b, a) if plane_of_b else (a, b)
    cuts = ring_along(
        slots[plane], Ps[plane], Rs[plane], t, vertices, face_normals, face_start, face_vertices, cut, cut_codes
    )
    d = -t
    size = ring_along(
        slots[other], Ps[other], Rs[other], d, vertices, face_normals, face_start, face_vertices, ring, codes
    )
    size = clip(ring, codes, size, cut, cuts, t)
    return add_ring(ring, codes, size, cut[0], t, plane_of_b, 0, reach, contacts, keys, count)


@compiled
def _line_on_line(
    slots: Array, Ps: Array, Rs: Array, a: int, b: int, n: Array, reach: float, shapes: Any, work: Any, count: int
) -> int:
    """Contacts of two round sides whose lines run along each other."""
    vertices, face_normals, face_start, face_vertices = shapes
    ring, codes, cut, cut_codes, contacts, keys, _, _ = work
    if slots[a].kind > 2 or slots[b].kind > 2:
        return count
    d = -n
    size = ring_along(slots[a], Ps[a], Rs[a], d, vertices, face_normals, face_start, face_vertices, ring, codes)
    cuts = ring_along(slots[b], Ps[b], Rs[b], n, vertices, face_normals, face_start, face_vertices, cut, cut_codes)
    if size != 2 or cuts != 2:
        return count
    u, v = ring[1] - ring[0], cut[1] - cut[0]
    if dot(u, v) ** 2 < 0.999 * dot(u, u) * dot(v, v):
        return count
    size = clip(ring, codes, size, cut, cuts, n)
    return add_ring(ring, codes, size, cut[0], n, True, 0, reach, contacts, keys, count)


@compiled
def convex_pair(
    slots: Array, Ps: Array, Rs: Array, a: int, b: int, found: Array, reach: float, shapes: Any, work: Any
) -> int:
    """Contacts of two convex shapes from the engine's answer `found` (k, 7): normal (b to a), point on b, distance."""
    contacts, keys = work[4], work[5]
    count = 0
    for j in range(len(found)):
        n = found[j, :3].copy()
        count = _flat_on(slots, Ps, Rs, a, b, n, reach, shapes, work, count)
        deepest = 1e300
        for k in range(count):
            deepest = min(deepest, contacts[k, 6])
        top = reach_along(slots[b], Ps[b], Rs[b], n, shapes[0])
        gap = -reach_along(slots[a], Ps[a], Rs[a], -n, shapes[0]) - top
        # Features that miss each other leave the one point that the engine found.
        if gap <= reach and (count == 0 or gap < deepest - 1e-4):
            count = add_point(found[j, 3:6], n, top, gap, _POINT + j, contacts, keys, count)
    return count


@compiled
def space_pair(slots: Array, Ps: Array, Rs: Array, a: int, b: int, reach: float, shapes: Any, work: Any) -> int:
    """Contacts of a convex shape with a half-space, which needs no engine."""
    vertices, face_normals, face_start, face_vertices = shapes
    ring, codes, _, _, contacts, keys, t, _ = work
    for i in range(3):
        t[i] = -Rs[b, i, 2]
    d = -t
    size = ring_along(slots[a], Ps[a], Rs[a], d, vertices, face_normals, face_start, face_vertices, ring, codes)
    return add_ring(ring, codes, size, Ps[b], t, True, 0, reach, contacts, keys, 0)


@compiled
def mesh_pair(
    slots: Array, Ps: Array, Rs: Array, a: int, b: int, found: Array, reach: float, shapes: Any, mesh: Any, work: Any
) -> int:
    """Contacts of a convex shape with a mesh from the engine's answer `found` (k, 7), a line for each near triangle."""
    vertices = shapes[0]
    triangles, normals, cell_start, cell_triangles = mesh
    contacts, keys = work[4], work[5]
    here, done = np.empty(AT_POINT, np.int64), np.empty(256, np.int64)
    x, flip = np.empty(3), np.empty(3)
    count = known = 0
    last = slots[b].face_first + slots[b].face_count
    lift = 0.0 if slots[a].kind == 0 else ENGINE_MARGIN
    for j in range(len(found)):
        n = found[j, :3].copy()
        meeting = 0
        for attempt in range(2):  # in some cases it leaves its margin out
            if meeting == 0:
                for i in range(3):
                    x[i] = found[j, 3 + i] - (lift if attempt == 0 else 0.0) * n[i]
                meeting = triangles_at(slots, x, 2e-4, vertices, triangles, cell_start, cell_triangles, here)
        on_face = False
        for m in range(meeting):
            k = here[m]
            along = dot(normals[k], n)
            if abs(along) < _FLAT or k < slots[b].face_first or k >= last:
                continue
            on_face = True
            new = True
            for e in range(known):
                new = new and done[e] != k
            if not new:
                continue
            if known < len(done):
                done[known] = k
                known += 1
            sense = -1.0 if along < 0.0 and slots[b].oriented == 0 else 1.0
            for i in range(3):
                flip[i] = sense * normals[k, i]
            count = _on_triangle(slots, Ps, Rs, a, k, flip, reach, shapes, triangles, work, count)
            if count > FULL:
                count = thin_out(contacts, keys, count)
        if not on_face and supported(x, n, vertices, triangles, normals, here, meeting):
            count = _on_edge(slots, Ps, Rs, a, x, n, here, meeting, reach, shapes, triangles, work, count)
    if count == 0:
        count = _last_resort(slots, Ps, Rs, a, found, reach, vertices, contacts, keys)
    return count


@compiled
def _on_triangle(
    slots: Array, Ps: Array, Rs: Array, a: int, k: int, t: Array, reach: float, shapes: Any, triangles: Array, work: Any,
    count: int,
) -> int:  # fmt: skip
    """Contacts of what a shape shows to the plane of a triangle, over the triangle, whose normal towards the shape is t."""
    vertices, face_normals, face_start, face_vertices = shapes
    ring, codes, cut, _, contacts, keys, _, _ = work
    across = np.empty(3)
    for i in range(3):
        for c in range(3):
            cut[c, i] = vertices[triangles[k, c], i]
    u, v = cut[1] - cut[0], cut[2] - cut[0]
    across[0], across[1], across[2] = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    if dot(across, t) < 0.0:  # the other side of a sheet
        for i in range(3):
            cut[1, i], cut[2, i] = cut[2, i], cut[1, i]
    d = -t
    size = ring_along(slots[a], Ps[a], Rs[a], d, vertices, face_normals, face_start, face_vertices, ring, codes)
    size = clip(ring, codes, size, cut, 3, t)
    return add_ring(ring, codes, size, cut[0], t, True, 8 * k, reach, contacts, keys, count)


@compiled
def _on_edge(
    slots: Array, Ps: Array, Rs: Array, a: int, x: Array, n: Array, here: Array, meeting: int, reach: float, shapes: Any,
    triangles: Array, work: Any, count: int,
) -> int:  # fmt: skip
    """Contacts with an edge or a corner of the surface at x: all of the edge that a face of the shape lies on, or one point."""
    vertices, face_normals, face_start, face_vertices = shapes
    ring, codes, cut, cut_codes, contacts, keys, t, _ = work
    d = -n
    before = count
    if best_face(slots[a], Rs[a], d, face_normals, t) >= _FLAT:
        cuts = ring_along(slots[a], Ps[a], Rs[a], t, vertices, face_normals, face_start, face_vertices, cut, cut_codes)
        for m in range(meeting):
            for c in range(3):
                codes[c] = c
                for i in range(3):
                    ring[c, i] = vertices[triangles[here[m], c], i]
            size = clip(ring, codes, 3, cut, cuts, t)
            count = add_ring(ring, codes, size, cut[0], t, False, 8 * here[m], reach, contacts, keys, count)
    if count == before:
        top = dot(x, n)
        gap = -reach_along(slots[a], Ps[a], Rs[a], d, vertices) - top
        if gap <= reach:
            count = add_point(x, n, top, gap, _POINT + 8 * here[0], contacts, keys, count)
    return count


@compiled
def _last_resort(
    slots: Array,
    Ps: Array,
    Rs: Array,
    a: int,
    found: Array,
    reach: float,
    vertices: Array,
    contacts: Array,
    keys: Array,
) -> int:
    """The engine's deepest point as it is, where a shape is inside the surface and no feature explains how."""
    best = -1
    for j in range(len(found)):
        if found[j, 6] < -3.0 * ENGINE_MARGIN and (best < 0 or found[j, 6] < found[best, 6]):
            best = j
    if best < 0:
        return 0
    n = found[best, :3].copy()
    top = dot(found[best, 3:6], n) - ENGINE_MARGIN
    gap = -reach_along(slots[a], Ps[a], Rs[a], -n, vertices) - top
    return add_point(found[best, 3:6], n, top, gap, _POINT + best, contacts, keys, 0) if gap <= reach else 0


@compiled
def collect(
    slots: Array, Ps: Array, Rs: Array, reach: Array, pairs: Array, first: Array, found: Array, shapes: Any, mesh: Any,
    rows: Array, numbers: Array, out_keys: Array, pair_numbers: Array,
) -> int:  # fmt: skip
    """Contacts of all near pairs, reduced.

    Args:
        pairs: (m, 2) slots; the engine's lines of pair i are found[first[i]:first[i + 1]].
        rows, numbers, out_keys, pair_numbers: receive rows of a and b (k, 2), `NUMBERS` columns, keys, and friction and restitution (k, 2).

    Returns:
        How many there are, as far as they fit.
    """
    contacts, keys = np.empty((CANDIDATES, NUMBERS)), np.empty(CANDIDATES, np.int64)
    work = (
        np.empty((4 * RING, 3)), np.empty(4 * RING, np.int64), np.empty((RING, 3)), np.empty(RING, np.int64),
        contacts, keys, np.empty(3), np.empty(3),
    )  # fmt: skip
    chosen = np.empty(8 * KEPT, np.int64)
    total = 0
    for i in range(len(pairs)):
        a, b = pairs[i]
        near = reach[a] + reach[b]
        lines = found[first[i] : first[i + 1]]
        if slots[b].kind == _HALF_SPACE:
            count = space_pair(slots, Ps, Rs, a, b, near, shapes, work)
        elif slots[b].kind == _MESH:
            count = mesh_pair(slots, Ps, Rs, a, b, lines, near, shapes, mesh, work)
        else:
            count = convex_pair(slots, Ps, Rs, a, b, lines, near, shapes, work)
        kept = reduce(contacts, keys, count, chosen)
        pair_key = (slots[a].ident % 16384) * 16384 + slots[b].ident % 16384
        for k in range(min(kept, len(rows) - total)):
            rows[total, 0], rows[total, 1] = slots[a].row, slots[b].row
            numbers[total] = contacts[chosen[k]]
            out_keys[total] = pair_key * (1 << 34) + keys[chosen[k]]
            pair_numbers[total, 0] = np.sqrt(slots[a].friction * slots[b].friction)
            pair_numbers[total, 1] = max(slots[a].restitution, slots[b].restitution)
            total += 1
    return total
