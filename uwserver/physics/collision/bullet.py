"""Everything solid in one world, and where its bodies touch. The only module that knows Bullet, which it imports when a world has a solid.

Bullet holds each convex shape and each mesh as a body of its own, at the pose that the state arrays say; it never steps. What it is asked,
`getClosestPoints`, depends on the poses alone; its contact manifolds would not. `narrow_phase` makes contacts of the answers.
"""

from __future__ import annotations

import ctypes
import math
import os
from array import array
from functools import cache
from types import ModuleType, TracebackType
from typing import Any, cast

import numpy as np

from uwserver.frames import multiply
from uwserver.physics.collision.contacts import NO_CONTACTS, NUMBERS, Contacts
from uwserver.physics.geometry.rows import Part, Stock
from uwserver.physics.geometry.shapes import (
    BadSolid,
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import addresses

MARGIN = 0.005
"""m; contacts are reported from this gap on, and from farther for what moves fast."""
_ENGINE_SLACK = 0.004
"""m; Bullet rounds edges and thickens meshes by margins, so it is asked a little farther than needed."""
_IDENTS, _MOVING_IDENTS, _SHAPES_OF_A_BODY = 16384, 12288, 16
"""Numbers of shapes in keys; those of static shapes begin where those of 768 bodies end, beyond which keys may repeat."""
_AXIS = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Axis x of our cylinders and capsules is axis z of Bullet's."""


@cache
def _engine() -> ModuleType:
    """pybullet, without the line that it writes to standard error when it is imported: a log should not begin with a stray date."""
    try:
        err = os.dup(2)
    except OSError:  # there is none
        import pybullet

        return cast("ModuleType", pybullet)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet

        ctypes.CDLL(None).fflush(None)  # it waits in C's own buffer
    finally:
        os.dup2(err, 2)
        os.close(err)
        os.close(nowhere)
    return cast("ModuleType", pybullet)


@cache
def _kernels() -> tuple[ModuleType, ModuleType]:
    from uwserver.physics.collision import broad_phase, narrow_phase

    return broad_phase, narrow_phase


class Solids:
    """The solid things of one world, static or carried by rows of a state array. Not thread-safe. Close it, or use it in a `with`.

    Args:
        gate: False asks the engine about every pair, near or not, for tests: the contacts are the same.

    Raises:
        ImportError: pybullet or scipy is not installed.
    """

    def __init__(self, gate: bool = True) -> None:
        self._bullet: Any = _engine()
        self._client: int = self._bullet.connect(self._bullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("Bullet gives no further world: close some")
        self._gate = gate
        self._parts: dict[int, list[tuple[Part, int]]] = {}
        self._rows_of: dict[int, int] = {}
        self._placed_of: dict[int, Placed] = {}
        self._idle: dict[int, list[int]] = {}
        self._next_solid = self._next_part = 0
        self._pairs = np.zeros((256, 2), np.int64)
        self._stock, self._is_stale = Stock(), True

    def close(self) -> None:
        """Give back the engine's world; contacts can no longer be found."""
        if self._client >= 0:
            self._bullet.disconnect(self._client)
            self._client = -1

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
        for _, body in self._parts.pop(solid_id):
            if body >= 0:
                # Bullet never gives back the memory of a shape that a body had: the body waits for the next of this shape.
                self._idle.setdefault(id(self._placed_of[body]), []).append(body)
        del self._rows_of[solid_id]
        self._is_stale = True

    def _add(self, solid: Solid, row: int) -> int:
        made = [(self._stock.part(placed), placed) for placed in solid.shapes]
        solid_id, self._next_solid = self._next_solid, self._next_solid + 1
        entries: list[tuple[Part, int]] = []
        for p, placed in made:
            p.slot["ident"] = self._ident(row, len(entries))
            p.slot["row"], p.slot["solid"] = row, solid_id
            p.slot["friction"], p.slot["restitution"] = solid.friction, solid.restitution
            p.slot["q"] = _engine_attitude(placed)
            entries.append((p, self._engine_body(p, placed)))
        self._parts[solid_id] = entries
        self._rows_of[solid_id] = row
        self._is_stale = True
        return solid_id

    def _ident(self, row: int, k: int) -> int:
        """Number of a shape in keys of contacts. Of what moves it follows from its row, so it does not depend on who else was ever there."""
        if row >= 0:
            return (row * _SHAPES_OF_A_BODY + k) % _MOVING_IDENTS
        ident, self._next_part = self._next_part, self._next_part + 1
        return _MOVING_IDENTS + ident % (_IDENTS - _MOVING_IDENTS)

    def _engine_body(self, p: Part, placed: Placed) -> int:
        bullet, shape = self._bullet, placed.shape
        if isinstance(shape, HalfSpace):
            return -1
        if self._idle.get(id(placed)):  # nobody else has this id: `_placed_of` keeps it alive
            return self._idle[id(placed)].pop()
        form: dict[str, Any]
        if p.mesh is not None:
            form = {
                "shapeType": bullet.GEOM_MESH, "vertices": p.mesh.vertices.tolist(),
                "indices": p.mesh.faces.ravel().tolist(), "flags": bullet.GEOM_FORCE_CONCAVE_TRIMESH,
            }  # fmt: skip
        elif isinstance(shape, Box):
            form = {"shapeType": bullet.GEOM_BOX, "halfExtents": list(shape.half)}
        elif isinstance(shape, Sphere):
            form = {"shapeType": bullet.GEOM_SPHERE, "radius": shape.radius}
        elif isinstance(shape, Cylinder | Capsule):
            kind = bullet.GEOM_CYLINDER if isinstance(shape, Cylinder) else bullet.GEOM_CAPSULE
            form = {"shapeType": kind, "radius": shape.radius, "height": 2.0 * shape.half_length}
        else:
            assert isinstance(shape, ConvexHull)
            assert p.corners is not None
            form = {"shapeType": bullet.GEOM_MESH, "vertices": p.corners.vertices.tolist()}
        made = bullet.createCollisionShape(physicsClientId=self._client, **form)
        if made < 0:
            raise BadSolid(f"Bullet refuses a {type(shape).__name__}")
        position, q = (
            ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)) if p.mesh is not None else (placed.p, _engine_attitude(placed))
        )
        body = int(
            bullet.createMultiBody(
                0.0, made, basePosition=position, baseOrientation=(*q[1:], q[0]), physicsClientId=self._client
            )
        )
        self._placed_of[body] = placed
        return body

    def _rebuild(self) -> None:
        """Arrays of all slots, those of moving bodies first: once for all that came and went since contacts were last looked for."""
        self._is_stale = False
        # By row: the order of contacts, too, must not depend on who came when.
        moving = sorted((key for key, row in self._rows_of.items() if row >= 0), key=self._rows_of.__getitem__)
        static = [key for key, row in self._rows_of.items() if row < 0]
        entries = [entry for key in (*moving, *static) for entry in self._parts[key]]
        self._engine = [body for _, body in entries]
        first, bodies = 0, []
        for key in moving:
            bodies.append((first, len(self._parts[key]), self._rows_of[key]))
            first += len(self._parts[key])
        n, m = len(entries), len(bodies)
        broad_phase, _ = _kernels()
        self._shapes = self._stock.shapes([p for p, _ in entries])
        self._search = broad_phase.Search(
            np.array(bodies, dtype=np.int64).reshape(-1, 3), np.arange(first, n), np.zeros((n, 4)), np.zeros(n),
            np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((m, 3)), np.zeros((m, 3)), np.arange(m), np.zeros(m, np.bool_),
        )  # fmt: skip
        self._table = addresses(broad_phase.SEARCH, {**self._shapes._asdict(), **self._search._asdict()})
        slots, P, R = self._shapes[:3]
        for s in range(first, n):
            broad_phase.place(slots[s], np.zeros(3), np.eye(3), P[s], R[s])
            broad_phase.bound(slots[s], P[s], R[s], 0.0, self._search.low[s], self._search.high[s])

    # -- contacts -------------------------------------------------------------------------------------------------------------------

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Where bodies touch, or may touch within dt (s), at a state (n, 13) of p_NB, q_NB (w x y z) and nu.

        At most four contacts of each pair of convex shapes (or shape and mesh) and direction. `NO_CONTACTS` when everybody is far away.
        """
        if self._is_stale:
            self._rebuild()
        if not len(self._search.bodies):
            return NO_CONTACTS
        pairs = self._find_pairs(state, dt)
        if not len(pairs):
            return NO_CONTACTS
        first, found = self._closest_points(pairs)
        return self._collect(pairs, first, found)

    def _find_pairs(self, state: FloatArray, dt: float) -> Any:
        broad_phase, _ = _kernels()
        while True:
            count = broad_phase.find_pairs(self._table, state, dt, MARGIN, self._gate, self._pairs)
            if count <= len(self._pairs):
                return self._pairs[:count]
            self._pairs = np.zeros((2 * count, 2), np.int64)

    def _closest_points(self, pairs: Any) -> tuple[Any, FloatArray]:
        """Bullet's lines of all pairs: where each pair's begin, and (k, 7) normal, point on b, distance."""
        bullet, client, engine = self._bullet, self._client, self._engine
        P, Q, reach = self._shapes.P, self._search.Q, self._search.reach
        moving = len(engine) - len(self._search.fixed)
        placed: set[int] = set()
        first, numbers = [0], array("d")
        for a, b in pairs.tolist():
            if engine[b] >= 0:
                for s in (a, b):
                    if s < moving and s not in placed:
                        placed.add(s)
                        bullet.resetBasePositionAndOrientation(
                            engine[s], P[s].tolist(), Q[s].tolist(), physicsClientId=client
                        )
                distance = float(reach[a] + reach[b]) + _ENGINE_SLACK
                for line in bullet.getClosestPoints(engine[a], engine[b], distance, physicsClientId=client):
                    numbers.extend(line[7])
                    numbers.extend(line[6])
                    numbers.append(line[8])
            first.append(len(numbers) // 7)
        found = np.array(numbers, dtype=np.float64).reshape(-1, 7)
        return np.array(first), found

    def _collect(self, pairs: Any, first: Any, found: FloatArray) -> Contacts:
        _, narrow_phase = _kernels()
        most = 32 * len(pairs)
        bodies, numbers = np.empty((most, 2), np.int64), np.empty((most, NUMBERS))
        keys, coefficients = np.empty(most, np.int64), np.empty((most, 2))
        n = narrow_phase.find_contacts(self._table, pairs, first, found, bodies, numbers, keys, coefficients)
        if n == 0:
            return NO_CONTACTS
        columns: tuple[Any, ...] = (
            bodies[:n, 0], bodies[:n, 1], numbers[:n, 0:3], numbers[:n, 3:6], numbers[:n, 6], keys[:n],
            coefficients[:n, 0], coefficients[:n, 1],
        )  # fmt: skip
        # The solver is compiled for contiguous columns.
        return Contacts(*(np.ascontiguousarray(column) for column in columns))


def _engine_attitude(placed: Placed) -> tuple[float, float, float, float]:
    """Attitude of Bullet's shape (w x y z) in the solid."""
    return multiply(placed.q, _AXIS) if isinstance(placed.shape, Cylinder | Capsule) else placed.q
