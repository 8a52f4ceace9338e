"""Calls of entries from a kernel, by the address of their machine code (`straight.address_of`).

The entries are compiled apart, and their addresses are known when the kernel runs. So one kernel can run a whole tick, whatever kinds of sensors a
world has, and nothing is compiled twice for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.types import unliteral  # type: ignore[attr-defined]  # made at run time
from numba.extending import intrinsic

from uwserver.physics.kernel.compiled import inlined


def caller(result: Any) -> Callable[[int, Any], Any]:
    """Return a function that calls entries with this type of result (a type of numba). It takes the address of their code and a tuple of
    arguments."""

    @intrinsic(prefer_literal=False)  # type: ignore[untyped-decorator]  # numba has no types
    def call(_typing: Any, code: Any, args: Any) -> Any:
        kinds = tuple(unliteral(kind) for kind in args.types)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            convention = context.call_conv
            form = convention.get_function_type(result, kinds)
            given = [
                context.cast(builder, value, kind, meant)
                for value, kind, meant in zip(cgutils.unpack_tuple(builder, values[1]), args.types, kinds, strict=True)
            ]
            function = builder.inttoptr(values[0], ir.PointerType(form))
            status, value = convention.call_function(builder, function, result, kinds, given)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return value if result is not types.none else context.get_dummy_value()

        return result(types.int64, args), generate

    return call  # type: ignore[no-any-return]


_for_number, _for_float, _for_nothing = caller(types.int64), caller(types.float64), caller(types.none)


@inlined
def call_for_number(code: int, args: Any) -> int:
    """Call an entry that returns a whole number: `code` is the address of its code, `args` a tuple of arguments of exactly the types for which it was
    compiled. Exceptions pass through."""
    return _for_number(code, args)  # type: ignore[no-any-return]


@inlined
def call_for_float(code: int, args: Any) -> float:
    """Call an entry that returns a float, as `call_for_number`."""
    return _for_float(code, args)  # type: ignore[no-any-return]


@inlined
def call(code: int, args: Any) -> None:
    """Call an entry that returns nothing, as `call_for_number`."""
    _for_nothing(code, args)
