"""The order of a tick, in compiled code. There is one, whether a program steps the world, a clock paces it, or it runs as fast as it can.

Where a tick needs Python, `step` stops and returns the stage. Python does its part, and the next call goes on behind that stage. Imports numba.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.atomics import load_atomic
from uwserver.physics.kernel.calling import call, call_for_number
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at
from uwserver.sensors.surroundings import FORMS as SURROUNDINGS
from uwserver.step import bodies, rows, streams
from uwserver.step.bodies import seconds_of, time_of
from uwserver.step.readings import brings_large, is_measured, measure, needs_room
from uwserver.step.rows import (
    ARRIVALS,
    BEGIN,
    DIVERGED,
    DONE,
    DRAW,
    END,
    FIND,
    FLOW,
    FORCES,
    LISTEN,
    MOVE,
    PILOTS,
    ROOM,
    UNIT,
    WHEN_CALLED,
)

_course, _run, _ends, _world, _surroundings, _pilots = (
    array_at(rows.FORMS, name) for name in ("course", "run", "ends", "world", "surroundings", "pilots")
)
_delivered, _counts = (array_at(streams.FORMS, name) for name in ("delivered", "counts"))
_drifts, _intervals = array_at(rows.FORMS, "drifts"), array_at(rows.FORMS, "intervals")
_place, _uniform = array_at(SURROUNDINGS, "place"), array_at(SURROUNDINGS, "uniform")


@compiled
def _waits_for_python(table: Array) -> bool:
    """Step the autopilots that are due. Returns whether some of them need Python."""
    course, run = _course(table)[0], _run(table)[0]
    given = _pilots(table), _world(table), run.tick, time_of(course, run.tick)
    return bool(call_for_number(course.step_pilots, given) != 0)


@compiled
def _begins_interval(table: Array) -> bool:
    """Return whether a drifting current needs its next velocity, which Python draws."""
    tick, found = _run(table)[0].tick, False
    for interval in _intervals(table):
        found = found or tick % interval == 0
    return found


@compiled
def _move_water(table: Array) -> None:
    """Set the uniform part of the water velocity to that of the present tick. Between two draws a drifting current changes linearly."""
    course, run, surroundings, drifts, intervals = (
        _course(table)[0],
        _run(table)[0],
        _surroundings(table),
        _drifts(table),
        _intervals(table),
    )
    if course.fill_flows == 0:
        return
    uniform, steady = _uniform(surroundings), _place(surroundings)[0].current
    for a in range(3):
        uniform[a], uniform[3 + a] = steady[a], 0.0
    uniform[6] = seconds_of(course, run.tick)
    for k in range(len(intervals)):
        for a in range(3):
            change = (drifts[k, 1, a] - drifts[k, 0, a]) / intervals[k]
            uniform[a] += drifts[k, 0, a] + (run.tick % intervals[k]) * change
            uniform[3 + a] += change / course.dt


@compiled
def _before_and_move(table: Array) -> int:
    """Make the first half of a tick, until the bodies stand at t + dt. Returns why it stops, or DONE."""
    course, run = _course(table)[0], _run(table)[0]
    if run.stage == PILOTS:
        run.stage = FORCES
        if course.step_pilots != 0 and run.tick % course.pilots_every == 0:
            if _waits_for_python(table):
                return PILOTS
            if is_measured(run, PILOTS, 0):
                return UNIT
    if run.stage == FORCES:
        run.stage = FIND
        if run.tick >= run.forces_tick:
            return FORCES
    if run.stage == FIND:
        run.stage = MOVE
        bodies.fill_flows(table, 0.5 * course.dt)
        if bodies.can_touch(table):
            if run.finds != 0 or not bodies.find_contacts(table):
                return FIND
            if is_measured(run, FIND, 0):
                return UNIT
    if run.stage == MOVE:
        run.stage = DRAW
        touches = bodies.may_touch(table)
        lost = bodies.move(table)
        if lost >= 0:
            run.tick += 1
            run.which = lost
            return DIVERGED
        if is_measured(run, MOVE, touches):
            return UNIT
    if run.stage == DRAW:
        run.tick += 1
        run.stage = FLOW
        if _begins_interval(table):
            return DRAW
    if run.stage == FLOW:
        run.stage, run.round = ARRIVALS, WHEN_CALLED
        _move_water(table)
        run.t_ns = time_of(course, run.tick)
        if run.t_ns >= run.follow_ns:
            return FLOW
    return DONE


@compiled
def _go_on(table: Array, sensors: Array, values: Array, delivered_values: Array) -> int:
    """Go on with a tick from its present stage. Returns why it stops, or DONE at its end.

    The order is part of the contract (`world.part.Stage`). Python does three things before: it begins and ends faults; it carries out what was
    posted, so that a command acts in the tick that its reply names; it checks the watchdogs, which these commands may feed. Then come:

    1. autopilots: they know the commands of this tick and the samples that were delivered by t;
    2. forces from outside, for instance of a tether, from the states at t;
    3. actuators, bodies and water together, from t to t + dt;
    4. the water of t + dt, which sensors measure, and the bodies that follow poses from outside;
    5. sensors and the delivery of samples, from the new states (`measure` states their order);
    6. listeners: they get what was delivered, and act on it in the next tick.
    """
    run, counts = _run(table)[0], _counts(sensors)[0]
    if run.stage < ARRIVALS:
        why = _before_and_move(table)
        if why != DONE:
            return why
    if run.stage < LISTEN:
        why = measure(table, sensors, values, delivered_values)
        if why != DONE:
            return why
    if run.stage == LISTEN:
        run.stage = END
        if run.begun != 0 and counts.delivered > 0 and _course(table)[0].listen != 0:
            given = _pilots(table), _delivered(sensors), delivered_values, counts.delivered, run.t_ns
            call(_course(table)[0].listen, given)
            if is_measured(run, LISTEN, 0):
                return UNIT
    run.stage = BEGIN
    is_read = counts.logged > run.logged
    if is_read:
        _ends(table)[run.ends] = counts.logged
        run.ends += 1
    has_loose = run.begun != 0 and counts.loose > 0
    is_looked_at = run.looks_back == 2 or (is_read and run.looks_back == 1)
    return END if has_loose or is_looked_at or (run.slow != 0 and run.begun != 0) else DONE


@entry
def step(
    table: Array, sensors: Array, values: Array, delivered_values: Array, posted: Array, room: int, log_room: int
) -> int:
    """Make ticks until Python is needed, all of them are made, or something is posted.

    The interpreter lock is released meanwhile, so that other threads run Python.

    Args:
        table: made by `rows.FORMS`.
        sensors, values, delivered_values: see `delivery.deliver`.
        posted: (1) other than 0 as soon as another thread has something for the world: the present tick is the last then.
        room, log_room: the number of samples for which there is room: in flight or delivered in one tick, and in the log.

    Returns:
        Why it stops (`rows`). The next call goes on behind that.
    """
    run, counts = _run(table)[0], _counts(sensors)[0]
    why = DONE
    while why == DONE:
        if run.stage == BEGIN:
            done = run.tick - run.first
            if run.tick >= run.until or (done > 0 and load_atomic(posted, 0) != 0):
                break
            if done > 0 and brings_large(table, sensors):
                break
            if needs_room(table, sensors, values.shape[1], room, log_room):
                why = DONE if done > 0 else ROOM
                break
            run.stage, run.begun, run.logged = PILOTS, 0, counts.logged
        why = _go_on(table, sensors, values, delivered_values)
    return why


def load() -> None:
    """Make the kernel ready: compile it, or load it from the cache."""
    table, values = np.zeros((0, 2), np.int64), np.empty((0, 1))
    cast("Any", step).load(table, table, values, values, rows.NOTHING_POSTED, 0, 0)
