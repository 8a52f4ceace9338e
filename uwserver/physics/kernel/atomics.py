"""Atomic operations in compiled code on numbers that several threads read and write, and ways to wait for such a number."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from uwserver.physics.kernel.places import FUTEX, PAUSE

WORD, BYTES = ir.IntType(64), ir.IntType(8).as_pointer()


def place_of(builder: Any, context: Any, kinds: Any, args: Any) -> Any:
    """Return a pointer to a number of an array."""
    data = context.make_array(kinds[0])(context, builder, args[0]).data
    return builder.gep(data, [args[1]])


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def load_atomic(_context: Any, numbers: Any, k: Any) -> Any:
    """Read a number that other threads write."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load_atomic(place_of(builder, context, signature.args, args), "seq_cst", 8)

    return types.int64(numbers, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def store_atomic(_context: Any, numbers: Any, k: Any, value: Any) -> Any:
    """Write a number that other threads read."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store_atomic(args[2], place_of(builder, context, signature.args, args), "seq_cst", 8)
        return context.get_dummy_value()

    return types.none(numbers, types.int64, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def add_atomic(_context: Any, numbers: Any, k: Any, value: Any) -> Any:
    """Add to a number to which other threads also add."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.atomic_rmw("add", place_of(builder, context, signature.args, args), args[2], "seq_cst")
        return context.get_dummy_value()

    return types.none(numbers, types.int64, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def exchange_atomic(_context: Any, numbers: Any, k: Any, old: Any, new: Any) -> Any:
    """Write `new` if the number is still `old`; return whether it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = place_of(builder, context, signature.args, args)
        return builder.extract_value(builder.cmpxchg(place, args[2], args[3], "seq_cst", "seq_cst"), 1)

    return types.boolean(numbers, types.int64, types.int64, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def pause(_context: Any) -> Any:
    """Tell the processor that this loop waits."""

    def generate(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        if PAUSE:
            numbers = [ir.IntType(32)(k) for k in PAUSE[1:]]
            kind = ir.FunctionType(ir.VoidType(), [number.type for number in numbers])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, PAUSE[0]), numbers)
        return context.get_dummy_value()

    return types.none(), generate


@intrinsic  # type: ignore[untyped-decorator]
def futex(_context: Any, numbers: Any, k: Any, operation: Any, value: Any) -> Any:
    """Sleep while the low half of a number is `value`, or wake up to `value` sleepers, depending on the operation of the system call."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if FUTEX:
            place = builder.bitcast(place_of(builder, context, signature.args, args), BYTES)
            kind = ir.FunctionType(WORD, [WORD], var_arg=True)
            call = cgutils.get_or_insert_function(builder.module, kind, "syscall")
            builder.call(call, [WORD(FUTEX), place, args[2], args[3], BYTES(None), BYTES(None), WORD(0)])
        return context.get_dummy_value()

    return types.none(numbers, types.int64, types.int64, types.int64), generate
