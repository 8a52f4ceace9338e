"""One step of one autopilot: estimate, fail-safes, guidance, control and allocation; and the reading of its port `state`.

Compiled code. Rare events are handled in Python: the step then stops and returns what it needs, and continues at a later stage when that is done.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.autopilot import modes
from uwserver.autopilot.allocation import (
    FINS,
    THRUSTERS,
    allocate_fins,
    allocate_thrusters,
    allocate_wrench,
    command_for,
)
from uwserver.autopilot.estimator import go_on
from uwserver.autopilot.hover import hover
from uwserver.autopilot.rows import (
    ACRO,
    GUIDED,
    HEADING_HOLD,
    MANUAL,
    MISSION,
    NO_FRAME,
    POSITION_HOLD,
    STABILISE,
    THRUSTER,
    set_six,
)
from uwserver.autopilot.state import NAN, REASONS
from uwserver.autopilot.sticks import goes_at_altitude, heading_of, stay, within
from uwserver.autopilot.torpedo import speed_ahead, torpedo
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, separate

NOTHING, READY, FAILSAFE, BEGIN, DONE, ARRIVED, PROGRESS = range(7)
"""What a step needs Python for: the sensors that it waited for have come (READY); a fail-safe is due; an item of the mission begins, or is done; the
vehicle has arrived, or its progress is due."""

START, WATCH, STEER, CONTROL = range(4)
"""Stages of a step."""

WAYPOINT, HOLD, SPEED, HEADING, COME_UP = range(5)
"""Kinds of items of a mission."""

PROGRESS_S = 0.5
"""Time between two reports of progress."""
_TURNED_RAD = 0.05
"""A turn is done when the heading is off by less than this."""
_LEAK, _BATTERY = REASONS.index("leak"), REASONS.index("battery")
_NEEDED = modes.NEEDED
_known = compiled(modes.known)


@separate
def fly(p: Any, devices: Array, curves: Array, t_ns: int, stage: int) -> int:
    """Make a step, or continue one.

    Args:
        p: PILOT; `gives` of its SPEC becomes 1 if the step makes new commands, which are then in `force` of the devices.
        devices: its DEVICE rows.
        curves: curves of all devices.
        t_ns: simulation time.
        stage: at which the step begins or continues.

    Returns:
        What it needs Python for before it continues, or NOTHING at the end.
    """
    e, o, c = p.e, p.o, p.c
    now = _known(e, o.gains, t_ns)
    c.gives = 0
    if stage == START:
        go_on(e, c, not now.motion, not now.depth)
        if o.waits != 0 and not _lacks(o.mode, now):
            return READY
        if o.armed == 0 or o.waits != 0:
            stay(o, e)
            return NOTHING
    if stage <= WATCH and _is_in_trouble(e, o, now):
        return FAILSAFE
    if c.testing != 0:
        for d in devices:
            d.force = d.test * d.full
        c.gives = 1
        return NOTHING
    if stage <= STEER:
        need = _guidance_event(e, o, c)
        if need != NOTHING:
            return int(need)
    _control(p, devices, curves, now)
    return NOTHING


@compiled
def _lacks(mode: int, now: Any) -> bool:
    """Return whether a mode lacks something that it needs."""
    for need, there in zip(_NEEDED[mode], now):  # noqa: B905, SIM110 - compiled code knows neither `strict` nor `any`
        if need and not there:
            return True
    return False


@compiled
def _is_in_trouble(e: Any, o: Any, now: Any) -> bool:
    """Return whether a fail-safe is due."""
    reason = o.failsafe
    leaks = e.leak != 0 and reason != _LEAK
    runs_down = e.charge < o.gains.battery_low and reason not in (_LEAK, _BATTERY)
    loses_or_finds_bottom = goes_at_altitude(o) and now.altitude == (o.blind != 0)
    return bool(_lacks(o.mode, now) or leaks or runs_down or loses_or_finds_bottom)


@compiled
def _guidance_event(e: Any, o: Any, c: Any) -> int:
    """Return whether an item of the mission begins or ends, or a `goto` has arrived or is to report its progress."""
    if o.mode == MISSION:
        if o.index < 0:
            return NOTHING
        if o.entered == 0:
            return BEGIN
        return DONE if _is_done(e, o, c) else NOTHING
    if c.errand == 0:
        return NOTHING
    if _distance(e, o, c) <= o.radius:
        return ARRIVED
    c.silence += c.dt
    return PROGRESS if c.silence >= PROGRESS_S else NOTHING


@compiled
def _distance(e: Any, o: Any, c: Any) -> float:
    """Return the distance to the place, m. The depth counts, except for a torpedo at a commanded altitude, whose depth varies with the bottom."""
    x, y, z = o.place[0] - e.p[0], o.place[1] - e.p[1], o.place[2] - e.p[2]
    if c.torpedo != 0 and goes_at_altitude(o):
        z = 0.0
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _is_done(e: Any, o: Any, c: Any) -> bool:
    """Return whether the present item of the mission is done."""
    if c.item == WAYPOINT:
        if o.waited == 0.0 and _distance(e, o, c) > o.radius:
            return False
        o.waited += c.dt
        o.settled = 1
        return bool(o.waited >= c.lasts)
    if c.item == HOLD:
        o.waited += c.dt
        return bool(o.waited >= c.lasts)
    if c.item == HEADING:
        return bool(c.torpedo != 0 or abs(within(o.heading - heading_of(e))) < _TURNED_RAD)
    if c.item == COME_UP:
        return bool(e.p[2] < c.up)
    return True


@compiled
def _control(p: Any, devices: Array, curves: Array, now: Any) -> None:
    """Make the commands of the devices from the orders."""
    e, m, o, c = p.e, p.m, p.o, p.c
    if c.torpedo != 0:
        tau = torpedo(e, m, o, c, now)
    else:
        tau = hover(e, m, o, c, now)
    if c.means == THRUSTERS:
        made = allocate_thrusters(devices, tau)
        for d in devices:
            if d.kind == THRUSTER and d.by_force == 0:
                d.force = command_for(curves, d.curve_first, d.astern, d.ahead, d.force)
    elif c.means == FINS:
        made = allocate_fins(c, devices, tau, speed_ahead(e, m, now))
    else:
        made = allocate_wrench(devices, tau)
    set_six(m.tau, tau)
    for axis in range(6):
        m.lack[axis] = tau[axis] - made[axis] if c.axes[axis] != 0 else 0.0
    c.gives = 1


@compiled
def tell(p: Any, devices: Array, t_ns: int, out: Array) -> int:
    """Write the reading of the port `state` (`status`).

    Args:
        p: PILOT.
        devices: its DEVICE rows.
        t_ns: simulation time.
        out: (32 + number of devices) receives the numbers of all fields, packed by `modifiers.columns`. Set points that the mode does not hold are
            nan, and so is an unknown depth or altitude.

    Returns:
        The number of its texts (`ports.TEXTS`): mode times the number of REASONS, plus the reason of the fail-safe.
    """
    e, o, whole = p.e, p.o, out.view(np.int64)
    now = _known(e, o.gains, t_ns)
    mode, holds_attitude = o.mode, o.attitude[0] == o.attitude[0]
    out[0], out[1:4], out[4], out[5:8] = o.armed, e.p, now.position, e.v
    out[8], out[9:13], out[13:16] = now.velocity, e.q, e.w
    out[16] = e.p[2] if now.depth else NAN
    out[17] = e.bottom - e.p[2] if now.altitude else NAN
    holds_place = mode in (POSITION_HOLD, GUIDED, MISSION) and o.frame == NO_FRAME and not holds_attitude
    for i in range(3):
        out[18 + i] = o.place[i] if holds_place else NAN
    out[21] = NAN if mode in (MANUAL, ACRO, STABILISE, HEADING_HOLD) else o.depth
    out[22] = NAN if mode in (MANUAL, ACRO) or holds_attitude else o.heading
    whole[23], whole[24], whole[25] = o.index, p.c.items, o.reached
    out[26:32] = p.m.tau
    for n in range(len(devices)):
        out[32 + n] = devices[n].part
    return int(mode * len(REASONS) + o.failsafe)
