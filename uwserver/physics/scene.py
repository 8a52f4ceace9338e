"""All solid things of one world, for contacts and for rays. Made when a scenario has something solid."""

from __future__ import annotations

from collections.abc import Callable
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
    """What worlds with the same solids have in common, if they are stepped in one thread: ways out of overlaps, and what all of them only read."""

    ways: WaysOut
    stock: Stock
    surfaces: Surfaces


class Scene:
    """A `contact.Collider` and a `geometry.Geometry` of the same solids, by the same ids. Not thread-safe.

    Args:
        state: gives the present state (n, 13) of all bodies, for rays.
        engine: of contacts, see `collision.engine`.
        stocks: what it has in common with other worlds; default: nothing, and an engine of its own.

    Raises:
        ImportError: the engine is not installed.
    """

    def __init__(self, state: Callable[[], FloatArray], engine: str = AUTO, stocks: Stocks | None = None) -> None:
        self._state = state
        self.stocks = Stocks(WaysOut(engine), Stock(), Surfaces()) if stocks is None else stocks
        self._solids, self._rays = Solids(ways=self.stocks.ways, stock=self.stocks.stock), Rays(self.stocks.surfaces)
        self._led: dict[int, int] = {}
        self._plain: Finding | None = None
        self._finding: Finding | None = None

    def add_static(self, solid: Solid) -> int:
        """Add something that never moves, placed in N; returns its id. Raises shapes.BadSolid."""
        body = self._solids.add_static(solid)
        self._rays.add_static(body, solid)
        return body

    def add_moving(self, solid: Solid, row: int, led: bool = False) -> int:
        """Add what the body in `row` carries, placed in B; returns its id. Raises shapes.BadSolid.

        A body that is `led` from outside pushes others and yields to nothing: it has no contacts with what does not move, nor with its like.
        """
        body = self._solids.add_moving(solid, row)
        self._rays.add_moving(body, solid, row)
        if led:
            self._led[body] = row
        return body

    def remove(self, body: int) -> None:
        """Take a solid away; KeyError if there is none of this id."""
        self._solids.remove(body)
        self._rays.remove(body)
        self._led.pop(body, None)

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """As `contact.Collider`."""
        contacts = self._solids.find_contacts(state, dt)
        if not self._led or contacts is NO_CONTACTS:
            return contacts
        unyielding = [-1, *self._led.values()]
        felt = ~(np.isin(contacts.body_a, unyielding) & np.isin(contacts.body_b, unyielding))
        if felt.all():
            return contacts
        if not felt.any():
            return NO_CONTACTS
        columns: tuple[Any, ...] = tuple(np.ascontiguousarray(column[felt]) for column in contacts)
        return Contacts(*columns)  # contiguous: the solver is compiled for that

    def finding(self) -> Finding:
        """See `Solids.finding`."""
        finding = self._solids.finding()
        if finding is not self._plain:
            self._plain = self._finding = finding
            if self._led:
                self._finding = finding._replace(led=np.array([*self._led.values()], np.int64))
        assert self._finding is not None
        return self._finding

    def ray_targets(self) -> RayTargets:
        """See `Rays.ray_targets`."""
        return self._rays.ray_targets()

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """As `geometry.Geometry`, where the bodies are now."""
        return self._rays.at(self._state()).raycast(origin, direction, max_range)

    def still(self) -> Still:
        """The same as a geometry for one other thread, with the bodies where they are now."""
        return self._rays.still(self._state())

    def without(self, row: int) -> Instant:
        """The same at this instant, but for what the body in `row` carries: for who shall not see what it is mounted on."""
        return self._rays.at(self._state(), row)
