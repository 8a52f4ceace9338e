"""Set points, and the sticks that move them."""

from __future__ import annotations

import math

from uwserver.autopilot.estimator import Known
from uwserver.autopilot.state import NAN, NOWHERE, STILL, Estimate, Memory, Mode, Orders
from uwserver.frames import rpy_from_quat

CENTRED = 0.02
"""A stick within this counts as released."""
_LEAD_RAD, _LEAD_M = 0.4, 1.0
"""A stick moves its set point no farther ahead of the vehicle than this."""


def wrapped(angle: float) -> float:
    """The angle within -pi..pi."""
    return math.remainder(angle, 2.0 * math.pi)


def clamped(value: float, limit: float) -> float:
    """The value within -limit..limit."""
    return -limit if value < -limit else limit if value > limit else value


def heading_of(e: Estimate) -> float:
    """Yaw, rad."""
    return rpy_from_quat(e.q)[2]


def enter(o: Orders, e: Estimate, m: Memory, mode: Mode) -> None:
    """Begin a mode: every set point is where the vehicle is, so that nothing jumps. What was learnt of buoyancy and current is kept."""
    o.mode = mode
    o.given = ()
    o.attitude, o.frame, o.velocity, o.heave = None, "", STILL, 0.0
    o.turn, o.turn_limit = NAN, math.inf
    o.speed, o.looks, o.radius, o.origin = NAN, False, 1.0, NOWHERE
    o.settled = o.astray = False
    o.entered, o.waited = False, 0.0
    m.twist = STILL
    stay(o, e)


def stay(o: Orders, e: Estimate) -> None:
    """Set points that no command has given are where the vehicle is."""
    if "depth" not in o.given:
        o.depth = 0.0 if o.mode == "surface" else e.p[2]
    if "altitude" not in o.given:
        o.altitude = e.bottom - e.p[2]
    if "heading" not in o.given:
        o.heading = heading_of(e)
    if "place" not in o.given:
        o.place = e.p


def move_heading(o: Orders, e: Estimate, dt: float) -> float:
    """Move the heading's set point by the stick or a commanded turn; returns the yaw rate that is wanted anyhow, rad/s."""
    stick = o.stick[5]
    if abs(stick) > CENTRED:
        rate = stick * o.gains.max_yaw_rate_radps
    elif o.turn == o.turn:
        rate = clamped(o.turn, o.gains.max_yaw_rate_radps)
    else:
        return 0.0
    now = heading_of(e)
    o.heading = wrapped(now + clamped(wrapped(o.heading + rate * dt - now), _LEAD_RAD))
    return rate


def move_depth(o: Orders, e: Estimate, known: Known, dt: float) -> float:
    """Move the set point of depth or altitude by the heave stick; returns the vertical speed that is wanted anyhow, m/s down."""
    stick = o.stick[2]
    climb = stick * o.gains.max_climb_mps if abs(stick) > CENTRED else 0.0
    if o.mode == "altitude_hold" and known.altitude:
        if climb:
            above = e.bottom - e.p[2]
            o.altitude = above + clamped(o.altitude - climb * dt - above, _LEAD_M)
        o.depth = e.bottom - o.altitude
    elif climb:
        o.depth = e.p[2] + clamped(o.depth + climb * dt - e.p[2], _LEAD_M)
    return climb


def move_place(o: Orders, e: Estimate, dt: float) -> tuple[float, float]:
    """Move the place by the surge and sway sticks; returns the velocity north and east that is wanted anyhow, m/s."""
    surge, sway = o.stick[0], o.stick[1]
    if abs(surge) <= CENTRED and abs(sway) <= CENTRED:
        return 0.0, 0.0
    yaw, speed = heading_of(e), o.gains.max_speed_mps
    c, s = math.cos(yaw), math.sin(yaw)
    vx, vy = speed * (c * surge - s * sway), speed * (s * surge + c * sway)
    x, y, z = o.place
    dx, dy = x + vx * dt - e.p[0], y + vy * dt - e.p[1]
    shrink = min(1.0, _LEAD_M / max(math.hypot(dx, dy), 1e-9))
    o.place = (e.p[0] + shrink * dx, e.p[1] + shrink * dy, z)
    return vx, vy
