"""The contacts of a world as arrays with room: those that were found for the coming tick, and those of the last one with their impulses."""

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
"""Of `Contacts`."""

FORMS: Forms = {
    **{f"found_{name}": form for name, form in COLUMNS.items()},
    **COLUMNS,
    "impulse": columns(np.float64, 3),
    "hold": columns(np.float64, 3),
    "counts": columns(np.int64),
}
"""Of the table for compiled code: what was found, then what the last tick had, and how many they are (`FOUND`, `KEPT`)."""

FOUND, KEPT = 0, 1
ROOM = 64


class Touching:
    """The contacts of a world. When there is no room for more, another one takes its place (`with_room`).

    Attributes:
        table: by which compiled code finds them.
        room: for so many.
    """

    def __init__(self, room: int = ROOM) -> None:
        self.room = room
        self._rows: dict[str, Any] = {name: np.zeros((room, *form.shape), form.base) for name, form in FORMS.items()}
        self._counts: IntArray = np.zeros(2, np.int64)
        self._rows["counts"] = self._counts
        self.table: IntArray = addresses(FORMS, self._rows)

    def with_room(self, needed: int) -> Touching:
        """This, or a larger one with the same contacts of the last tick."""
        if needed <= self.room:
            return self
        larger = Touching(max(needed, 2 * self.room))
        larger.keep(self.kept)
        return larger

    def without(self, row: int) -> Touching:
        """Another one, without the contacts of a body: who comes into its row would begin with the impulses of who left it."""
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
        """Those of the last tick: views, which hold until the next."""
        n = int(self._counts[KEPT])
        if not n:
            return NO_IMPULSES
        columns_ = (self._rows[name][:n] for name in COLUMNS)
        return Impulses(Contacts(*columns_), self._rows["impulse"][:n], self._rows["hold"][:n])

    def keep(self, impulses: Impulses) -> None:
        """These are those of the last tick; there is room."""
        n = len(impulses.contacts.gap)
        for name, column in zip((*COLUMNS, "impulse", "hold"), (*impulses.contacts, *impulses[1:]), strict=True):
            self._rows[name][:n] = column
        self._counts[KEPT] = n

    def find(self, contacts: Contacts) -> None:
        """These were found for the coming tick; there is room."""
        n = len(contacts.gap)
        for name, column in zip(COLUMNS, contacts, strict=True):
            self._rows[f"found_{name}"][:n] = column
        self._counts[FOUND] = n
