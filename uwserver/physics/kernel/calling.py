"""Entries that a kernel calls: by where their machine code lies (`straight.address_of`), which was compiled apart and is known when the kernel runs.

So one kernel can run all that a tick needs, which kinds of sensors it has or not, and nothing is compiled twice for it.
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
    """What calls entries that give such a result (a type of numba), by where their code lies and with a tuple of arguments."""

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
    """Call the entry whose code lies at an address with a tuple of arguments, of the very types for which it was compiled; it gives a whole number.
    What it raises is raised."""
    return _for_number(code, args)  # type: ignore[no-any-return]


@inlined
def call_for_float(code: int, args: Any) -> float:
    """The same of an entry that gives a float."""
    return _for_float(code, args)  # type: ignore[no-any-return]


@inlined
def call(code: int, args: Any) -> None:
    """The same of an entry that gives nothing."""
    _for_nothing(code, args)
