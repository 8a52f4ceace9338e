"""Many arrays as one argument of a kernel: the table that `layout.addresses` makes.

numba unwraps each array that Python hands it, which for those of a world takes longer than to step a vehicle. So a call gets one array of
addresses and lengths instead, and the kernel lays its arrays over them. Such arrays count no references either: the owner of the
table keeps the real ones alive, and makes a new table whenever it replaces one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from uwserver.physics.kernel.compiled import inlined
from uwserver.physics.kernel.layout import (
    BODY,
    DERIVATIVE,
    FLOW_SIZE,
    FOIL,
    HULL,
    LAG,
    PROPELLER,
    SERVO,
    SHAPE,
    STATE_SIZE,
    TABLE,
    THRUSTER,
    WEIGHT,
    WRENCH,
    Fitted,
    Rows,
)

Array = Any  # numpy array inside compiled code


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def _pointer(_context: Any, address: Any) -> Any:
    """An address as a pointer."""

    def generate(_ctx: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.voidptr(address), generate


@inlined
def pointer_at(table: Array, k: int) -> Any:
    """Where array k of a table begins, for `carray`."""
    return _pointer(table[k, 0])


@inlined
def rows_at(table: Array) -> Rows:
    """`layout.Rows` of a world's table: these, then `Fitted`, states and flows."""
    return Rows(
        carray(pointer_at(table, 0), (table[0, 1],), BODY),
        carray(pointer_at(table, 1), (table[1, 1],), SHAPE),
        carray(pointer_at(table, 2), (table[2, 1],), THRUSTER),
        carray(pointer_at(table, 3), (table[3, 1],), TABLE),
        carray(pointer_at(table, 4), (table[4, 1],), LAG),
        carray(pointer_at(table, 5), (table[5, 1],), WRENCH),
    )


@inlined
def fitted_at(table: Array) -> Fitted:
    """`layout.Fitted` of a world's table."""
    return Fitted(
        carray(pointer_at(table, 6), (table[6, 1],), SERVO),
        carray(pointer_at(table, 7), (table[7, 1],), FOIL),
        carray(pointer_at(table, 8), (table[8, 1],), PROPELLER),
        carray(pointer_at(table, 9), (table[9, 1],), WEIGHT),
        carray(pointer_at(table, 10), (table[10, 1],), DERIVATIVE),
        carray(pointer_at(table, 11), (table[11, 1],), HULL),
    )


@inlined
def is_fitted(table: Array) -> bool:
    """Whether any body of a world's table has appendages."""
    return bool(table[6:12, 1].any())


@inlined
def state_at(table: Array) -> Array:
    """(n, 13) states of a world's table."""
    return carray(pointer_at(table, 12), (table[12, 1], STATE_SIZE), np.float64)


@inlined
def flows_at(table: Array) -> Array:
    """(n, FLOW_SIZE) water at the bodies of a world's table."""
    return carray(pointer_at(table, 13), (table[13, 1], FLOW_SIZE), np.float64)
