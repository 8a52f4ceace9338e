"""Many arrays as one argument of a kernel: reads the table that `layout.addresses` makes.

numba unwraps each array that Python passes, which for the arrays of a world takes longer than to step a vehicle. So a call passes one array of
addresses and lengths, and the kernel makes its arrays from them. These arrays have no reference counts either: the owner of the table keeps the real
ones alive, and makes a new table whenever it replaces one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import inlined
from uwserver.physics.kernel.layout import WORLD, Fitted, Forms, Model


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def _pointer(_context: Any, address: Any) -> Any:
    """Return an address as a pointer."""

    def generate(_ctx: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.voidptr(address), generate


@inlined
def view_at(address: int, count: int) -> Array:
    """Return an array of int64 over the memory at an address. Laid over records, it represents them in a call (`calling`) of code that knows their
    form."""
    return carray(_pointer(address), (count,), np.int64)


def array_at(forms: Forms, name: str) -> Callable[[Array], Array]:
    """Return a compiled function that returns one array of a table made by `forms`."""
    k, item, shape = list(forms).index(name), forms[name].base, forms[name].shape

    @inlined
    def at(table: Array) -> Array:
        return carray(_pointer(table[k, 0]), (table[k, 1], *shape), item)

    return at


def arrays_at(kind: type[Any], forms: Forms) -> Callable[[Array], Any]:
    """Return a compiled function that returns all fields of a NamedTuple from a table made by `forms`; each is found by its name."""
    # Compiled code cannot loop over arrays of different types, so the source of the call is generated, as `namedtuple` itself does.
    scope: dict[str, Any] = {"__name__": __name__, **{name: array_at(forms, name) for name in kind._fields}}
    calls = ", ".join(f"{name}(table)" for name in kind._fields)
    exec(f"def read(table): return kind({calls})", scope | {"kind": kind}, scope)
    return cast("Callable[[Array], Any]", inlined(scope["read"]))


model_at = arrays_at(Model, WORLD)
fitted_at = arrays_at(Fitted, WORLD)
state_at = array_at(WORLD, "state")
flows_at = array_at(WORLD, "flows")
scratch_at = array_at(WORLD, "scratch")
team_at = array_at(WORLD, "team")
