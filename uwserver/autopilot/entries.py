"""The compiled code of autopilots that Python and the step call. Imports numba, so it is imported only when there is an autopilot."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.autopilot import estimator, flight, sticks
from uwserver.autopilot.flight import NOTHING, START
from uwserver.autopilot.rows import FORMS, THRUSTER, WRENCH
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.sharing import share

_pilots, _devices, _curves = array_at(FORMS, "pilots"), array_at(FORMS, "devices"), array_at(FORMS, "curves")
_sensors, _beacons, _listeners = array_at(FORMS, "sensors"), array_at(FORMS, "beacons"), array_at(FORMS, "listeners")
_thrusters, _servos = array_at(layout.WORLD, "thrusters"), array_at(layout.WORLD, "servos")
_wrenches, _team = array_at(layout.WORLD, "wrenches"), array_at(layout.WORLD, "team")
_LEAST = 6
"""Autopilots that a thread steps in one go: about 5 us."""
_update, _fly, _stay = estimator.update.made(), flight.fly.made(), sticks.stay.made()
_tell = flight.tell.made()


@compiled
def _devices_of(table: Array, c: Any) -> Array:
    """Return the DEVICE rows of a vehicle."""
    return _devices(table)[c.device_first : c.device_first + c.device_count]


@compiled
def _step(table: Array, world: Array, k: int, t_ns: int, stage: int) -> int:
    """Make or continue the step of one autopilot, and write its commands into the rows of the actuators. Returns what it needs Python for."""
    p = _pilots(table)[k]
    c, devices = p.c, _devices_of(table, p.c)
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
    """Step all autopilots whose divisor divides the tick. Returns how many need Python: `need` of their rows says for what."""
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
    """Continue the step of one autopilot at a stage. Returns what it needs Python for."""
    return _step(table, world, k, t_ns, stage)


@entry
def listen_all(table: Array, delivered: Array, values: Array, count: int, now_ns: int) -> None:
    """Correct the estimates of all autopilots that read the streams of delivered samples.

    Args:
        table: table of the autopilots.
        delivered: records with `stream`, `t_ns` and `valid` of each sample.
        values: (n, w) numbers of each sample.
        count: number of samples.
        now_ns: simulation time.
    """
    pilots, sensors, beacons, listeners = _pilots(table), _sensors(table), _beacons(table), _listeners(table)
    for i in range(count):
        sample = delivered[i]
        listener = listeners[sample.stream] if sample.valid != 0 else -1
        while listener >= 0:
            sensor = sensors[listener]
            _update(pilots[sensor.pilot], sensor, beacons, values[i], sample.t_ns, now_ns)
            listener = sensor.next


@entry
def listen_one(table: Array, listener: int, values: Array, t_ns: int, now_ns: int) -> None:
    """Correct the estimate by one sample of the SENSOR `listener`."""
    sensor = _sensors(table)[listener]
    _update(_pilots(table)[sensor.pilot], sensor, _beacons(table), values, t_ns, now_ns)


@entry
def stay_one(table: Array, k: int) -> None:
    """See `sticks.stay`."""
    p = _pilots(table)[k]
    _stay(p.o, p.e)


@entry
def tell_one(table: Array, k: int, t_ns: int, out: Array) -> int:
    """See `flight.tell`."""
    p = _pilots(table)[k]
    return int(_tell(p, _devices_of(table, p.c), t_ns, out))


ENTRIES: tuple[Any, ...] = (
    step_all,
    step_on,
    listen_all,
    listen_one,
    stay_one,
    tell_one,
)


def load(delivered: Array) -> None:
    """Make all entries ready, so that no tick waits for them: compile them, or load them from the cache.

    Args:
        delivered: records like those that `listen_all` gets.
    """
    table, number, values = np.zeros((0, 2), np.int64), 0, np.empty(0)
    given = (
        (table, table, number, number), (table, table, number, number, number), (table, delivered, np.empty((0, 0)), number, number),
        (table, number, values, number, number), (table, number), (table, number, number, values),
    )  # fmt: skip
    for kernel, like in zip(ENTRIES, given, strict=True):
        kernel.load(*like)
