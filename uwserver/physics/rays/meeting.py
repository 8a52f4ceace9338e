"""Rays of sensors that compiled code reads, against everything solid: one by one, and on surfaces by their trees (compiled, float64)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, arrays_at, view_at
from uwserver.physics.kernel.layout import Forms, Q, columns
from uwserver.physics.kernel.linear import rotation
from uwserver.physics.rays.hits import SIMPLE, begin, bring, enters, met_side, record
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.rows import SIDE
from uwserver.physics.rays.tree import DEEPEST, TREE, Tree, nearest_of

PLACED = np.dtype([("table", "i8"), ("body", "i8"), ("row", "i8")])
"""A surface: address of its table, its id (-1: the ids of its triangles' owners), and the row of the state that places it (-1: it never moves)."""


class Facing(NamedTuple):
    """Data of a surface beside its tree: its triangles, the ids of their solids, and its box, as in `hits.Batch`."""

    sides: Array
    owners: Array
    box: Array


SURFACE: Forms = {**TREE, "sides": SIDE, "owners": columns(np.int64), "box": columns(np.float64, 3)}
"""The table of a surface."""
SOLID: Forms = {**SIMPLE, "placed": PLACED}
"""The table of everything solid. It begins with the table of what is intersected one by one."""

_tree_at, _facing_at = arrays_at(Tree, SURFACE), arrays_at(Facing, SURFACE)
_placed_at = array_at(SOLID, "placed")
_ROWS = 2 * len(SURFACE)
"""Number of int64 in the table of a surface."""


@compiled
def _place(state: Array, row: int, x: Array, R: Array) -> None:
    """Write the state (13) that places a surface, and its attitude."""
    for j in range(len(x)):
        x[j] = state[row, j] if row >= 0 else 0.0
    if row < 0:
        x[Q] = 1.0
    rotation(x[Q], x[Q + 1], x[Q + 2], x[Q + 3], R)


@compiled
def _meet(surface: Array, placed: Any, x: Array, R: Array, rays: Any, work: Any, hits: Hits) -> None:
    """Add the hits of rays (`origin`, `direction`, `limit`, `past`) on one surface to the answer."""
    origin, direction, limit, past = rays
    o, d, todo, entry_at = work
    tree, facing = _tree_at(surface), _facing_at(surface)
    centre, half = facing.box[0], facing.box[1]
    for i in range(len(origin)):
        if placed.row >= 0 and len(past) > 0 and past[i] == placed.row:
            continue
        slack = bring(origin[i], direction[i], x, R, centre, half, o, d)
        far = enters(o, d, half, slack, min(limit, hits.distance[i]))
        if far < 0.0:
            continue
        t = nearest_of(tree, o, d, far + 4.0 * slack, todo, entry_at)
        if t < 0:
            continue
        side = facing.sides[t]
        approach, reached = met_side(side, o, d)
        if approach == 0.0 or not (0.0 <= reached < hits.distance[i] and reached <= limit):
            continue
        owner = placed.body if placed.body >= 0 else facing.owners[t]
        record(hits, i, reached, approach, R, side.normal, owner, side.material)


@entry
def meet(
    table: Array, origin: Array, direction: Array, limit: float, state: Array, past: Array,
    distance: Array, normal: Array, body: Array, material: Array,
) -> None:  # fmt: skip
    """Find the first solid that each ray meets.

    Args:
        table: made by `SOLID`.
        origin, direction, limit, state, past, distance, normal, body, material: as for `hits.intersect_simple`.
    """
    hits = Hits(distance, normal, body, material)
    begin(table, origin, direction, limit, state, past, hits)
    placed = _placed_at(table)
    if len(placed) == 0:
        return
    x, R = np.empty(state.shape[1]), np.empty((3, 3))
    work = np.empty(3), np.empty(3), np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    for k in range(len(placed)):
        _place(state, placed[k].row, x, R)
        surface = view_at(placed[k].table, _ROWS).reshape((_ROWS // 2, 2))
        _meet(surface, placed[k], x, R, (origin, direction, limit, past), work, hits)
