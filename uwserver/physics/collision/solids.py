"""Everything solid in one world, and the search for contacts of its bodies.

Which shapes come near each other, and where they touch, is computed from the exact shapes (`broad_phase`, `directions`, `narrow_phase`). An engine
(`engine`) answers one question, the shortest way out of an overlap. It is asked only about convex shapes that overlap otherwise than by lying on a
face (`faces`).
"""

from __future__ import annotations

from functools import cache
from types import ModuleType, TracebackType
from typing import Any

import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, NUMBERS, Contacts, Finding
from uwserver.physics.collision.engine import Pose, engine_attitude
from uwserver.physics.collision.ways import WaysOut
from uwserver.physics.geometry.rows import Part, Stock
from uwserver.physics.geometry.shapes import BadSolid, HalfSpace, Placed, Solid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.kernel.straight import address_of, straight

MARGIN = 0.005
"""m; contacts are reported up to this gap, and up to larger ones for fast bodies."""
_CONTACTS_AT_ONCE = 1024
"""Most contacts that compiled code finds; if there are more, Python searches."""
_IDENTS, _MOVING_IDENTS, _SHAPES_OF_A_BODY = 16384, 12288, 16
"""Numbers of shapes in keys. Those of static shapes begin after those of 768 bodies; with more bodies keys may repeat."""


@cache
def _kernels() -> tuple[ModuleType, ModuleType, ModuleType]:
    from uwserver.physics.collision import broad_phase, directions, narrow_phase

    return broad_phase, directions, narrow_phase


@cache
def _find_pairs() -> Any:
    kernel: Any = _kernels()[0].find_pairs
    pairs: IntArray = np.zeros((0, 2), np.int64)
    kernel.load(pairs, np.zeros((0, 13)), 0.0, 0.0, True, pairs)
    return kernel


@cache
def _codes() -> tuple[int, int, int]:
    """Return the addresses of the code of the three stages of the search, for kernels that call it (`kernel.calling`)."""
    _, directions, narrow_phase = _kernels()
    lines: Any = directions.find_lines
    contacts: Any = narrow_phase.find_contacts
    table: IntArray = np.zeros((0, 2), np.int64)
    first, found, flags = np.zeros(1, np.int64), np.zeros((0, 7)), np.zeros(0, np.bool_)
    lines.load(table, table, first, found, flags)
    contacts.load(table, table, first, found, table, np.zeros((0, NUMBERS)), first, np.zeros((0, 2)))
    return address_of(_find_pairs(), "int64"), address_of(lines, "int64"), address_of(contacts, "int64")


class Solids:
    """The solid things of one world, static or carried by rows of a state array. Not thread-safe. Close it, or use it in a `with`.

    Args:
        gate: False searches every pair, near or not, for tests; the contacts are the same.
        ways: finds ways out of overlaps; default: with the first engine that is installed.
        stock: the arrays of shapes; default: an empty one.

    Other worlds that are stepped in the same thread may share both.

    Raises:
        ImportError: no engine is installed.
    """

    def __init__(self, gate: bool = True, ways: WaysOut | None = None, stock: Stock | None = None) -> None:
        self.ways = WaysOut() if ways is None else ways
        self.stock = Stock() if stock is None else stock
        self._gate = gate
        self._parts: dict[int, list[tuple[Part, Placed]]] = {}
        self._rows_of: dict[int, int] = {}
        self._equal: dict[Placed, Placed] = {}
        self._next_solid = self._next_part = 0
        self._pairs = np.zeros((256, 2), np.int64)
        self._lines, self._overlapping = np.zeros((256, 7)), np.zeros(256, np.bool_)
        self._is_stale = True
        self._finding: Finding | None = None

    def close(self) -> None:
        """Free the world of the engine."""
        self.ways.close()

    def __enter__(self) -> Solids:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._parts)

    # -- what there is --------------------------------------------------------------------------------------------------------------

    def add_static(self, solid: Solid) -> int:
        """Add a solid that never moves, with its shapes placed in N. Return its id.

        Raises:
            BadSolid: an impossible shape; nothing was added.
        """
        return self._add(solid, -1)

    def add_moving(self, solid: Solid, row: int) -> int:
        """Add a solid that the body in `row` of the state array carries, with its shapes placed in B. Return its id.

        Raises:
            BadSolid: as `add_static`; or a mesh or half-space, which must be static.
        """
        for placed in solid.shapes:
            if isinstance(placed.shape, TriangleMesh | HalfSpace):
                raise BadSolid(f'"{solid.name}" moves, so it cannot have a mesh or half-space: use its convex hull')
        return self._add(solid, row)

    def remove(self, solid_id: int) -> None:
        """Remove a solid. Raise KeyError if no solid has this id."""
        del self._parts[solid_id]
        del self._rows_of[solid_id]
        self._is_stale = True

    def _add(self, solid: Solid, row: int) -> int:
        shapes = [self._equal.setdefault(placed, placed) for placed in solid.shapes]
        made = [(self.stock.part(placed), placed) for placed in shapes]
        solid_id, self._next_solid = self._next_solid, self._next_solid + 1
        entries: list[tuple[Part, Placed]] = []
        for p, placed in made:
            p.slot["ident"] = self._ident(row, len(entries))
            p.slot["row"], p.slot["solid"] = row, solid_id
            p.slot["friction"], p.slot["restitution"] = solid.friction, solid.restitution
            p.slot["q"] = engine_attitude(placed)
            entries.append((p, placed))
        self._parts[solid_id] = entries
        self._rows_of[solid_id] = row
        self._is_stale = True
        return solid_id

    def _ident(self, row: int, k: int) -> int:
        """Return the number of a shape in keys of contacts. For a moving shape it follows from its row, so it does not depend on earlier solids."""
        if row >= 0:
            return (row * _SHAPES_OF_A_BODY + k) % _MOVING_IDENTS
        ident, self._next_part = self._next_part, self._next_part + 1
        return _MOVING_IDENTS + ident % (_IDENTS - _MOVING_IDENTS)

    def _rebuild(self) -> None:
        """Make the arrays of all slots, those of moving bodies first. This is done once for all solids that came or went since the last search."""
        self._is_stale, self._finding = False, None
        # Sorted by row: the order of contacts must not depend on the order in which bodies came.
        moving = sorted((key for key, row in self._rows_of.items() if row >= 0), key=self._rows_of.__getitem__)
        static = [key for key, row in self._rows_of.items() if row < 0]
        entries = [entry for key in (*moving, *static) for entry in self._parts[key]]
        self._placed = entries
        first, bodies = 0, []
        for key in moving:
            bodies.append((first, len(self._parts[key]), self._rows_of[key]))
            first += len(self._parts[key])
        n, m = len(entries), len(bodies)
        broad_phase, _, _ = _kernels()
        self._find_pairs = straight(_find_pairs())
        self._shapes = self.stock.shapes([p for p, _ in entries])
        radius = np.array([broad_phase.radius_of(self._shapes.slots[at : at + count]) for at, count, _ in bodies])
        self._search = broad_phase.Search(
            np.array(bodies, dtype=np.int64).reshape(-1, 3), np.arange(first, n), radius, np.zeros((n, 4)), np.zeros(n), np.zeros((n, 3)),
            np.zeros((n, 3)), np.zeros((m, 3)), np.zeros((m, 3)), np.arange(m), *np.zeros((2, m), np.bool_),
        )  # fmt: skip
        self._table = addresses(broad_phase.SEARCH, {**self._shapes._asdict(), **self._search._asdict()})
        slots, P, R = self._shapes[:3]
        for s in range(first, n):
            broad_phase.place(slots[s], np.zeros(3), np.eye(3), P[s], R[s])
            broad_phase.bound(slots[s], P[s], R[s], 0.0, self._search.low[s], self._search.high[s])
            self._search.Q[s] = np.roll(slots["q"][s], -1)

    # -- contacts -------------------------------------------------------------------------------------------------------------------

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Find where bodies touch, or may touch within dt (s), at a state (n, 13) of p_NB, q_NB (w x y z) and nu.

        There are at most four contacts for each pair of convex shapes (or shape and mesh) and direction; `NO_CONTACTS` if all are far apart.
        """
        if self._is_stale:
            self._rebuild()
        count = self._find_pairs(self._table, state, dt, MARGIN, self._gate, self._pairs)
        if not count:
            return NO_CONTACTS
        while count > len(self._pairs):
            self._pairs, self._finding = np.zeros((2 * count, 2), np.int64), None
            count = self._find_pairs(self._table, state, dt, MARGIN, self._gate, self._pairs)
        pairs = self._pairs[:count]
        first, lines = self._find_lines(pairs)
        return self._collect(pairs, first, lines)

    def finding(self) -> Finding:
        """Return the search for contacts for compiled code; the same object as long as its arrays stay where they are."""
        if self._is_stale:
            self._rebuild()
        if self._finding is None:
            most = _CONTACTS_AT_ONCE
            self._finding = Finding(
                *(_codes() if self._gate else (0, 0, 0)), self._table, MARGIN, self._pairs, np.zeros(len(self._pairs) + 1, np.int64),
                self._lines, self._overlapping, np.zeros((most, 2), np.int64), np.zeros((most, NUMBERS)), np.zeros(most, np.int64),
                np.zeros((most, 2)), np.zeros(0, np.int64),
            )  # fmt: skip
        return self._finding

    def _find_lines(self, pairs: Any) -> tuple[IntArray, FloatArray]:
        """Return the lines of all pairs: where each pair's lines begin, and (k, 7) direction, point on b, gap."""
        _, directions, _ = _kernels()
        first = np.zeros(len(pairs) + 1, np.int64)
        while True:
            count = directions.find_lines(self._table, pairs, first, self._lines, self._overlapping)
            if count <= len(self._lines):
                break
            self._lines, self._overlapping = np.zeros((2 * count, 7)), np.zeros(2 * count, np.bool_)
            self._finding = None
        lines, overlapping = self._lines[:count], self._overlapping[:count]
        if overlapping.any():
            for k in np.flatnonzero(overlapping):
                a, b = pairs[int(np.searchsorted(first, k, "right")) - 1]
                way = self._way_out(int(a), int(b))
                length = float(np.linalg.norm(way))
                if abs(length - 1.0) < 1e-3:
                    lines[k, :3] = way / length
            directions.refine_lines(self._table, pairs, first, lines, overlapping)
        return first, lines

    def _way_out(self, a: int, b: int) -> FloatArray:
        (rows_a, one), (rows_b, other) = self._placed[a], self._placed[b]
        return self.ways.way_out(one, rows_a, self._pose(a), other, rows_b, self._pose(b))

    def _pose(self, s: int) -> Pose:
        return Pose(self._shapes.P[s], self._search.Q[s])

    def _collect(self, pairs: Any, first: IntArray, lines: FloatArray) -> Contacts:
        _, _, narrow_phase = _kernels()
        most = 32 * len(pairs)
        bodies, numbers = np.empty((most, 2), np.int64), np.empty((most, NUMBERS))
        keys, coefficients = np.empty(most, np.int64), np.empty((most, 2))
        n = narrow_phase.find_contacts(self._table, pairs, first, lines, bodies, numbers, keys, coefficients)
        if n == 0:
            return NO_CONTACTS
        columns: tuple[Any, ...] = (
            bodies[:n, 0], bodies[:n, 1], numbers[:n, 0:3], numbers[:n, 3:6], numbers[:n, 6], keys[:n],
            coefficients[:n, 0], coefficients[:n, 1],
        )  # fmt: skip
        # The solver is compiled for contiguous columns.
        return Contacts(*(np.ascontiguousarray(column) for column in columns))
