"""All solid things of one world, for contacts and for rays. It is made only if a scenario has something solid."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, Contacts, Finding
from uwserver.physics.collision.engine import AUTO
from uwserver.physics.collision.solids import Solids
from uwserver.physics.collision.ways import WaysOut
from uwserver.physics.geometry.rows import Stock
from uwserver.physics.geometry.shapes import Solid
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.casting import Instant, Rays, RayTargets, Still
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.surfaces import Surfaces


class Stocks(NamedTuple):
    """What worlds with the same solids share if one thread steps them: ways out of overlaps, and data that is only read."""

    ways: WaysOut
    stock: Stock
    surfaces: Surfaces


class Scene:
    """A `Collider` for contacts and a `Geometry` for rays of the same solids, with the same ids. Not thread-safe.

    Args:
        state: returns the present state (n, 13) of all bodies, for rays.
        engine: the collision engine, see `collision.engine`.
        stocks: data shared with other worlds; default: none, and an engine of its own.

    Raises:
        ImportError: the engine is not installed.
    """

    def __init__(self, state: Callable[[], FloatArray], engine: str = AUTO, stocks: Stocks | None = None) -> None:
        self._state = state
        self.stocks = Stocks(WaysOut(engine), Stock(), Surfaces()) if stocks is None else stocks
        self._solids, self._rays = Solids(ways=self.stocks.ways, stock=self.stocks.stock), Rays(self.stocks.surfaces)
        self._led: dict[int, int] = {}
        self._held: tuple[int, ...] = ()
        self._plain: Finding | None = None
        self._finding: Finding | None = None

    def add_static(self, solid: Solid) -> int:
        """Add a solid that never moves, placed in N, and return its id. Raise shapes.BadSolid if it is impossible."""
        body = self._solids.add_static(solid)
        self._rays.add_static(body, solid)
        return body

    def add_moving(self, solid: Solid, row: int, led: bool = False) -> int:
        """Add a solid that the body in `row` carries, placed in B, and return its id. Raise shapes.BadSolid if it is impossible.

        A body that is `led` from outside pushes others and does not yield: it has no contacts with static solids or with other led bodies.
        """
        body = self._solids.add_moving(solid, row)
        self._rays.add_moving(body, solid, row)
        if led:
            self._led[body] = row
        return body

    def remove(self, body: int) -> None:
        """Remove a solid. Raise KeyError if no solid has this id."""
        self._solids.remove(body)
        self._rays.remove(body)
        self._led.pop(body, None)

    def hold(self, rows: Collection[int]) -> None:
        """Let the bodies in these rows, and no others, have no contacts with static solids, with each other, or with led bodies: they stay where
        they are whatever acts on them. What can move touches them as before."""
        if tuple(rows) != self._held:
            self._held, self._plain = tuple(rows), None

    @property
    def _unyielding(self) -> list[int]:
        """Rows of the moving bodies that nothing pushes."""
        return [*self._led.values(), *self._held]

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Return contacts as `contacts.Collider` does."""
        contacts = self._solids.find_contacts(state, dt)
        unyielding = [-1, *self._unyielding]
        if len(unyielding) == 1 or contacts is NO_CONTACTS:
            return contacts
        felt = ~(np.isin(contacts.body_a, unyielding) & np.isin(contacts.body_b, unyielding))
        if felt.all():
            return contacts
        if not felt.any():
            return NO_CONTACTS
        columns: tuple[Any, ...] = tuple(np.ascontiguousarray(column[felt]) for column in contacts)
        return Contacts(*columns)  # contiguous: the solver is compiled for that

    def finding(self) -> Finding:
        """Return the search for compiled code, see `Solids.finding`."""
        finding = self._solids.finding()
        if finding is not self._plain:
            self._plain = self._finding = finding
            if self._unyielding:
                self._finding = finding._replace(led=np.array(self._unyielding, np.int64))
        assert self._finding is not None
        return self._finding

    def ray_targets(self) -> RayTargets:
        """Return what compiled code casts rays at, see `Rays.ray_targets`."""
        return self._rays.ray_targets()

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Cast rays as `Geometry` does, at the present places of the bodies."""
        return self._rays.at(self._state()).raycast(origin, direction, max_range)

    def still(self) -> Still:
        """Return a geometry of the bodies at their present places, for one other thread."""
        return self._rays.still(self._state())

    def without(self, row: int) -> Instant:
        """Return the geometry of this instant without the solids of the body in `row`: for a sensor that must not see its own vehicle."""
        return self._rays.at(self._state(), row)
