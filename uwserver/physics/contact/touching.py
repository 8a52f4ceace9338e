"""The contacts of a world in arrays with spare room: those that were found for the coming tick, and those of the last one with their impulses."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.collision.contacts import NO_IMPULSES, Contacts, Impulses
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import Forms, addresses, columns

COLUMNS: Forms = {
    "body_a": columns(np.int64),
    "body_b": columns(np.int64),
    "point": columns(np.float64, 3),
    "normal": columns(np.float64, 3),
    "gap": columns(np.float64),
    "key": columns(np.int64),
    "friction": columns(np.float64),
    "restitution": columns(np.float64),
}
"""The arrays of `Contacts`."""

FORMS: Forms = {
    **{f"found_{name}": form for name, form in COLUMNS.items()},
    **COLUMNS,
    "impulse": columns(np.float64, 3),
    "hold": columns(np.float64, 3),
    "counts": columns(np.int64),
}
"""The table for compiled code: the contacts that were found, then those of the last tick, and the numbers of both (`FOUND`, `KEPT`)."""

FOUND, KEPT = 0, 1
ROOM = 64


class Touching:
    """The contacts of a world. If there is no room for more, a larger object takes its place (`with_room`).

    Attributes:
        table: addresses of the arrays, for compiled code.
        room: number of contacts that fit.
    """

    def __init__(self, room: int = ROOM) -> None:
        self.room = room
        self._rows: dict[str, Any] = {name: np.zeros((room, *form.shape), form.base) for name, form in FORMS.items()}
        self._counts: IntArray = np.zeros(2, np.int64)
        self._rows["counts"] = self._counts
        self.table: IntArray = addresses(FORMS, self._rows)

    def with_room(self, needed: int) -> Touching:
        """Return this object, or a larger one with the same contacts of the last tick."""
        if needed <= self.room:
            return self
        larger = Touching(max(needed, 2 * self.room))
        larger.keep(self.kept)
        return larger

    def without(self, row: int) -> Touching:
        """Return another object without the contacts of a body. Otherwise a new body in its row would begin with the impulses of the old one."""
        contacts, *impulses = self.kept
        others = (contacts.body_a != row) & (contacts.body_b != row)
        rest = Touching(self.room)
        if others.any():
            rest.keep(Impulses(Contacts(*(column[others] for column in contacts)), *(i[others] for i in impulses)))
        return rest

    @property
    def is_kept(self) -> bool:
        """Whether there were contacts in the last tick."""
        return bool(self._counts[KEPT])

    @property
    def kept(self) -> Impulses:
        """The contacts of the last tick: views that are valid until the next tick."""
        n = int(self._counts[KEPT])
        if not n:
            return NO_IMPULSES
        columns_ = (self._rows[name][:n] for name in COLUMNS)
        return Impulses(Contacts(*columns_), self._rows["impulse"][:n], self._rows["hold"][:n])

    def keep(self, impulses: Impulses) -> None:
        """Store the contacts of the last tick. They must fit."""
        n = len(impulses.contacts.gap)
        for name, column in zip((*COLUMNS, "impulse", "hold"), (*impulses.contacts, *impulses[1:]), strict=True):
            self._rows[name][:n] = column
        self._counts[KEPT] = n

    def find(self, contacts: Contacts) -> None:
        """Store the contacts that were found for the coming tick. They must fit."""
        n = len(contacts.gap)
        for name, column in zip(COLUMNS, contacts, strict=True):
            self._rows[f"found_{name}"][:n] = column
        self._counts[FOUND] = n
