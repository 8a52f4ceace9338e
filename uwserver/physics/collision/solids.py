"""Everything solid in one world, and where its bodies touch.

Which shapes come near each other and where they touch is worked out from the exact shapes (`broad_phase`, `directions`, `narrow_phase`). An
engine (`engine`) is asked one thing, the shortest way out of an overlap, and only about convex shapes that overlap otherwise than by lying
on a face (`faces`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType, TracebackType
from typing import Any

import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, NUMBERS, Contacts
from uwserver.physics.collision.engine import (
    AUTO,
    ENGINES,
    Engine,
    Pose,
    chosen_engine,
    engine_attitude,
    missing_engine,
)
from uwserver.physics.collision.finding import Finding
from uwserver.physics.geometry.rows import Part, Stock
from uwserver.physics.geometry.shapes import BadSolid, HalfSpace, Placed, Solid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.kernel.straight import address_of, straight

MARGIN = 0.005
"""m; contacts are reported from this gap on, and from farther for what moves fast."""
_CONTACTS_AT_ONCE = 1024
"""That compiled code finds; where there are more, Python looks."""
_IDENTS, _MOVING_IDENTS, _SHAPES_OF_A_BODY = 16384, 12288, 16
"""Numbers of shapes in keys; those of static shapes begin where those of 768 bodies end, beyond which keys may repeat."""


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
    """Where the code of the three stages of the search lies, for kernels that call it (`kernel.calling`)."""
    _, directions, narrow_phase = _kernels()
    lines: Any = directions.find_lines
    contacts: Any = narrow_phase.find_contacts
    table: IntArray = np.zeros((0, 2), np.int64)
    first, found, flags = np.zeros(1, np.int64), np.zeros((0, 7)), np.zeros(0, np.bool_)
    lines.load(table, table, first, found, flags)
    contacts.load(table, table, first, found, table, np.zeros((0, NUMBERS)), first, np.zeros((0, 2)))
    return address_of(_find_pairs(), "int64"), address_of(lines, "int64"), address_of(contacts, "int64")


@dataclass(eq=False)
class _Shared:
    """What the engine holds of all shapes that are equal, each moved to where it is asked about: a swarm costs it no more than two vehicles.

    Attributes:
        placed, rows: the shape.
        handles: of the engine: one, and a second where two of them have met.
        users: how many shapes there are.
    """

    placed: Placed
    rows: Part
    handles: list[int]
    users: int = 0


class Solids:
    """The solid things of one world, static or carried by rows of a state array. Not thread-safe. Close it, or use it in a `with`.

    Args:
        gate: False looks at every pair, near or not, for tests: the contacts are the same.
        engine: a name of `engine.ENGINES`, or "auto" for the first of them that is installed.

    Raises:
        ImportError: the engine is not installed.
        RuntimeError: it gives no further world.
    """

    def __init__(self, gate: bool = True, engine: str = AUTO) -> None:
        self._engine: Engine = open_engine(engine)
        self._gate = gate
        self._parts: dict[int, list[tuple[Part, _Shared | None]]] = {}
        self._rows_of: dict[int, int] = {}
        self._equal: dict[Placed, Placed] = {}
        self._shared: dict[Placed, _Shared] = {}
        self._next_solid = self._next_part = 0
        self._pairs = np.zeros((256, 2), np.int64)
        self._lines, self._overlapping = np.zeros((256, 7)), np.zeros(256, np.bool_)
        self._stock, self._is_stale = Stock(), True
        self._finding: Finding | None = None

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return self._engine.name

    def close(self) -> None:
        """Give back the engine's world; contacts can no longer be found."""
        self._engine.close()

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
        """Add something that never moves, its shapes placed in N. Returns its id.

        Raises:
            BadSolid: a shape that the engine cannot hold; nothing was added.
        """
        return self._add(solid, -1)

    def add_moving(self, solid: Solid, row: int) -> int:
        """Add what the body in `row` of the state array carries, its shapes placed in B. Returns its id.

        Raises:
            BadSolid: as `add_static`; or a mesh or half-space, which must be static.
        """
        for placed in solid.shapes:
            if isinstance(placed.shape, TriangleMesh | HalfSpace):
                raise BadSolid(f'"{solid.name}" moves, so it cannot have a mesh or half-space: use its convex hull')
        return self._add(solid, row)

    def remove(self, solid_id: int) -> None:
        """Take a solid away; KeyError if there is none of this id."""
        for _, shared in self._parts.pop(solid_id):
            if shared is not None:
                self._leave(shared)
        del self._rows_of[solid_id]
        self._is_stale = True

    def _add(self, solid: Solid, row: int) -> int:
        shapes = [self._equal.setdefault(placed, placed) for placed in solid.shapes]
        made = [(self._stock.part(placed), placed) for placed in shapes]
        solid_id, self._next_solid = self._next_solid, self._next_solid + 1
        entries: list[tuple[Part, _Shared | None]] = []
        for p, placed in made:
            p.slot["ident"] = self._ident(row, len(entries))
            p.slot["row"], p.slot["solid"] = row, solid_id
            p.slot["friction"], p.slot["restitution"] = solid.friction, solid.restitution
            p.slot["q"] = engine_attitude(placed)
            endless = isinstance(placed.shape, HalfSpace | TriangleMesh)
            entries.append((p, None if endless else self._share(placed, p)))
        self._parts[solid_id] = entries
        self._rows_of[solid_id] = row
        self._is_stale = True
        return solid_id

    def _share(self, placed: Placed, rows: Part) -> _Shared:
        shared = self._shared.get(placed)
        if shared is None:
            shared = self._shared[placed] = _Shared(placed, rows, [self._engine.add(placed, rows)])
        shared.users += 1
        return shared

    def _leave(self, shared: _Shared) -> None:
        shared.users -= 1
        if not shared.users:
            del self._shared[shared.placed]
            for handle in shared.handles:
                self._engine.remove(handle)

    def _ident(self, row: int, k: int) -> int:
        """Number of a shape in keys of contacts. Of what moves it follows from its row, so it does not depend on who else was ever there."""
        if row >= 0:
            return (row * _SHAPES_OF_A_BODY + k) % _MOVING_IDENTS
        ident, self._next_part = self._next_part, self._next_part + 1
        return _MOVING_IDENTS + ident % (_IDENTS - _MOVING_IDENTS)

    def _rebuild(self) -> None:
        """Arrays of all slots, those of moving bodies first: once for all that came and went since contacts were last looked for."""
        self._is_stale, self._finding = False, None
        # By row: the order of contacts, too, must not depend on who came when.
        moving = sorted((key for key, row in self._rows_of.items() if row >= 0), key=self._rows_of.__getitem__)
        static = [key for key, row in self._rows_of.items() if row < 0]
        entries = [entry for key in (*moving, *static) for entry in self._parts[key]]
        self._engine_shapes = [shared for _, shared in entries]
        first, bodies = 0, []
        for key in moving:
            bodies.append((first, len(self._parts[key]), self._rows_of[key]))
            first += len(self._parts[key])
        n, m = len(entries), len(bodies)
        broad_phase, _, _ = _kernels()
        self._find_pairs = straight(_find_pairs())
        self._shapes = self._stock.shapes([p for p, _ in entries])
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
        """Where bodies touch, or may touch within dt (s), at a state (n, 13) of p_NB, q_NB (w x y z) and nu.

        At most four contacts of each pair of convex shapes (or shape and mesh) and direction. `NO_CONTACTS` when everybody is far away.
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
        """The search for contacts, for compiled code; the same object for as long as all lies where it lies."""
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
        """Lines of all pairs: where each pair's begin, and (k, 7) direction, point on b, gap."""
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
                one, other = self._handles_of(self._engine_shapes[a], self._engine_shapes[b])
                way = self._engine.way_out(one, self._pose(a), other, self._pose(b))
                length = float(np.linalg.norm(way))
                if abs(length - 1.0) < 1e-3:
                    lines[k, :3] = way / length
            directions.refine_lines(self._table, pairs, first, lines, overlapping)
        return first, lines

    def _handles_of(self, a: _Shared | None, b: _Shared | None) -> tuple[int, int]:
        """Two shapes of the engine, another one for the second of two that are equal."""
        assert a is not None
        assert b is not None
        if a is b and len(a.handles) == 1:
            a.handles.append(self._engine.add(a.placed, a.rows))
        return a.handles[0], b.handles[-1] if a is b else b.handles[0]

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


def open_engine(name: str = AUTO) -> Engine:
    """An empty world of an engine.

    Args:
        name: of `ENGINES`, or "auto" for the first that is installed.

    Raises:
        ImportError: it is not installed.
        RuntimeError: it gives no further world.
        ValueError: no engine has this name.
    """
    if name != AUTO and name not in ENGINES:
        raise ValueError(f'no engine is called "{name}": choose {AUTO}, {" or ".join(ENGINES)}')
    missing = missing_engine(name)
    if missing is not None:
        raise ImportError(missing)
    if chosen_engine(name) == "bullet":
        from uwserver.physics.collision.bullet import BulletEngine

        return BulletEngine()
    from uwserver.physics.collision.coal_engine import CoalEngine

    return CoalEngine()
