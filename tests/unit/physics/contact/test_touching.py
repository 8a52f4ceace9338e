"""The contacts that a world keeps from tick to tick, and those that were found for the next."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.collision.contacts import NO_CONTACTS, NO_IMPULSES, Contacts, Impulses
from uwserver.physics.contact.touching import COLUMNS, FORMS, FOUND, KEPT, ROOM, Touching


def some(n: int, first: int = 0) -> Impulses:
    """Contacts of n bodies with what stands still; all numbers differ."""
    rows, numbers = np.arange(first, first + n), np.arange(float(3 * n)).reshape(n, 3)
    contacts = Contacts(
        rows, np.full(n, -1), numbers, numbers + 0.25, numbers[:, 0], rows + 100, numbers[:, 1], numbers[:, 2]
    )
    return Impulses(contacts, numbers + 0.5, numbers + 0.75)


def same(one: Impulses, other: Impulses) -> bool:
    columns = zip((*one.contacts, *one[1:]), (*other.contacts, *other[1:]), strict=True)
    return all(np.array_equal(a, b) for a, b in columns)


def test_the_columns_are_those_of_contacts_and_what_was_found_stands_first() -> None:
    """By which compiled code finds them."""
    assert [*COLUMNS] == [*Contacts._fields]
    assert [*FORMS][:8] == [f"found_{name}" for name in COLUMNS]


def test_what_is_kept_is_told_and_nothing_is_nothing() -> None:
    touching = Touching()
    assert touching.kept is NO_IMPULSES
    assert not touching.is_kept
    touching.keep(some(3))
    assert touching.is_kept
    assert same(touching.kept, some(3))
    touching.keep(NO_IMPULSES)
    assert touching.kept is NO_IMPULSES


def test_what_was_found_is_not_what_the_last_tick_had() -> None:
    touching = Touching()
    touching.keep(some(2))
    touching.find(some(4, first=7).contacts)
    assert touching._counts[[FOUND, KEPT]].tolist() == [4, 2]
    assert touching._rows["found_body_a"][:4].tolist() == [7, 8, 9, 10]
    assert same(touching.kept, some(2))
    touching.find(NO_CONTACTS)
    assert touching._counts[FOUND] == 0


@pytest.mark.parametrize("needed", [1, ROOM, ROOM + 1, 5 * ROOM])
def test_more_room_is_another_one_with_the_same_contacts(needed: int) -> None:
    touching = Touching()
    touching.keep(some(ROOM))
    larger = touching.with_room(needed)
    assert (larger is touching) == (needed <= ROOM)
    assert larger.room >= needed
    assert same(larger.kept, some(ROOM))


def test_a_body_that_goes_takes_its_contacts_along_and_who_kept_the_others_has_them() -> None:
    touching = Touching()
    touching.keep(some(3))
    rest = touching.without(1)
    assert rest.kept.contacts.body_a.tolist() == [0, 2]
    assert rest.kept.hold.tolist() == some(3).hold[[0, 2]].tolist()
    assert same(touching.kept, some(3)), "so that it can be undone"
    assert not rest.without(0).without(2).is_kept
