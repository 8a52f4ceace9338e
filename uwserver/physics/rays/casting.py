"""Rays against everything solid in a world: the engine of all ranging sensors.

Half-spaces and moving solids of few triangles are intersected one by one, exactly. For all others the triangle that a ray meets first is found in one
of two ways. Sensors that compiled code reads use a tree (`ray_targets`), so that they do not stop a tick. Sensors in Python, which cast many rays at
a time, use a picker (`surfaces`), which is faster then. Range and normal are computed from the triangle in float64, and each surface is kept about an
origin near it. For static solids that origin is the nearest point of a fixed lattice, so that a distant object changes no range, not even in its last
bit. A moving solid has a surface in its own frame, which equal solids share; only rays that pass it are tested against it. This module is imported
only if a world has something solid.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
"""A row of the state without a body."""
_STILL: FloatArray = np.zeros(13)
_STILL[Q] = 1.0
_NONE: IntArray = np.zeros(0, np.int64)


class _Carried(NamedTuple):
    """A solid that the body in a row of the state carries. `surface` is None if it has few triangles."""

    solid: Solid
    row: int
    surface: Surface | None


_Moved = tuple[int, int, Surface]
"""A moving solid: its id, its row of the state, and its triangles."""


@cache
def _loaded(kernel: Any) -> Any:
    """Return `hits.intersect_simple` or `meeting.meet`, compiled or loaded from the cache. They take the same arguments."""
    table, none, body = np.zeros((0, 2), np.int64), np.empty((0, 3)), np.empty(0, np.int64)
    kernel.load(table, none, none, 0.0, np.empty((0, 13)), body, np.empty(0), none, body, body)
    return kernel


class RayTargets(NamedTuple):
    """The solids at which compiled code casts rays (`meeting.meet`).

    Attributes:
        code: address of that code (`kernel.calling`).
        table: table of everything solid.
        rows: the arrays of the table.
    """

    code: int
    table: IntArray
    rows: Mapping[str, Any]


def _plain(origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rays as the contiguous arrays that compiled code takes."""
    return np.ascontiguousarray(origin, np.float64), np.ascontiguousarray(direction, np.float64)


def _cast(
    table: IntArray, still: Iterable[Surface], moving: Iterable[_Moved], state: FloatArray, rays: tuple[FloatArray, FloatArray, float]
) -> Hits:  # fmt: skip
    """Return the first hits of rays (`Geometry.raycast`, but `_plain`): on what is intersected one by one, given by its table, and on surfaces."""
    origin, direction, max_range = rays
    n, limit = len(origin), float(max_range)
    answer = Hits(np.empty(n), np.empty((n, 3)), np.empty(n, np.int64), np.empty(n, np.int64))
    straight(_loaded(hits.intersect_simple))(table, origin, direction, limit, state, _NONE, *answer)
    for surface in still:
        surface.cast(_STILL, -1, origin, direction, limit, answer)
    for body, row, surface in moving:
        surface.cast(state[row], body, origin, direction, limit, answer)
    return answer


class Rays:
    """All solids of one world, by ids that the caller chooses. Not thread-safe.

    Only the outside of a solid is hit: a ray that starts inside, as from a sensor within the shape of its vehicle, leaves it freely.

    Args:
        surfaces: may be shared with other worlds that are stepped in the same thread; default: an empty collection.
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
        """Add a solid that never moves. Raise BadSolid if it is impossible."""
        for placed in solid.shapes:
            check_shape(placed.shape)
        self._static[body] = solid
        self._still = self._simple = None

    def add_moving(self, body: int, solid: Solid, row: int) -> None:
        """Add a solid that the body in `row` of the state array carries. Raise BadSolid if it is impossible."""
        surface = self.surfaces.of(solid)
        self._moving[body] = _Carried(solid, row, surface)
        self._simple = None

    def remove(self, body: int) -> None:
        """Remove a solid. Raise KeyError if no solid has this id."""
        self._simple = None
        if body in self._moving:
            del self._moving[body]
            return
        del self._static[body]
        self._still = None

    def at(self, state: FloatArray, without: int = NOBODY) -> Instant:
        """Return the solids at the places of a state (n, 13), without those that the body in the row `without` carries."""
        return Instant(self, state, without)

    def cast(
        self, state: FloatArray, origin: FloatArray, direction: FloatArray, max_range: float, without: int = NOBODY
    ) -> Hits:
        """Cast rays as `uwserver.physics.rays.raycast.Geometry.raycast` does, with moving bodies at the places of `state`, and without that of row
        `without`."""
        where = np.ascontiguousarray(state, np.float64)
        return self._cast_plain(where, (*_plain(origin, direction), max_range), without)

    def _cast_plain(self, state: FloatArray, rays: tuple[FloatArray, FloatArray, float], without: int = NOBODY) -> Hits:
        _, table = self._simple_without(without)
        moving = [
            (body, c.row, c.surface) for body, c in self._moving.items() if c.surface is not None and c.row != without
        ]
        return _cast(table, self._still or (), moving, state, rays)

    def ray_targets(self) -> RayTargets:
        """Return the data with which compiled code casts rays; the same object until a solid comes or goes."""
        simple, _ = self._simple_without(NOBODY)
        if self._ray_targets is None:
            still = [(surface.table.ctypes.data, -1, -1) for surface in self._still or ()]
            moving = [
                (c.surface.table.ctypes.data, body, c.row) for body, c in self._moving.items() if c.surface is not None
            ]
            rows = {**simple._asdict(), "placed": np.array([*still, *moving], meeting.PLACED)}
            self._ray_targets = RayTargets(
                address_of(_loaded(meeting.meet), "none"), addresses(meeting.SOLID, rows), rows
            )
        return self._ray_targets

    def still(self, state: FloatArray, without: int = NOBODY) -> Still:
        """Return the solids at their places in this state (n, 13), for one other thread, without those of the row `without`. The first call after
        a change makes the surfaces."""
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
        """Return what is intersected one by one, without the solids of this row. It is cached until something changes, as each ping of a sonar
        needs it."""
        whole = self._simple or self._gather()
        if row == NOBODY:
            return whole
        if row not in self._others:
            carried = whole[0].carried
            simple = whole[0]._replace(carried=np.ascontiguousarray(carried[carried["row"] != row]))
            self._others[row] = simple, addresses(hits.SIMPLE, simple._asdict())
        return self._others[row]

    def _gather(self) -> tuple[Simple, IntArray]:
        """Make the data for the first rays after a change. The rows must live as long as their table."""
        if self._still is None:
            self._still = self.surfaces.still(self._static)
        rows, each = [], [np.empty(0, SIDE)]
        places: dict[
            Any, tuple[int, int, FloatArray, float]
        ] = {}  # by the parts of a solid, which the vehicles of a swarm share
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
    """A `uwserver.physics.rays.raycast.Geometry` that stays the same while the world goes on. For one thread; it is the same for all of one world."""

    def __init__(
        self, simple: tuple[Simple, IntArray], surfaces: tuple[Surface, ...], moving: tuple[_Moved, ...], state: FloatArray
    ) -> None:  # fmt: skip
        """Make the geometry of a state (n, 13).

        Args:
            simple: what is intersected one by one.
            surfaces: what never moves.
            moving: body, row and surface of each moving solid.
            state: (n, 13) of the bodies.
        """
        self._simple, self._surfaces, self._moving, self._state = simple, surfaces, moving, state

    def still(self) -> Still:
        """Return itself."""
        return self

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Return the nearest solid that each ray meets."""
        rays = (*_plain(origin, direction), max_range)
        return _cast(self._simple[1], self._surfaces, self._moving, self._state, rays)


class Instant:
    """A `uwserver.physics.rays.raycast.Geometry` of the solids at the places of a state (n, 13), which is read when rays are cast."""

    def __init__(self, rays: Rays, state: FloatArray, without: int = NOBODY) -> None:
        self._rays, self._state, self._without = rays, state, without

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Return the nearest solid that each ray meets."""
        return self._rays.cast(self._state, origin, direction, max_range, self._without)

    def still(self) -> Still:
        """Return a geometry for one other thread, see `Rays.still`."""
        return self._rays.still(self._state, self._without)
