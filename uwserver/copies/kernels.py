"""What compiled code does for all copies: each loop carries out for one copy after the other what its world does with the same arrays.

`which` holds the numbers of the copies that are meant. The tables of addresses of their arrays are stacked: (n, arrays, 2). Imports numba.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.autopilot import entries
from uwserver.physics.dynamics import flow, integrator
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at, fitted_at, state_at
from uwserver.physics.kernel.layout import WORLD, Forms, SeaRows, columns
from uwserver.sensors import surroundings
from uwserver.step import delivery, streams
from uwserver.units import NANOSECONDS

ENDS: Forms = {"ends": columns(np.float64, 3)}
"""Of the table of a drifting current (`Drift.ends`)."""


def _part(kernel: Any) -> Any:
    """What an entry does, for a kernel to call."""
    return compiled(kernel.py_func)


_fill_flows, _deliver = _part(flow.fill_flows), _part(delivery.deliver)
_step_all, _hear_all = _part(entries.step_all), _part(entries.hear_all)

_bodies, _thrusters = array_at(WORLD, "bodies"), array_at(WORLD, "thrusters")
_servos, _wrenches = array_at(WORLD, "servos"), array_at(WORLD, "wrenches")
_uniform, _profiles = array_at(surroundings.FORMS, "uniform"), array_at(surroundings.FORMS, "profiles")
_waves, _place = array_at(surroundings.FORMS, "waves"), array_at(surroundings.FORMS, "place")
_nu_dot, _tau = array_at(surroundings.FORMS, "nu_dot"), array_at(surroundings.FORMS, "tau")
_streams, _numbers = array_at(streams.FORMS, "streams"), array_at(streams.FORMS, "numbers")
_told, _counts = array_at(streams.FORMS, "told"), array_at(streams.FORMS, "counts")
_ends = array_at(ENDS, "ends")


@entry
def tick(which: Array, clocks: Any, num: int, den: int) -> None:
    """Carry the clocks of copies on by a tick, of num / den a second; no number becomes larger than a time in ns or a few num."""
    whole, rest = 2 * NANOSECONDS * den // (2 * num), 2 * NANOSECONDS * den % (2 * num)
    for i in which:
        clocks.ticks[i] += 1
        clocks.ts[i] = clocks.ticks[i] * den / num
        clocks.t_ns[i] += whole
        clocks.rests[i] += rest
        if clocks.rests[i] >= 2 * num:
            clocks.rests[i] -= 2 * num
            clocks.t_ns[i] += 1


@entry
def find_due(which: Array, clocks: Any, divisors: Array, told: Array, nows: Array, due: Array, masks: Array) -> int:
    """Which of these copies have something to read or to deliver; what is read from now on belongs to the instants of their clocks.

    Args:
        which, clocks, nows: of the copies.
        divisors: (k) sensors of group k read each so many ticks.
        told: (n, 3) as of `deliver`.
        due: (n) receives the numbers of these copies.
        masks: (n) receives bit k where group k is due, for those.

    Returns:
        How many there are; less 1, as a negative number, where their masks differ.
    """
    count, alike = 0, True
    for i in which:
        mask = 0
        for k in range(len(divisors)):
            if clocks.ticks[i] % divisors[k] == 0:
                mask |= 1 << k
        if mask != 0 or clocks.t_ns[i] >= told[i, 2]:
            _place(nows[i])[0].t_ns = clocks.t_ns[i]
            due[count], masks[count] = i, mask
            alike = alike and mask == masks[0]
            count += 1
    return count if alike else -1 - count


@entry
def advance(which: Array, worlds: Array, ts: Array, dt: float, lost: Array, me: int) -> int:
    """Carry the bodies of copies without appendages from ts (n, s) on; `lost` (n) receives the row of a body that diverged, or -1.

    `me`: the thread, which finds its work space by it. Returns how many diverged.
    """
    count = 0
    for i in which:
        lost[i] = integrator.advance_alone(me, worlds[i], None, ts[i], dt)
        count += lost[i] >= 0
    return count


@entry
def advance_fitted(which: Array, worlds: Array, ts: Array, dt: float, lost: Array, me: int) -> int:
    """`advance` with appendages."""
    count = 0
    for i in which:
        lost[i] = integrator.advance_alone(me, worlds[i], fitted_at(worlds[i]), ts[i], dt)
        count += lost[i] >= 0
    return count


@entry
def look(which: Array, worlds: Array, nows: Array, ts: Array, me: int) -> None:
    """Fill in accelerations and wrenches of copies without appendages."""
    for i in which:
        integrator.rates_alone(me, worlds[i], None, ts[i], _nu_dot(nows[i]), _tau(nows[i]))


@entry
def look_fitted(which: Array, worlds: Array, nows: Array, ts: Array, me: int) -> None:
    """`look` with appendages."""
    for i in which:
        integrator.rates_alone(me, worlds[i], fitted_at(worlds[i]), ts[i], _nu_dot(nows[i]), _tau(nows[i]))


@entry
def fill_flows(which: Array, worlds: Array, nows: Array, ts: Array, ahead: float) -> None:
    """Find the water at all bodies, `ahead` s after ts; where there is a sea."""
    for i in which:
        sea = SeaRows(_uniform(nows[i]), _profiles(nows[i]), _waves(nows[i]))
        _fill_flows(worlds[i], sea, ts[i], ahead)


@entry
def move_sea(
    which: Array, nows: Array, ticks: Array, ts: Array, drifts: Array, intervals: Array, steady: Array, dt: float
) -> None:
    """Carry the uniform part of each sea to its tick, as `Sea.hold`; what is drawn anew was drawn before.

    Args:
        which, nows: copies and what their sensors see.
        ticks, ts: (n) tick and time (s) of each.
        drifts: (n, k, 1, 2) tables of the ends of the k drifting currents.
        intervals: (k) ticks from draw to draw.
        steady: (n, 3) steady part of the velocity in N, m/s.
        dt: s a tick.
    """
    for i in which:
        uniform = _uniform(nows[i])
        for a in range(3):
            uniform[a], uniform[3 + a] = steady[i, a], 0.0
        uniform[6] = ts[i]
        for k in range(len(intervals)):
            ends = _ends(drifts[i, k])
            for a in range(3):
                step = (ends[1, a] - ends[0, a]) / intervals[k]
                uniform[a] += ends[0, a] + (ticks[i] % intervals[k]) * step
                uniform[3 + a] += step / dt


@entry
def deliver(
    which: Array, senses: Array, due: Array, t_ns: Array, begins: bool, values: Array, told_values: Array, told: Array
) -> None:
    """See `delivery.deliver`; `told` (n, 3) receives how many samples compiled code hears, are on their way, and when (ns) the next one arrives."""
    for i in which:
        told[i, 0] = _deliver(senses[i], due, t_ns[i], begins, values[i], told_values[i])
        counts = _counts(senses[i])[0]
        told[i, 1], told[i, 2] = counts.pending, counts.next_ns


@entry
def hear(which: Array, pilots: Array, senses: Array, told_values: Array, told: Array, t_ns: Array) -> None:
    """Let the autopilots of each copy hear what was delivered."""
    for i in which:
        if told[i, 0] > 0:
            _hear_all(pilots[i], _told(senses[i]), told_values[i], told[i, 0], t_ns[i])


@entry
def fly(which: Array, pilots: Array, worlds: Array, ticks: Array, t_ns: Array, waiting: Array) -> None:
    """Step the autopilots that are due; `waiting` (n) receives how many of each copy need Python."""
    for i in which:
        waiting[i] = _step_all(pilots[i], worlds[i], ticks[i], t_ns[i])


@entry
def command_thrusters(which: Array, worlds: Array, rows: Array, values: Array, by_force: int) -> None:
    """Commands (n, m) for thrusters of these rows (m); those of copies that are not meant do not matter."""
    for i in which:
        thrusters = _thrusters(worlds[i])
        for k in range(len(rows)):
            thruster = thrusters[rows[k]]
            thruster.command, thruster.by_force, thruster.fresh = values[i, k], by_force, 1


@entry
def command_servos(which: Array, worlds: Array, rows: Array, values: Array) -> None:
    """Set points (n, m) for servos of these rows (m)."""
    for i in which:
        servos = _servos(worlds[i])
        for k in range(len(rows)):
            servos[rows[k]].command = values[i, k]


@entry
def command_wrench(which: Array, worlds: Array, row: int, values: Array) -> None:
    """Force and moment (n, 6) of one row of wrenches."""
    for i in which:
        bias = _wrenches(worlds[i])[row].bias
        for k in range(6):
            bias[k] = values[i, k]


@entry
def copy_states(worlds: Array, row: int, out: Array) -> None:
    """The states of one body of each copy, into `out` (n, 13)."""
    for i in range(len(worlds)):
        state = state_at(worlds[i])[row]
        for k in range(len(state)):
            out[i, k] = state[k]


@entry
def copy_newest(senses: Array, stream: int, values: Array, stamps: Array) -> None:
    """The newest delivered sample of a stream of each copy.

    Args:
        senses: tables of the sensors.
        stream: its number.
        values: (n, w) receives the numbers, nan before the first sample.
        stamps: (n, 4) receives seq, t_ns, t_sent_ns (-1 before the first) and whether it is valid.
    """
    for i in range(len(senses)):
        row, numbers = _streams(senses[i])[stream], _numbers(senses[i])
        there = row.newest != 0
        for k in range(row.width):
            values[i, k] = numbers[row.newest_first + k] if there else math.nan
        stamps[i, 0] = row.seq if there else -1
        stamps[i, 1] = row.t_ns if there else -1
        stamps[i, 2] = row.t_sent_ns if there else -1
        stamps[i, 3] = row.valid if there else 0
