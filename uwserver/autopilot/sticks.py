"""Set points, and the sticks that move them.

Compiled code: `e` is the ESTIMATE of a vehicle, `o` its ORDERS.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.autopilot.bottom import fall
from uwserver.autopilot.rows import ALTITUDE_HOLD, GUIDED, MISSION, NO_FRAME, SURFACE, four, set_four, set_three, three
from uwserver.autopilot.rows import rpy_from_quat as rpy
from uwserver.autopilot.state import GIVEN, NAN, NOWHERE, REASONS, STILL, Memory, Mode, Orders
from uwserver.physics.kernel.deferred import compiled

CENTRED = 0.02
"""A stick within this counts as released."""
_LEAD_RAD, _LEAD_M = 0.4, 1.0
"""A stick moves its set point no farther ahead of the vehicle than this."""
_ALTITUDE, _DEPTH, _HEADING, _PLACE = (1 << GIVEN.index(name) for name in ("altitude", "depth", "heading", "place"))
_UNSEEN = REASONS.index("sensor altitude")
_TURN = 2.0 * math.pi


def wrapped(angle: float) -> float:
    """The angle within -pi..pi."""
    return float(angle - _TURN * np.rint(angle / _TURN))


def clamped(value: float, limit: float) -> float:
    """The value within -limit..limit."""
    return -limit if value < -limit else limit if value > limit else value


within, at_most = compiled(wrapped), compiled(clamped)
"""`wrapped` and `clamped` for compiled code."""


@compiled
def heading_of(e: Any) -> float:
    """Yaw, rad."""
    return float(rpy(four(e.q))[2])


def enter(o: Orders, m: Memory, mode: Mode) -> None:
    """Begin a mode: nothing is given yet, and every set point is to be where the vehicle is (`stay`), so that nothing jumps. What was learnt of
    buoyancy and current is kept."""
    o.mode = mode
    o.given = ()
    o.attitude, o.frame, o.velocity, o.heave = None, "", STILL, 0.0
    o.turn, o.turn_limit = NAN, math.inf
    o.speed, o.looks, o.radius, o.origin = NAN, False, 1.0, NOWHERE
    o.blind = o.settled = o.astray = False
    o.entered, o.waited = False, 0.0
    m.twist = STILL


@compiled
def stay(o: Any, e: Any) -> None:
    """Set points that no command has given are where the vehicle is."""
    if o.given & _DEPTH == 0:
        o.depth = 0.0 if o.mode == SURFACE else e.p[2]
    if o.given & _ALTITUDE == 0:
        o.altitude = e.bottom - e.p[2]
    if o.given & _HEADING == 0:
        o.heading = heading_of(e)
    if o.given & _PLACE == 0:
        set_three(o.place, three(e.p))


@compiled
def set_course(
    o: Any, e: Any, north: float, east: float, down: float, heading: float, speed: float, radius: float
) -> None:
    """Go to a place.

    Args:
        o, e: of the vehicle.
        north, east, down: p_N of it, m; it tells the depth, too.
        heading: rad; nan for looking where the vehicle goes.
        speed: m/s; nan for that of the gains.
        radius: within which it has arrived, m.
    """
    set_three(o.origin, three(e.p))
    set_three(o.place, (north, east, down))
    o.depth, o.radius = down, radius
    o.given |= _PLACE | _DEPTH | _HEADING
    o.looks = 1 if math.isnan(heading) else 0
    if o.looks == 0:
        o.heading = heading
    o.speed = o.gains.cruise_mps if math.isnan(speed) else speed
    o.frame, o.settled, o.astray = NO_FRAME, 0, 0
    set_four(o.attitude, (math.nan, math.nan, math.nan, math.nan))
    o.turn, o.turn_limit = math.nan, math.inf


@compiled
def leave_bottom(o: Any) -> None:
    """The depth no longer follows the bottom."""
    o.given &= ~_ALTITUDE
    o.blind = 0
    if o.failsafe == _UNSEEN:
        o.failsafe = 0


@compiled
def settle(o: Any, e: Any, depth: bool, heading: bool, place: bool) -> None:
    """Set points that no command has given, and that were held in an estimate which the first word of a sensor has put elsewhere: they are where
    the vehicle now is known to be.

    Args:
        o, e: of the vehicle.
        depth, heading, place: what is known for the first time.
    """
    if depth and o.given & _DEPTH == 0:
        o.depth = 0.0 if o.mode == SURFACE else e.p[2]
    if heading and o.given & _HEADING == 0:
        o.heading = heading_of(e)
    if place and o.given & _PLACE == 0:
        set_three(o.place, three(e.p))


@compiled
def move_heading(o: Any, e: Any, dt: float) -> float:
    """Move the heading's set point by the stick or a commanded turn; returns the yaw rate that is wanted anyhow, rad/s."""
    rate, most = 0.0, o.gains.max_yaw_rate_radps
    if abs(o.stick[5]) > CENTRED:
        rate = o.stick[5] * most
    elif o.turn == o.turn:
        rate = at_most(o.turn, most)
    else:
        return 0.0
    now = heading_of(e)
    o.heading = within(now + at_most(within(o.heading + rate * dt - now), _LEAD_RAD))
    return float(rate)


@compiled
def goes_at_altitude(o: Any) -> bool:
    """Whether the vehicle is on a way, or at a place, that is told by its altitude."""
    return bool((o.mode == MISSION or o.mode == GUIDED) and o.given & _ALTITUDE != 0)


@compiled
def clearance(o: Any) -> float:
    """Altitude to keep on a way at an altitude, m."""
    return float(max(o.altitude, o.gains.min_altitude_m))


@compiled
def move_depth(o: Any, e: Any, sees_bottom: bool, dt: float) -> float:
    """Move the set point of depth or altitude by the heave stick; returns the vertical speed that is wanted anyhow, m/s down."""
    climb, at_altitude = o.stick[2] * o.gains.max_climb_mps if abs(o.stick[2]) > CENTRED else 0.0, goes_at_altitude(o)
    if (at_altitude or o.mode == ALTITUDE_HOLD) and sees_bottom:
        if climb != 0.0:
            above = e.bottom - e.p[2]
            o.altitude = above + at_most(o.altitude - climb * dt - above, _LEAD_M)
        if at_altitude:
            o.place[2] = o.depth = min(e.bottom - clearance(o), o.gains.max_depth_m)
        else:
            o.depth = e.bottom - o.altitude
        if o.depth < o.gains.max_depth_m:
            climb += fall(e)  # it would be late by the slope otherwise
    elif climb != 0.0:
        o.depth = e.p[2] + at_most(o.depth + climb * dt - e.p[2], _LEAD_M)
    return float(climb)


@compiled
def move_place(o: Any, e: Any, dt: float) -> tuple[float, float]:
    """Move the place by the surge and sway sticks; returns the velocity north and east that is wanted anyhow, m/s."""
    surge, sway = o.stick[0], o.stick[1]
    if abs(surge) <= CENTRED and abs(sway) <= CENTRED:
        return 0.0, 0.0
    yaw, speed = heading_of(e), o.gains.max_speed_mps
    c, s = math.cos(yaw), math.sin(yaw)
    vx, vy = speed * (c * surge - s * sway), speed * (s * surge + c * sway)
    dx, dy = o.place[0] + vx * dt - e.p[0], o.place[1] + vy * dt - e.p[1]
    shrink = min(1.0, _LEAD_M / max(math.hypot(dx, dy), 1e-9))
    o.place[0], o.place[1] = e.p[0] + shrink * dx, e.p[1] + shrink * dy
    return vx, vy
