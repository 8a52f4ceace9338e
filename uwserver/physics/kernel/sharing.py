"""Loops of kernels that several threads share. The rows are cut into ranges; each free thread takes the next range until none is left.

The caller publishes the addresses of the loop's code and arguments, runs ranges from the first row on, and waits for the other threads, which run
ranges from the last row on. The caller waits only for ranges that another thread has begun, never for a thread that sleeps or has no core. So sharing
is never much slower than running alone. Each range writes only its own rows, so that the results do not depend on the number of threads or on which
thread runs which range.

All of it happens in compiled code, without the interpreter. A thread waits for work (`serve`) first by spinning, then asleep in the kernel of the
operating system (a futex of Linux). The threads share one array of numbers, the team (`uwserver.physics.kernel.team`).
"""

from __future__ import annotations

from typing import Any, cast

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.atomics import (
    BYTES,
    WORD,
    add_atomic,
    exchange_atomic,
    futex,
    load_atomic,
    pause,
    store_atomic,
)
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.places import (
    ASLEEP,
    CHUNK,
    CLAIM,
    CODE,
    COUNT,
    DATA,
    DONE,
    FAILED,
    JOB,
    SPIN,
    STOP,
    THREADS,
    WAITING,
)
from uwserver.physics.kernel.plain import IS_PLAIN

_BITS = 12
MOST_RANGES = (1 << _BITS) - 1
"""Most ranges into which a loop is cut."""
_MASK = MOST_RANGES
_PATIENCE = 2000  # turns, some 50 us, for a range that another has begun
_FUTEX_WAIT, _FUTEX_WAKE, _ALL = 128, 129, 1 << 30  # of one process

_RANGE = ir.FunctionType(ir.IntType(32), [BYTES, WORD, WORD, WORD])
"""Type of the code that other threads run: arguments, first row, end, number of the thread; it returns 0 if all went well."""


@intrinsic(prefer_literal=False)  # type: ignore[untyped-decorator]
def _task(typing: Any, loop: Any, args: Any) -> Any:
    """Return the addresses of the code and of the arguments of a loop. The arguments lie on the stack of the caller."""
    numbers = (types.int64, types.int64, types.int64)
    called = loop.get_call_type(typing, (*numbers, *args.types), {})

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        result = loop.dispatcher.overloads[tuple(called.args)]
        context.add_linking_libs([result.library])
        name = f"{builder.function.name}.ranges"
        function = ir.Function(builder.module, _RANGE, name)
        function.linkage = "internal"
        inner = ir.IRBuilder(function.append_basic_block("entry"))
        data, *rows = function.args
        held = inner.load(inner.bitcast(data, values[1].type.as_pointer()))
        given = [*rows, *cgutils.unpack_tuple(inner, held)]
        kinds = (*numbers, *args.types)
        cast = [context.cast(inner, v, a, b) for v, a, b in zip(given, kinds, called.args, strict=True)]
        status, _ = context.call_internal_no_propagate(inner, result.fndesc, called, cast)
        inner.ret(inner.zext(status.is_error, ir.IntType(32)))
        place = cgutils.alloca_once_value(builder, values[1])
        both = [builder.ptrtoint(function, WORD), builder.ptrtoint(place, WORD)]
        return context.make_tuple(builder, signature.return_type, both)

    pair = types.UniTuple(types.int64, 2)  # type: ignore[attr-defined]  # made at run time
    return pair(loop, args), generate


@intrinsic  # type: ignore[untyped-decorator]
def _call(_context: Any, code: Any, data: Any, first: Any, end: Any, me: Any) -> Any:
    """Run a range; return whether it succeeded."""

    def generate(_ctx: Any, builder: Any, _signature: Any, args: Any) -> Any:
        function = builder.inttoptr(args[0], _RANGE.as_pointer())
        status = builder.call(function, [builder.inttoptr(args[1], BYTES), *args[2:]])
        return builder.icmp_signed("==", status, ir.IntType(32)(0))

    return types.boolean(*[types.int64] * 5), generate


@compiled
def _share(team: Array, code: int, data: int, count: int, least: int) -> bool:
    # Eight ranges for each thread: with one for each, all would wait for the slowest thread.
    size = max(least, (count + 8 * team[THREADS] - 1) // (8 * team[THREADS]), count // MOST_RANGES + 1)
    ranges = (count + size - 1) // size
    job = team[JOB] + 1
    team[CODE], team[DATA], team[COUNT], team[CHUNK] = code, data, count, size
    store_atomic(team, DONE, 0)
    store_atomic(team, FAILED, 0)
    store_atomic(team, CLAIM, _claim(job, 0, ranges))
    store_atomic(team, JOB, job)
    if load_atomic(team, ASLEEP) > 0:
        futex(team, JOB, _FUTEX_WAKE, _ALL)
    _await(team, ranges - _run(team, job, 0))
    return bool(load_atomic(team, FAILED) == 0)


@compiled
def _claim(job: int, low: int, high: int) -> int:
    """Pack the ranges of a job that no thread has begun into one number, so that they can be changed atomically."""
    return (job << 2 * _BITS) | (low << _BITS) | high


@compiled
def _run(team: Array, job: int, me: int) -> int:
    """Take ranges of a job until none is left, and return how many. The caller (`me` 0) takes the first one each time, other threads take the last
    one."""
    taken = 0
    while True:
        claim = load_atomic(team, CLAIM)
        low, high = (claim >> _BITS) & _MASK, claim & _MASK
        if claim >> 2 * _BITS != job or low == high:
            return taken
        # As long as the claim is unchanged, these values belong to this job.
        code, data, count, size = (
            load_atomic(team, CODE),
            load_atomic(team, DATA),
            load_atomic(team, COUNT),
            load_atomic(team, CHUNK),
        )
        k = low if me == 0 else high - 1
        left = _claim(job, low + 1, high) if me == 0 else _claim(job, low, high - 1)
        if not exchange_atomic(team, CLAIM, claim, left):
            continue
        if not _call(code, data, k * size, min(count, (k + 1) * size), me):
            store_atomic(team, FAILED, 1)
        taken += 1
        if me != 0:
            add_atomic(team, DONE, 1)
            if load_atomic(team, WAITING) != 0:
                futex(team, DONE, _FUTEX_WAKE, _ALL)


@compiled
def _await(team: Array, ranges: int) -> None:
    """Wait until other threads have done this number of ranges."""
    turns = 0
    while True:
        done = load_atomic(team, DONE)
        if done == ranges:
            return
        turns += 1
        if turns < _PATIENCE:
            pause()
            continue
        store_atomic(team, WAITING, 1)
        futex(team, DONE, _FUTEX_WAIT, done)
        store_atomic(team, WAITING, 0)


def _among_threads(team: Array, loop: Any, args: Any, count: int, least: int) -> None:
    code, data = _task(loop, args)
    if team[THREADS] < 2 or count < 2 * least:
        if not _call(code, data, 0, count, 0):
            raise MemoryError
        return
    if not _share(team, code, data, count, least):
        raise MemoryError


def _alone(team: Array, loop: Any, args: Any, count: int, least: int) -> None:
    loop(0, count, 0, *args)


share = compiled(_alone if IS_PLAIN else _among_threads)
"""Run ``loop(first, end, me, *args)`` for ranges that together are the rows 0 to `count`, with all threads of a team.

Args:
    team: of `team.Team`.
    loop: a `compiled` function without a result. What it writes for a row must not depend on what it writes for others. `me`, the number of the
        thread, selects work space.
    args: tuple of its arguments.
    count: rows.
    least: the fewest rows in a range, enough to take 5 us or more. A loop with fewer than twice as many rows is not shared.

Raises:
    MemoryError: there is no memory for an array that a range allocates.
"""


@entry
def serve(team: Array, me: int) -> None:
    """Run ranges as thread number `me` (1 and more) of a team, until the team ends."""
    job = 0
    while True:
        turns = 0
        while load_atomic(team, JOB) == job:
            turns += 1
            if turns < load_atomic(team, SPIN):
                pause()
                continue
            add_atomic(team, ASLEEP, 1)
            futex(team, JOB, _FUTEX_WAIT, job)
            add_atomic(team, ASLEEP, -1)
        job = load_atomic(team, JOB)
        if load_atomic(team, STOP) != 0:
            return
        _run(team, job, me)


@entry
def stop(team: Array) -> None:
    """Let all threads of a team end when they are idle."""
    store_atomic(team, STOP, 1)
    store_atomic(team, JOB, team[JOB] + 1)
    futex(team, JOB, _FUTEX_WAKE, _ALL)


def load(team: Array) -> None:
    """Load or compile the kernels of this module for a team."""
    for kernel, given in ((serve, (team, 1)), (stop, (team,))):
        cast("Any", kernel).load(*given)
