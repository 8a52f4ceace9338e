"""Makes contacts from the lines between near pairs (compiled).

`directions` gives for each pair the lines along which the shapes are nearest, or least deep in each other. Here, from the exact shapes and the poses
alone, they become contacts. If the direction is almost that of a face, its normal is used, so that a body that lies on it does not rock. If two
features lie flat on each other, all their points are used, as a line is only one point. A contact is dropped if a body would catch on an edge inside
a smooth surface.
"""

from __future__ import annotations

import numpy as np

from uwserver.physics.collision.broad_phase import SEARCH
from uwserver.physics.collision.manifold import (
    FLAT,
    FULL,
    KEPT,
    Work,
    add_point,
    add_polygon,
    clip,
    cut_by_triangle,
    new_work,
    reduce,
    thin_out,
)
from uwserver.physics.geometry.mesh import AT_POINT, in_normal_cone, triangles_at
from uwserver.physics.geometry.slots import CYLINDER, HALF_SPACE, MESH, Shapes, support, support_face, support_feature
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, arrays_at
from uwserver.physics.kernel.linear import dot

_DEEP = -2e-3
"""m; a body that is deeper than this in a mesh is pushed out although no feature explains the contact."""
_POINT = 1 << 33
"""Offset of the keys of single points from those of corners and crossings."""

_shapes_at = arrays_at(Shapes, SEARCH)
_reach_at = array_at(SEARCH, "reach")


@compiled
def _face_contacts(shapes: Shapes, a: int, b: int, n: Array, reach: float, work: Work, count: int) -> int:
    """Add contacts of two convex shapes whose nearest direction n (b to a) is that of a face of one of them. If it is not, try `_line_contacts`."""
    slots, R, t, face = shapes.slots, shapes.R, work.t, work.face
    d = -n
    of_a = support_face(slots[a], R[a], d, shapes.face_normals, t)
    of_b = support_face(slots[b], R[b], n, shapes.face_normals, face)
    if max(of_a, of_b) < FLAT:
        return _line_contacts(shapes, a, b, n, reach, work, count)
    plane_of_b = of_b >= of_a - 1e-9
    if plane_of_b:
        t[:] = face
    plane, other = (b, a) if plane_of_b else (a, b)
    cuts = support_feature(shapes, plane, t, work.cut, work.cut_codes)
    d = -t
    size = support_feature(shapes, other, d, work.ring, work.codes)
    size = clip(work, size, cuts, t)
    return add_polygon(work, size, work.cut[0], t, plane_of_b, 0, reach, count)


@compiled
def _line_contacts(shapes: Shapes, a: int, b: int, n: Array, reach: float, work: Work, count: int) -> int:
    """Add contacts of two round sides whose lines run along each other."""
    if shapes.slots[a].kind > CYLINDER or shapes.slots[b].kind > CYLINDER:
        return count
    d = -n
    size = support_feature(shapes, a, d, work.ring, work.codes)
    cuts = support_feature(shapes, b, n, work.cut, work.cut_codes)
    if size != 2 or cuts != 2:
        return count
    u, v = work.ring[1] - work.ring[0], work.cut[1] - work.cut[0]
    if dot(u, v) ** 2 < 0.999 * dot(u, u) * dot(v, v):
        return count
    size = clip(work, size, cuts, n)
    return add_polygon(work, size, work.cut[0], n, True, 0, reach, count)


@compiled
def convex_pair(shapes: Shapes, a: int, b: int, found: Array, reach: float, work: Work) -> int:
    """Find contacts of two convex shapes from their lines `found` (k, 7): direction (b to a), point on b, gap."""
    slots, P, R, contacts = shapes.slots, shapes.P, shapes.R, work.contacts
    count = 0
    for j in range(len(found)):
        if found[j, 6] > reach:
            continue
        n = found[j, :3].copy()
        count = _face_contacts(shapes, a, b, n, reach, work, count)
        deepest = 1e300
        for k in range(count):
            deepest = min(deepest, contacts[k, 6])
        top = support(slots[b], P[b], R[b], n, shapes.vertices)
        gap = -support(slots[a], P[a], R[a], -n, shapes.vertices) - top
        # If the features miss each other, only the nearest point remains.
        if gap <= reach and (count == 0 or gap < deepest - 1e-4):
            count = add_point(work, found[j, 3:6], n, top, gap, _POINT + j, count)
    return count


@compiled
def half_space_pair(shapes: Shapes, a: int, b: int, reach: float, work: Work) -> int:
    """Find contacts of a convex shape with a half-space."""
    t = work.t
    for i in range(3):
        t[i] = -shapes.R[b, i, 2]
    d = -t
    size = support_feature(shapes, a, d, work.ring, work.codes)
    return add_polygon(work, size, shapes.P[b], t, True, 0, reach, 0)


@compiled
def mesh_pair(shapes: Shapes, a: int, b: int, found: Array, reach: float, work: Work) -> int:
    """Find contacts of a convex shape with a mesh from their lines `found` (k, 7), one for each near triangle."""
    slots, normals = shapes.slots, shapes.triangle_normals
    here, done = np.empty(AT_POINT, np.int64), np.empty(256, np.int64)
    x, flip = np.empty(3), np.empty(3)
    count = known = 0
    last = slots[b].face_first + slots[b].face_count
    for j in range(len(found)):
        if found[j, 6] > reach:
            continue
        n = found[j, :3]
        for i in range(3):
            x[i] = found[j, 3 + i]
        meeting = triangles_at(shapes, x, 2e-4, here)
        on_face = False
        for m in range(meeting):
            k = here[m]
            along = dot(normals[k], n)
            if abs(along) < FLAT or k < slots[b].face_first or k >= last:
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
            count = _triangle_contacts(shapes, a, k, flip, reach, work, count)
            if count > FULL:
                count = thin_out(work, count)
        if not on_face and in_normal_cone(shapes, x, n, here, meeting):
            count = _edge_contacts(shapes, a, x, n, here, meeting, reach, work, count)
    if count == 0:
        count = _deepest_point(shapes, a, found, reach, work)
    return count


@compiled
def _triangle_contacts(shapes: Shapes, a: int, k: int, t: Array, reach: float, work: Work, count: int) -> int:
    """Add contacts of the feature of a shape that faces the plane of a triangle, over the triangle, whose normal towards the shape is t."""
    cut_by_triangle(shapes, k, t, work)
    d = work.face
    for i in range(3):
        d[i] = -t[i]
    size = support_feature(shapes, a, d, work.ring, work.codes)
    size = clip(work, size, 3, t)
    return add_polygon(work, size, work.cut[0], t, True, 8 * k, reach, count)


@compiled
def _edge_contacts(
    shapes: Shapes, a: int, x: Array, n: Array, here: Array, meeting: int, reach: float, work: Work, count: int
) -> int:
    """Add contacts with an edge or a corner of the surface at x: along the whole edge if a face of the shape lies on it, otherwise one point."""
    slot, P, R, t, ring, codes = shapes.slots[a], shapes.P[a], shapes.R[a], work.t, work.ring, work.codes
    d = -n
    before = count
    if support_face(slot, R, d, shapes.face_normals, t) >= FLAT:
        cuts = support_feature(shapes, a, t, work.cut, work.cut_codes)
        for m in range(meeting):
            for c in range(3):
                codes[c] = c
                for i in range(3):
                    ring[c, i] = shapes.vertices[shapes.triangles[here[m], c], i]
            size = clip(work, 3, cuts, t)
            count = add_polygon(work, size, work.cut[0], t, False, 8 * here[m], reach, count)
    if count == before:
        top = dot(x, n)
        gap = -support(slot, P, R, d, shapes.vertices) - top
        if gap <= reach:
            count = add_point(work, x, n, top, gap, _POINT + 8 * here[0], count)
    return count


@compiled
def _deepest_point(shapes: Shapes, a: int, found: Array, reach: float, work: Work) -> int:
    """Add the deepest line as a contact, if a shape is inside the surface and no feature explains it."""
    best = -1
    for j in range(len(found)):
        if found[j, 6] < _DEEP and (best < 0 or found[j, 6] < found[best, 6]):
            best = j
    if best < 0:
        return 0
    n = found[best, :3].copy()
    top = dot(found[best, 3:6], n)
    gap = -support(shapes.slots[a], shapes.P[a], shapes.R[a], -n, shapes.vertices) - top
    return add_point(work, found[best, 3:6], n, top, gap, _POINT + best, 0) if gap <= reach else 0


@entry
def find_contacts(
    table: Array,
    pairs: Array,
    first: Array,
    found: Array,
    rows: Array,
    numbers: Array,
    keys: Array,
    coefficients: Array,
) -> int:
    """Find the contacts of all near pairs, reduced to the few that matter.

    Args:
        table: made by `broad_phase.SEARCH`.
        pairs: (m, 2) slots; the lines of pair i, exact, are found[first[i]:first[i + 1]].
        rows, numbers, keys, coefficients: receive rows of a and b (k, 2), `NUMBERS` columns, keys, and friction and restitution (k, 2).

    Returns:
        The number of contacts that fit.
    """
    shapes, reach, work = _shapes_at(table), _reach_at(table), new_work()
    slots = shapes.slots
    chosen = np.empty(8 * KEPT, np.int64)
    total = 0
    for i in range(len(pairs)):
        a, b = pairs[i]
        near = reach[a] + reach[b]
        lines = found[first[i] : first[i + 1]]
        if slots[b].kind == HALF_SPACE:
            count = half_space_pair(shapes, a, b, near, work)
        elif slots[b].kind == MESH:
            count = mesh_pair(shapes, a, b, lines, near, work)
        else:
            count = convex_pair(shapes, a, b, lines, near, work)
        kept = reduce(work.contacts, work.keys, count, chosen)
        pair_key = (slots[a].ident % 16384) * 16384 + slots[b].ident % 16384
        for k in range(min(kept, len(rows) - total)):
            rows[total, 0], rows[total, 1] = slots[a].row, slots[b].row
            numbers[total] = work.contacts[chosen[k]]
            keys[total] = pair_key * (1 << 34) + work.keys[chosen[k]]
            coefficients[total, 0] = np.sqrt(slots[a].friction * slots[b].friction)
            coefficients[total, 1] = max(slots[a].restitution, slots[b].restitution)
            total += 1
    return total
