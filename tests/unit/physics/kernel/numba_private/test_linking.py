"""Entries are made of parts: one version of a part for all constants, names that mean nothing outside, and nothing left to call."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba.core import types

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry, inlined, separate

ROW_A, ROW_B = 0, 2


@separate
def cube(x: float) -> float:
    return x * x * x


@inlined
def at(rows: Array, row: int) -> float:
    return float(rows[row])


@compiled
def power(rows: Array, row: int) -> float:
    return cube(at(rows, row))


@entry
def total(rows: Array) -> float:
    return power(rows, ROW_A) + power(rows, ROW_B) + power(rows, 1)


def test_an_entry_calls_parts_of_every_kind_through_parts() -> None:
    assert total(np.array([1.0, 2.0, 3.0])) == 1.0 + 8.0 + 27.0


def test_a_row_that_a_constant_names_makes_no_version_of_its_own() -> None:
    total(np.zeros(3))
    assert list(power.overloads) == [(types.Array(types.float64, 1, "C"), types.int64)]


def test_a_part_can_be_called_as_tests_do() -> None:
    assert power(np.array([1.0, 2.0, 3.0]), 1) == 8.0
    assert cube(2) == 8


def test_only_the_doors_can_be_seen_from_outside() -> None:
    """That for Python, and what lies behind it, for kernels that call it."""
    total(np.zeros(3))
    (made,) = total.overloads.values()
    functions = [f for f in made.library._final_module.functions if not f.is_declaration]
    seen = {f.name for f in functions if f.linkage.name == "external"}
    assert seen == {made.fndesc.llvm_cpython_wrapper_name, made.fndesc.llvm_func_name}
    assert any("cube" in f.name for f in functions)  # `separate`


def test_closures_of_one_name_keep_apart() -> None:
    def times(factor: float):  # type: ignore[no-untyped-def]
        @compiled
        def scale(x: float) -> float:
            return factor * x

        @entry
        def door(x: float) -> float:
            return scale(x)

        return door

    doors = [times(factor) for factor in (2.0, 3.0)]
    assert [door(1.0) for door in doors] == [2.0, 3.0]


def test_an_entry_is_not_for_kernels() -> None:
    @entry
    def above(rows: Array) -> float:
        return total(rows)

    with pytest.raises(numba.errors.TypingError, match="total is an entry: kernels call what is `compiled`"):
        above(np.zeros(3))


def test_an_exception_of_a_part_comes_through() -> None:
    @compiled
    def refuse(x: float) -> float:
        if x < 0.0:
            raise ValueError("negative")
        return x

    @entry
    def door(x: float) -> float:
        return refuse(x)

    assert door(1.0) == 1.0
    with pytest.raises(ValueError, match="negative"):
        door(-1.0)
