"""One kernel calls others by where their code lies: with the arguments that they were compiled for, in this process or another."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call, call_for_float, call_for_number
from uwserver.physics.kernel.compiled import entry, files_of
from uwserver.physics.kernel.straight import address_of


class Both(NamedTuple):
    """Two arrays."""

    first: Array
    second: Array


def make_sum() -> Any:
    @entry
    def weigh(table: Array, values: Array, both: Both, k: int, factor: float, is_bold: bool) -> int:
        values[0, 1] = factor
        both.second[0] = both.first[0] + 1
        if k > 100:
            raise ValueError("too much")
        return int(factor * (table[k] + len(both.first))) if is_bold else -1

    weigh.load(*given())
    return weigh


def given() -> tuple[Any, ...]:
    return np.arange(4), np.zeros((2, 2)), Both(np.array([5, 6]), np.zeros(1, np.int64)), 3, 2.5, True


@entry
def halve(value: float) -> float:
    return value / 2.0


@entry
def clear(values: Array) -> None:
    values[:] = 0.0


@entry
def drive(code: int, table: Array, values: Array, both: Both, k: int, factor: float) -> tuple[int, int]:
    return (
        call_for_number(code, (table, values, both, k, factor, True)),
        call_for_number(code, (table, values, both, 1, factor, False)),
    )


@entry
def drive_others(half: int, empty: int, values: Array) -> float:
    half_of = call_for_float(half, (values[0],))
    call(empty, (values,))
    return half_of


def test_a_kernel_calls_an_entry_that_was_compiled_apart() -> None:
    weigh = make_sum()
    table, values, both, k, factor, _ = given()
    assert drive(address_of(weigh, "int64"), table, values, both, k, factor) == (12, -1)
    assert values[0, 1] == 2.5
    assert both.second[0] == 6


def test_floats_come_back_and_nothing_comes_back() -> None:
    halve.load(1.0)
    clear.load(np.zeros(1))
    values = np.array([3.0, 4.0])
    assert drive_others(address_of(halve, "float64"), address_of(clear, "none"), values) == 1.5
    assert not values.any()


def test_what_it_raises_is_raised() -> None:
    weigh = make_sum()
    table, values, both, _, factor, _ = given()
    with pytest.raises(ValueError, match="too much"):
        drive(address_of(weigh, "int64"), table, values, both, 101, factor)


def test_an_entry_from_the_cache_is_called_the_same_way(tmp_path: Any) -> None:
    """Of such a one numba knows no more than its machine code."""
    addresses = []
    for _ in range(2):
        weigh = compiled.Entry(make_sum().py_func)
        weigh._cache = files_of(weigh.py_func, (), tmp_path, kept=True)
        weigh.load(*given())
        addresses.append(address_of(weigh, "int64"))
        table, values, both, k, factor, _ = given()
        assert drive(addresses[-1], table, values, both, k, factor) == (12, -1)
    assert weigh.stats.cache_hits == {next(iter(weigh.overloads)): 1}
    assert len(set(addresses)) == 2


def test_what_is_not_loaded_or_loaded_for_several_has_no_address() -> None:
    @entry
    def other(values: Array) -> None:
        values[:] = 1

    assert address_of(other, "none") == 0
    other.load(np.zeros(1))
    assert address_of(other, "none") != 0
    assert address_of(other, "int64") == 0, "it gives something else"
    other.load(np.zeros((1, 1)))
    assert address_of(other, "none") == 0
