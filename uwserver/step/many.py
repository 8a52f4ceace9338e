"""Kernels for many worlds in one call. Each world makes its ticks by `tick.step`, one world after the other. Imports numba.

In every kernel `copies` has a row for each world (`rows.COPY`), and `which` holds the numbers of the worlds that are meant.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call_for_number
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, state_at, view_at
from uwserver.physics.kernel.layout import WORLD
from uwserver.physics.kernel.straight import address_of
from uwserver.step import rows, streams, tick
from uwserver.step.rows import DONE

_run = array_at(rows.FORMS, "run")
_thrusters, _servos, _wrenches = (array_at(WORLD, name) for name in ("thrusters", "servos", "wrenches"))
_streams, _numbers = array_at(streams.FORMS, "streams"), array_at(streams.FORMS, "numbers")
_OF_STEP, _OF_SENSORS, _OF_WORLD = len(rows.FORMS), len(streams.FORMS), len(WORLD)
_SCRATCH = list(WORLD).index("scratch")


@compiled
def _table(address: int, count: int) -> Array:
    """Return the table of `count` arrays at an address."""
    return view_at(address, 2 * count).reshape(count, 2)


@compiled
def _values(address: int, room: int, width: int) -> Array:
    """Return the array (room, width) at an address."""
    return view_at(address, room * width).view(np.float64).reshape(room, width)


@entry
def step_each(which: Array, copies: Array, code: int, ticks: int, posted: Array, scratch: int) -> int:
    """Let each world make its ticks until it needs Python; `why` of its row then says for what.

    Args:
        which: numbers of worlds.
        copies: (n) of `rows.COPY`.
        code: address of `tick.step`.
        ticks: number of ticks; 0: go on behind a stop, to the end of the call before.
        posted: as of `tick.step`.
        scratch: address of the work space of this thread.

    Returns:
        How many worlds have stopped before their last tick.
    """
    stopped = 0
    for i in which:
        copy = copies[i]
        table, sensors = _table(copy.table, _OF_STEP), _table(copy.sensors, _OF_SENSORS)
        world = _table(copy.world, _OF_WORLD)
        world[_SCRATCH, 0], world[_SCRATCH, 1] = scratch, 1
        run = _run(table)[0]
        if ticks > 0:
            run.first, run.until = run.tick, run.tick + ticks
            run.ends = run.written = 0
        values, delivered_values = (
            _values(copy.values, copy.room, copy.width),
            _values(copy.delivered_values, copy.room, copy.width),
        )
        copy.why = call_for_number(code, (table, sensors, values, delivered_values, posted, copy.room, copy.log_room))
        copy.tick = run.tick
        stopped += copy.why != DONE
    return stopped


@entry
def command_thrusters(which: Array, copies: Array, numbers: Array, values: Array, by_force: int) -> None:
    """Give commands (n, m) to the thrusters with these numbers (m). Rows of worlds that are not meant are ignored."""
    for i in which:
        thrusters = _thrusters(_table(copies[i].world, _OF_WORLD))
        for k in range(len(numbers)):
            thruster = thrusters[numbers[k]]
            thruster.command, thruster.by_force, thruster.fresh = values[i, k], by_force, 1


@entry
def command_servos(which: Array, copies: Array, numbers: Array, values: Array) -> None:
    """Give set points (n, m) to the servos with these numbers (m)."""
    for i in which:
        servos = _servos(_table(copies[i].world, _OF_WORLD))
        for k in range(len(numbers)):
            servos[numbers[k]].command = values[i, k]


@entry
def command_wrench(which: Array, copies: Array, number: int, values: Array) -> None:
    """Set force and moment (n, 6) of one row of the wrenches."""
    for i in which:
        bias = _wrenches(_table(copies[i].world, _OF_WORLD))[number].bias
        for k in range(6):
            bias[k] = values[i, k]


@entry
def copy_states(copies: Array, row: int, out: Array) -> None:
    """Write the state of one body of each world into `out` (n, 13)."""
    for i in range(len(copies)):
        state = state_at(_table(copies[i].world, _OF_WORLD))[row]
        for k in range(len(state)):
            out[i, k] = state[k]


@entry
def copy_newest(copies: Array, stream: int, values: Array, stamps: Array) -> None:
    """Write the newest delivered sample of a stream of each world.

    Args:
        copies: (n) of `rows.COPY`.
        stream: number of the stream.
        values: (n, w) receives the numbers, nan before the first sample.
        stamps: (n, 4) receives seq, t_ns, t_sent_ns (-1 before the first) and whether it is valid.
    """
    for i in range(len(copies)):
        sensors = _table(copies[i].sensors, _OF_SENSORS)
        row, numbers = _streams(sensors)[stream], _numbers(sensors)
        there = row.newest != 0
        for k in range(row.width):
            values[i, k] = numbers[row.newest_first + k] if there else math.nan
        stamps[i, 0] = row.seq if there else -1
        stamps[i, 1] = row.t_ns if there else -1
        stamps[i, 2] = row.t_sent_ns if there else -1
        stamps[i, 3] = row.valid if there else 0


KERNELS = step_each, command_thrusters, command_servos, command_wrench, copy_states, copy_newest


def code() -> int:
    """Return the address of `tick.step`."""
    tick.load()
    return address_of(tick.step, "int64")


def load() -> None:
    """Make the kernels ready: compile them, or load them from the cache."""
    which, values = np.zeros(0, np.int64), np.zeros((0, 1))
    nobody = np.zeros(0, rows.COPY)
    like: tuple[tuple[Any, ...], ...] = (
        (which, nobody, 0, 0, rows.NOTHING_POSTED, 0),
        (which, nobody, which, values, 0),
        (which, nobody, which, values),
        (which, nobody, 0, values),
        (nobody, 0, values),
        (nobody, 0, values, np.zeros((0, 4), np.int64)),
    )
    for kernel, given in zip(KERNELS, like, strict=True):
        cast("Any", kernel).load(*given)
