"""Set points, and the sticks of the pilot that move them.

Compiled code. In all functions `e` is the ESTIMATE of a vehicle, and `o` its ORDERS.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.autopilot.bottom import fall
from uwserver.autopilot.config import Mode
from uwserver.autopilot.rows import ALTITUDE_HOLD, GUIDED, MISSION, SURFACE, four, set_three, three
from uwserver.autopilot.rows import rpy_from_quat as rpy
from uwserver.autopilot.state import GIVEN, NAN, NOWHERE, STILL, Memory, Orders
from uwserver.physics.kernel.deferred import compiled

CENTRED = 0.02
"""A stick nearer to its centre than this counts as released."""
_LEAD_RAD, _LEAD_M = 0.4, 1.0
"""A stick moves a set point at most this far ahead of the vehicle."""
_ALTITUDE, _DEPTH, _HEADING, _PLACE = (1 << GIVEN.index(name) for name in ("altitude", "depth", "heading", "place"))
_TURN = 2.0 * math.pi


def wrapped(angle: float) -> float:
    """Return the angle within -pi..pi."""
    return float(angle - _TURN * np.rint(angle / _TURN))


@compiled
def at_most(value: float, limit: float) -> float:
    """Return the value, limited to -limit..limit."""
    return -limit if value < -limit else limit if value > limit else value


within = compiled(wrapped)
"""`wrapped` for compiled code."""


@compiled
def heading_of(e: Any) -> float:
    """Return the yaw angle, rad."""
    return float(rpy(four(e.q))[2])


def enter(o: Orders, m: Memory, mode: Mode) -> None:
    """Begin a mode. No set point is given yet, so `stay` moves all of them to where the vehicle is, and nothing jumps. The learnt force against
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
    """Move the set points that no command has given to where the vehicle is."""
    follow_estimate(o, e, True, True, True)
    if o.given & _ALTITUDE == 0:
        o.altitude = e.bottom - e.p[2]


@compiled
def follow_estimate(o: Any, e: Any, depth: bool, heading: bool, place: bool) -> None:
    """Move some set points to where the vehicle is, unless a command has given them.

    So they follow when the first sample of a sensor moves the estimate far away.

    Args:
        o, e: those of the vehicle.
        depth, heading, place: which set points.
    """
    if depth and o.given & _DEPTH == 0:
        o.depth = 0.0 if o.mode == SURFACE else e.p[2]
    if heading and o.given & _HEADING == 0:
        o.heading = heading_of(e)
    if place and o.given & _PLACE == 0:
        set_three(o.place, three(e.p))


@compiled
def move_heading(o: Any, e: Any, dt: float) -> float:
    """Move the set point of the heading by the stick or a commanded turn. Returns the yaw rate of this motion, rad/s, which is fed forward."""
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
    """Return whether the vehicle goes to a place, or stays there, at a commanded altitude."""
    return bool((o.mode == MISSION or o.mode == GUIDED) and o.given & _ALTITUDE != 0)


@compiled
def clearance(o: Any) -> float:
    """Return the altitude of a vehicle that goes at an altitude, m."""
    return float(max(o.altitude, o.gains.min_altitude_m))


@compiled
def move_depth(o: Any, e: Any, sees_bottom: bool, dt: float) -> float:
    """Move the set point of depth or altitude by the heave stick. Returns the vertical speed of this motion, m/s down, which is fed forward."""
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
            climb += fall(e)  # otherwise the depth would lag behind the slope
    elif climb != 0.0:
        o.depth = e.p[2] + at_most(o.depth + climb * dt - e.p[2], _LEAD_M)
    return float(climb)


@compiled
def move_place(o: Any, e: Any, dt: float) -> tuple[float, float]:
    """Move the place by the surge and sway sticks. Returns the velocity north and east of this motion, m/s, which is fed forward."""
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
