"""Rays against everything solid in a world: the engine of all ranging sensors.

Half-spaces and moving solids of few triangles are intersected one by one, exactly. For all else it is found which triangle a ray meets first: for
sensors that compiled code reads by a tree (`ray_targets`), so that they cost no stop of a tick; for those in Python, which cast many rays at a time,
by a picker (`surfaces`), which is quicker then. Range and normal are computed from the triangle in float64, and each surface is kept about an origin
near it. That of what never moves is the nearest point of a fixed lattice, so that something far away changes no range, not in its last bit. What
moves has a surface in its own frame, shared by equal solids, and only rays that pass it go there. Imported only when a world has something solid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.geometry.shapes import Solid, check_shape
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import Q, addresses
from uwserver.physics.kernel.straight import address_of, straight
from uwserver.physics.rays import hits, meeting
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.rows import CARRIED, SIDE, Simple, facets, middle, planes, sides
from uwserver.physics.rays.surfaces import Surface, Surfaces

NOBODY = -1
"""A row of the state in which no body is."""
_STILL: FloatArray = np.zeros(13)
_STILL[Q] = 1.0
_NONE: IntArray = np.zeros(0, np.int64)


class _Carried(NamedTuple):
    """A solid that the body in a row of the state carries; `surface` is None for one of few triangles."""

    solid: Solid
    row: int
    surface: Surface | None


_Moved = tuple[int, int, Surface]
"""A solid that moves: its id, its row of the state, and its triangles."""


@cache
def _intersect_simple() -> Any:
    table, none, body = np.zeros((0, 2), np.int64), np.empty((0, 3)), np.empty(0, np.int64)
    kernel: Any = hits.intersect_simple
    kernel.load(table, none, none, 0.0, np.empty((0, 13)), body, np.empty(0), none, body, body)
    return kernel


@cache
def _intersects_simple() -> Callable[..., Any]:
    return straight(_intersect_simple())


@cache
def _meet_code() -> int:
    table, none, body = np.zeros((0, 2), np.int64), np.empty((0, 3)), np.empty(0, np.int64)
    kernel: Any = meeting.meet
    kernel.load(table, none, none, 0.0, np.empty((0, 13)), body, np.empty(0), none, body, body)
    return address_of(kernel, "none")


class RayTargets(NamedTuple):
    """What compiled code casts rays at (`meeting.meet`).

    Attributes:
        code: where that lies (`kernel.calling`).
        table: of what is solid.
        rows: the arrays of the table.
    """

    code: int
    table: IntArray
    rows: Mapping[str, Any]


def _plain(origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As compiled code takes them."""
    return np.ascontiguousarray(origin, np.float64), np.ascontiguousarray(direction, np.float64)


def _cast(
    table: IntArray, still: Iterable[Surface], moving: Iterable[_Moved], state: FloatArray, rays: tuple[FloatArray, FloatArray, float]
) -> Hits:  # fmt: skip
    """The first thing that rays (`Geometry.raycast`, but `_plain`) meet: of what is intersected one by one, by its table, and of surfaces."""
    origin, direction, max_range = rays
    n, limit = len(origin), float(max_range)
    answer = Hits(np.empty(n), np.empty((n, 3)), np.empty(n, np.int64), np.empty(n, np.int64))
    _intersects_simple()(table, origin, direction, limit, state, _NONE, *answer)
    for surface in still:
        surface.cast(_STILL, -1, origin, direction, limit, answer)
    for body, row, surface in moving:
        surface.cast(state[row], body, origin, direction, limit, answer)
    return answer


class Rays:
    """All solids of one world, by ids that the caller chooses. Not thread-safe.

    Only the outside of a solid is hit: a ray that starts inside, as from a sensor within its vehicle's own shape, leaves unhindered.

    Args:
        surfaces: may be those of other worlds that are stepped in the same thread; default: none yet.
    """

    def __init__(self, surfaces: Surfaces | None = None) -> None:
        self.surfaces = Surfaces() if surfaces is None else surfaces
        self._static: dict[int, Solid] = {}
        self._moving: dict[int, _Carried] = {}
        self._still: tuple[Surface, ...] | None = None
        self._simple: tuple[Simple, IntArray] | None = None
        self._others: dict[int, tuple[Simple, IntArray]] = {}
        self._ray_targets: RayTargets | None = None

    def add_static(self, body: int, solid: Solid) -> None:
        """Add something that never moves. Raises BadSolid."""
        for placed in solid.shapes:
            check_shape(placed.shape)
        self._static[body] = solid
        self._still = self._simple = None

    def add_moving(self, body: int, solid: Solid, row: int) -> None:
        """Add what the body in `row` of the state array carries. Raises BadSolid."""
        surface = self.surfaces.of(solid)
        self._moving[body] = _Carried(solid, row, surface)
        self._simple = None

    def remove(self, body: int) -> None:
        """Take a solid away; KeyError if there is none of this id."""
        self._simple = None
        if body in self._moving:
            del self._moving[body]
            return
        del self._static[body]
        self._still = None

    def at(self, state: FloatArray, without: int = NOBODY) -> Instant:
        """The solids where a state (n, 13) puts them, but for those that the body in the row `without` carries."""
        return Instant(self, state, without)

    def cast(
        self, state: FloatArray, origin: FloatArray, direction: FloatArray, max_range: float, without: int = NOBODY
    ) -> Hits:
        """See `uwserver.physics.rays.raycast.Geometry.raycast`; moving bodies stand where `state` says, and that of row `without` is not there."""
        where = np.ascontiguousarray(state, np.float64)
        return self._cast_plain(where, (*_plain(origin, direction), max_range), without)

    def _cast_plain(self, state: FloatArray, rays: tuple[FloatArray, FloatArray, float], without: int = NOBODY) -> Hits:
        _, table = self._simple_without(without)
        moving = [
            (body, c.row, c.surface) for body, c in self._moving.items() if c.surface is not None and c.row != without
        ]
        return _cast(table, self._still or (), moving, state, rays)

    def ray_targets(self) -> RayTargets:
        """What compiled code needs to cast rays, the same object until something comes or goes."""
        simple, _ = self._simple_without(NOBODY)
        if self._ray_targets is None:
            still = [(surface.table.ctypes.data, -1, -1) for surface in self._still or ()]
            moving = [
                (c.surface.table.ctypes.data, body, c.row) for body, c in self._moving.items() if c.surface is not None
            ]
            rows = {**simple._asdict(), "placed": np.array([*still, *moving], meeting.PLACED)}
            self._ray_targets = RayTargets(_meet_code(), addresses(meeting.SOLID, rows), rows)
        return self._ray_targets

    def still(self, state: FloatArray, without: int = NOBODY) -> Still:
        """The solids as they are now, where this state (n, 13) puts them, for one other thread; not those of the row `without`. The first after a
        change makes the surfaces."""
        simple = self._simple_without(without)
        moving = [
            (body, c.row, c.surface.apart())
            for body, c in self._moving.items()
            if c.surface is not None and c.row != without
        ]
        return Still(
            simple, tuple(surface.apart() for surface in self._still or ()), tuple(moving), np.array(state, np.float64)
        )

    def _simple_without(self, row: int) -> tuple[Simple, IntArray]:
        """What is intersected one by one, but for what this row carries; kept until something changes, as each ping of its sonars asks."""
        whole = self._simple or self._gather()
        if row == NOBODY:
            return whole
        if row not in self._others:
            carried = whole[0].carried
            simple = whole[0]._replace(carried=np.ascontiguousarray(carried[carried["row"] != row]))
            self._others[row] = simple, addresses(hits.SIMPLE, simple._asdict())
        return self._others[row]

    def _gather(self) -> tuple[Simple, IntArray]:
        """What the first rays after a change need; the rows stay alive beside their table."""
        if self._still is None:
            self._still = self.surfaces.still(self._static)
        rows, each = [], [np.empty(0, SIDE)]
        places: dict[
            Any, tuple[int, int, FloatArray, float]
        ] = {}  # by what solids consist of, which those of a swarm have in common
        first = 0
        for body, (solid, row, surface) in self._moving.items():
            if surface is not None:
                continue
            key = solid.shapes, solid.material
            if key not in places:
                parts = facets(solid)
                centre, half = middle(parts)
                each.append(sides(parts, np.zeros(3)))
                places[key] = first, len(each[-1]), centre, float(np.linalg.norm(half))
                first += len(each[-1])
            rows.append((body, row, *places[key]))
        self._others.clear()
        self._ray_targets = None
        simple = Simple(planes(self._static.items()), np.array(rows, CARRIED), np.concatenate(each))
        table = addresses(hits.SIMPLE, simple._asdict())
        self._simple = simple, table
        return self._simple


class Still:
    """A `uwserver.physics.rays.raycast.Geometry` that stays as it is while the world goes on. For one thread, the same for all of one world."""

    def __init__(
        self, simple: tuple[Simple, IntArray], surfaces: tuple[Surface, ...], moving: tuple[_Moved, ...], state: FloatArray
    ) -> None:  # fmt: skip
        """simple, surfaces, moving: what is cast at one by one, what never moves, and body, row and surface of what does; `state`: (n, 13)."""
        self._simple, self._surfaces, self._moving, self._state = simple, surfaces, moving, state

    def still(self) -> Still:
        """Itself."""
        return self

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """The nearest solid that each ray meets."""
        rays = (*_plain(origin, direction), max_range)
        return _cast(self._simple[1], self._surfaces, self._moving, self._state, rays)


class Instant:
    """A `uwserver.physics.rays.raycast.Geometry`: solids where a state (n, 13) puts them, read when rays are cast."""

    def __init__(self, rays: Rays, state: FloatArray, without: int = NOBODY) -> None:
        self._rays, self._state, self._without = rays, state, without

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """The nearest solid that each ray meets."""
        return self._rays.cast(self._state, origin, direction, max_range, self._without)

    def still(self) -> Still:
        """As `Rays.still`."""
        return self._rays.still(self._state, self._without)
