"""What Python asks of compiled autopilots: to hear, to step, to go on with a step. Imports numba, so it is imported when there is an autopilot."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.autopilot import estimator, flight, sticks
from uwserver.autopilot.flight import NOTHING, SHOWN, START
from uwserver.autopilot.rows import FORMS, THRUSTER, WRENCH
from uwserver.autopilot.state import REASONS
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.sharing import share

_pilots, _devices, _curves = array_at(FORMS, "pilots"), array_at(FORMS, "devices"), array_at(FORMS, "curves")
_sources, _beacons, _ears = array_at(FORMS, "sources"), array_at(FORMS, "beacons"), array_at(FORMS, "ears")
_thrusters, _servos = array_at(layout.WORLD, "thrusters"), array_at(layout.WORLD, "servos")
_wrenches, _team = array_at(layout.WORLD, "wrenches"), array_at(layout.WORLD, "team")
_LEAST = 6  # that a thread steps at a time: some 5 us
_update, _fly, _stay = estimator.update.made(), flight.fly.made(), sticks.stay.made()
_set_course, _leave_bottom = sticks.set_course.made(), sticks.leave_bottom.made()
_show = flight.show.made()


@compiled
def _step(table: Array, world: Array, k: int, t_ns: int, stage: int) -> int:
    """Step, and command the actuators."""
    p = _pilots(table)[k]
    c = p.c
    devices = _devices(table)[c.device_first : c.device_first + c.device_count]
    need = _fly(p, devices, _curves(table), t_ns, stage)
    if c.gives != 0:
        for d in devices:
            d.part = d.force / d.full
            if d.active == 0:
                continue
            if d.kind == THRUSTER:
                thruster = _thrusters(world)[d.row]
                thruster.command, thruster.by_force, thruster.fresh = d.force, d.by_force, 1
            elif d.kind == WRENCH:
                _wrenches(world)[d.row].bias[d.component] = d.force
            else:
                _servos(world)[d.row].command = d.force
    return int(need)


@entry
def step_all(table: Array, world: Array, tick: int, t_ns: int) -> int:
    """Step all whose divisor divides the tick; returns how many need Python, as `need` of their rows says."""
    pilots, waiting = _pilots(table), 0
    share(_team(world), _step_range, (table, world, tick, t_ns), len(pilots), _LEAST)
    for k in range(len(pilots)):
        if pilots[k].c.need != NOTHING:
            waiting += 1
    return waiting


@compiled
def _step_range(first: int, end: int, me: int, table: Array, world: Array, tick: int, t_ns: int) -> None:
    pilots = _pilots(table)
    for k in range(first, end):
        c = pilots[k].c
        c.need = NOTHING
        if tick % c.divisor == 0:
            c.need = _step(table, world, k, t_ns, START)


@entry
def step_on(table: Array, world: Array, k: int, t_ns: int, stage: int) -> int:
    """Let one go on with its step; returns what it needs of Python."""
    return _step(table, world, k, t_ns, stage)


@entry
def hear_all(table: Array, told: Array, values: Array, count: int, now_ns: int) -> None:
    """Take delivered samples into the estimates of who hears them.

    Args:
        table: of the autopilots.
        told: records with `stream`, `t_ns` and `valid` of each sample.
        values: (n, w) their numbers.
        count: of samples.
        now_ns: simulation time.
    """
    pilots, sources, beacons, ears = _pilots(table), _sources(table), _beacons(table), _ears(table)
    for i in range(count):
        sample = told[i]
        ear = ears[sample.stream] if sample.valid != 0 else -1
        while ear >= 0:
            source = sources[ear]
            _update(pilots[source.pilot], source, beacons, values[i], sample.t_ns, now_ns)
            ear = source.next


@entry
def hear_one(table: Array, ear: int, values: Array, t_ns: int, now_ns: int) -> None:
    """Take one sample in, of a SOURCE."""
    source = _sources(table)[ear]
    _update(_pilots(table)[source.pilot], source, _beacons(table), values, t_ns, now_ns)


@entry
def stay_one(table: Array, k: int) -> None:
    """Put what no command has given where the vehicle is."""
    p = _pilots(table)[k]
    _stay(p.o, p.e)


@entry
def set_course_one(
    table: Array, k: int, north: float, east: float, down: float, heading: float, speed: float, radius: float
) -> None:
    """See `sticks.set_course`."""
    p = _pilots(table)[k]
    _set_course(p.o, p.e, north, east, down, heading, speed, radius)


@entry
def leave_bottom_one(table: Array, k: int) -> None:
    """See `sticks.leave_bottom`."""
    _leave_bottom(_pilots(table)[k].o)


@entry
def show_one(table: Array, k: int, t_ns: int, out: Array) -> None:
    """See `flight.show`."""
    _show(_pilots(table)[k], t_ns, out)


@entry
def tell_one(table: Array, k: int, t_ns: int, out: Array) -> int:
    """Write the row of numbers of a port `state` (`status`).

    Returns:
        Which texts belong to it: its mode, and that times REASONS the reason of its fail-safe.
    """
    p = _pilots(table)[k]
    c, shown, whole = p.c, np.empty(SHOWN), out.view(np.int64)
    _show(p, t_ns, shown)
    out[0], out[1:4], out[4], out[5:8] = shown[27], shown[0:3], shown[28], shown[3:6]
    out[8], out[9:13], out[13:16], out[16:18] = shown[29], shown[6:10], shown[10:13], shown[13:15]
    out[18:21], out[21:23], out[26:32] = shown[15:18], shown[18:20], shown[20:26]
    whole[23], whole[24], whole[25] = int(shown[30]), c.items, int(shown[31])
    devices = _devices(table)
    for n in range(c.device_count):
        out[32 + n] = devices[c.device_first + n].part
    return int(shown[26]) * len(REASONS) + int(shown[32])


ENTRIES: tuple[Any, ...] = (
    step_all,
    step_on,
    hear_all,
    hear_one,
    stay_one,
    set_course_one,
    leave_bottom_one,
    show_one,
    tell_one,
)
"""All of them."""


def load(told: Array) -> None:
    """Have all that stands here ready, compiled or from the cache, so that no tick waits for it.

    Args:
        told: records like those that `hear_all` gets.
    """
    table, number, values = np.zeros((0, 2), np.int64), 0, np.empty(0)
    given = (
        (table, table, number, number), (table, table, number, number, number), (table, told, np.empty((0, 0)), number, number),
        (table, number, values, number, number), (table, number), (table, number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (table, number),
        (table, number, number, values), (table, number, number, values),
    )  # fmt: skip
    for kernel, like in zip(ENTRIES, given, strict=True):
        kernel.load(*like)
