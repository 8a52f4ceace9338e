"""One step of one autopilot: estimate, fail-safes, guidance, control, allocation; and what it shows.

Compiled code. What is rare is done in Python: the step stops there and says what it needs, and goes on from a later stage when that is done.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.autopilot import modes
from uwserver.autopilot.allocation import FINS, THRUSTERS, allocate_thrusters, allocate_wrench, command_for
from uwserver.autopilot.estimator import go_on
from uwserver.autopilot.fins import allocate_fins
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
"""What a step needs of Python: the sensors have spoken that it waited for; a fail-safe is due; an item of the mission begins, or is done; a way is
at its end, or it is time to tell how far it is."""

START, WATCH, STEER, CONTROL = range(4)
"""Stages of a step."""

WAYPOINT, HOLD, SPEED, HEADING, COME_UP = range(5)
"""Kinds of items of a mission."""

PROGRESS_S = 0.5
"""So often is told how far the way is."""
_TURNED_RAD = 0.05
_LEAK, _BATTERY = REASONS.index("leak"), REASONS.index("battery")
_NEEDED = modes.NEEDED
_known = compiled(modes.known)


@separate
def fly(p: Any, devices: Array, curves: Array, t_ns: int, stage: int) -> int:
    """Step, or go on with a step; returns what it needs of Python first. Commands stand in `force` of the devices and are `given`, where it has
    told any.

    Args:
        p: PILOT.
        devices: its DEVICE rows.
        curves: of all devices.
        t_ns: simulation time.
        stage: from which on.
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
        need = _look_ahead(e, o, c)
        if need != NOTHING:
            return int(need)
    _control(p, devices, curves, now)
    return NOTHING


@compiled
def _lacks(mode: int, now: Any) -> bool:
    """Whether a mode cannot work."""
    for need, there in zip(_NEEDED[mode], now):  # noqa: B905, SIM110 - compiled code knows neither `strict` nor `any`
        if need and not there:
            return True
    return False


@compiled
def _is_in_trouble(e: Any, o: Any, now: Any) -> bool:
    """Whether a fail-safe is due."""
    reason = o.failsafe
    leaks = e.leak != 0 and reason != _LEAK
    runs_down = e.charge < o.gains.battery_low and reason not in (_LEAK, _BATTERY)
    loses_or_finds_bottom = goes_at_altitude(o) and now.altitude == (o.blind != 0)
    return bool(_lacks(o.mode, now) or leaks or runs_down or loses_or_finds_bottom)


@compiled
def _look_ahead(e: Any, o: Any, c: Any) -> int:
    """Whether an item of the mission, or a way, begins or ends."""
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
    """To the place, m. Depth counts, but of a torpedo over a bottom that goes up and down under it."""
    x, y, z = o.place[0] - e.p[0], o.place[1] - e.p[1], o.place[2] - e.p[2]
    if c.torpedo != 0 and goes_at_altitude(o):
        z = 0.0
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _is_done(e: Any, o: Any, c: Any) -> bool:
    """Whether the item under way is done."""
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
    """From orders to commands."""
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
def show(p: Any, t_ns: int, out: Array) -> None:
    """Write what a PILOT believes and wants.

    Args:
        p: PILOT.
        t_ns: simulation time.
        out: (SHOWN) receives position, velocity, attitude, rates; depth and altitude, nan where unknown; place, depth and heading that are held,
            nan where the mode holds none; the demanded wrench; mode, whether it is armed, position and velocity are known; item under way, items
            done; reason of the fail-safe.
    """
    e, o = p.e, p.o
    now = _known(e, o.gains, t_ns)
    mode, holds_attitude = o.mode, o.attitude[0] == o.attitude[0]
    out[0:3], out[3:6], out[6:10], out[10:13] = e.p, e.v, e.q, e.w
    out[13] = e.p[2] if now.depth else NAN
    out[14] = e.bottom - e.p[2] if now.altitude else NAN
    holds_place = mode in (POSITION_HOLD, GUIDED, MISSION) and o.frame == NO_FRAME and not holds_attitude
    for i in range(3):
        out[15 + i] = o.place[i] if holds_place else NAN
    out[18] = NAN if mode in (MANUAL, ACRO, STABILISE, HEADING_HOLD) else o.depth
    out[19] = NAN if mode in (MANUAL, ACRO) or holds_attitude else o.heading
    out[20:26] = p.m.tau
    out[26], out[27], out[28], out[29] = mode, o.armed, now.position, now.velocity
    out[30], out[31], out[32] = o.index, o.reached, o.failsafe


SHOWN = 33
"""Numbers that `show` writes."""
