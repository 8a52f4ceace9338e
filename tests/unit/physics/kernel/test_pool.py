"""Rows that are taken and given back: always zero, never another's, and decided by what was taken before alone."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics.kernel.pool import Pool

RECORD = np.dtype([("a", "f8"), ("b", "i8")])


def test_rows_keep_what_is_in_them_as_the_pool_grows():
    pool = Pool(RECORD, 1)
    for k in range(100):
        first = pool.take(3)
        assert first == 3 * k
        assert not pool.rows[first : first + 3]["a"].any()
        pool.rows["a"][first : first + 3] = k
    assert pool.rows["a"][:300].tolist() == [float(k) for k in range(100) for _ in range(3)]


def test_what_was_given_back_is_taken_again_and_is_zero():
    pool = Pool(np.float64)
    one, two, three = pool.take(2), pool.take(4), pool.take(2)
    pool.rows[:8] = 7.0
    pool.give_back(two, 4)
    pool.give_back(one, 2)
    assert pool.take(4) == two
    assert pool.take(2) == one
    assert pool.rows[:8].tolist() == [0.0] * 6 + [7.0] * 2
    assert pool.take(2) == three + 2  # nothing of this size is free


def test_a_range_is_not_cut():
    """Two rows of four that are free would leave two that nobody of four may have."""
    pool = Pool(np.float64)
    pool.give_back(pool.take(4), 4)
    assert pool.take(2) == 4


def test_nothing_is_nothing():
    pool = Pool(np.float64)
    first = pool.take(0)
    pool.give_back(first, 0)
    assert pool.take(1) == first


@pytest.mark.parametrize("room", [1, 16])
def test_the_place_does_not_depend_on_the_room(room):
    pool = Pool(np.float64, room)
    places = [pool.take(n) for n in (1, 5, 2, 5)]
    pool.give_back(places[1], 5)
    assert [*places, pool.take(5), pool.take(5)] == [0, 1, 6, 8, 1, 13]
