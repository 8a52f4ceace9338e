"""Islands of bodies in contact, against connected components found by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.contact.islands import fill_slots, find_islands
from uwserver.physics.kernel.arrays import IntArray


def slots_of(*columns: list[int], rows: int = 20) -> tuple[list[IntArray], IntArray]:
    """Places of the bodies that each column of contacts names, and the bodies in their places."""
    slot_of, bodies, count = np.full(rows, -1), np.empty(rows, np.int64), 0
    out = []
    for column in columns:
        slots = np.empty(len(column), np.int64)
        count = fill_slots(np.array(column, np.int64), slot_of, bodies, count, slots)
        out.append(slots)
    return out, bodies[:count]


def islands_of(a: list[int], b: list[int], m: int) -> list[list[int]]:
    order, bounds = np.empty(len(a), np.int64), np.empty(len(a) + 1, np.int64)
    count = find_islands(np.array(a, np.int64), np.array(b, np.int64), m, order, bounds)
    return [order[bounds[i] : bounds[i + 1]].tolist() for i in range(count)]


def test_bodies_get_places_in_the_order_of_their_contacts() -> None:
    (a, b), bodies = slots_of([7, 3, 7, 5], [-1, 7, 9, -1])
    assert bodies.tolist() == [7, 3, 5, 9]
    assert a.tolist() == [0, 1, 0, 2]
    assert b.tolist() == [-1, 0, 3, -1]


def test_no_contacts_have_no_bodies_and_no_islands() -> None:
    (a,), bodies = slots_of([])
    assert len(a) == len(bodies) == 0
    assert islands_of([], [], 0) == []


def test_what_does_not_move_joins_nobody() -> None:
    """Two bodies on one ground are two islands."""
    assert islands_of([0, 1, 0], [-1, -1, -1], 2) == [[0, 2], [1]]


def test_a_chain_is_one_island_whatever_the_order_of_its_links() -> None:
    assert islands_of([2, 0, 1], [3, 1, 2], 4) == [[0, 1, 2]]
    assert islands_of([0, 2, 1], [1, 3, 2], 4) == [[0, 1, 2]]


def test_islands_and_their_contacts_keep_the_order_of_the_contacts() -> None:
    assert islands_of([4, 0, 4, 2, 0], [5, 1, -1, 3, -1], 6) == [[0, 2], [1, 4], [3]]


@pytest.mark.parametrize("seed", range(10))
def test_random_contacts_against_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, k = 12, int(rng.integers(1, 15))
    a = rng.integers(0, m, k).tolist()
    b = [int(x) for x in rng.integers(-1, m, k)]
    b = [y if y != x else -1 for x, y in zip(a, b, strict=True)]
    label = list(range(m))
    for _ in range(m):  # labels spread along contacts until nothing changes
        for x, y in zip(a, b, strict=True):
            if y >= 0:
                label[x] = label[y] = min(label[x], label[y])
    expected: dict[int, list[int]] = {}
    for c, x in enumerate(a):
        expected.setdefault(label[x], []).append(c)
    assert islands_of(a, b, m) == list(expected.values())
