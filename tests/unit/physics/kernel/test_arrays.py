"""The types that names of arrays mean, rows joined end to end, and pools of rows."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Pool, Records, joined
from uwserver.physics.kernel.layout import SERVO, THRUSTER, WORLD, addresses


def scalar(array: Any) -> Any:
    """The type of an element of ``NDArray[...]``."""
    (element,) = get_args(get_args(array)[1])
    return element


@pytest.mark.parametrize(("array", "element"), [(FloatArray, np.float64), (IntArray, np.int64), (Records, np.void)])
def test_each_name_is_of_one_element(array: Any, element: type[np.generic]) -> None:
    assert scalar(array) is element


def test_arrays_of_a_world_are_numbers_or_records() -> None:
    hydro = Hydrodynamics((), 0.01)
    assert addresses(WORLD, vars(hydro)).dtype == scalar(IntArray)
    for name in WORLD:
        array = getattr(hydro, name)
        kind = IntArray if name == "team" else Records if array.dtype.names else FloatArray
        assert array.dtype.type is scalar(kind), name


def rows(n: int, seed: int) -> np.ndarray:
    made = np.zeros(n, THRUSTER)
    made.view(np.float64)[:] = np.random.default_rng(seed).normal(size=made.view(np.float64).shape)
    return made


def test_rows_stand_one_after_the_other_bit_for_bit() -> None:
    a, b = rows(2, 1), rows(3, 2)
    together = joined([a, b[:0], b], THRUSTER)
    assert together.dtype == THRUSTER
    assert together.tobytes() == a.tobytes() + b.tobytes()


def test_they_are_new_and_can_be_written() -> None:
    a = rows(2, 1)
    before = a.tobytes()
    together = joined([a], THRUSTER)
    together["command"] = 0.5
    assert a.tobytes() == before


def test_nothing_is_an_empty_array() -> None:
    assert joined([], SERVO).dtype == SERVO
    assert len(joined([], SERVO)) == 0


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
