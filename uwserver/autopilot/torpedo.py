"""Control of a torpedo: the propeller controls the speed, the stern planes control pitch and so the depth, and the rudder controls the heading. It
follows a line by steering at a point ahead on it.

Compiled code. In all functions `e` is the ESTIMATE of a vehicle, `m` its MEMORY, `o` its ORDERS, `c` its SPEC, and `now` is from `modes.known`.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.autopilot.allocation import SLOW_MPS, speed_for, thrust_at
from uwserver.autopilot.bottom import fall
from uwserver.autopilot.rows import (
    ACRO,
    GUIDED,
    HEADING_HOLD,
    IN_B,
    IN_N,
    MANUAL,
    MISSION,
    NO_FRAME,
    POSITION_HOLD,
    STABILISE,
    SURFACE,
    VELOCITY,
    conjugate,
    four,
    rotate,
    rpy_from_quat,
    set_three,
    three,
)
from uwserver.autopilot.state import NAN, STILL, Six
from uwserver.autopilot.sticks import (
    at_most,
    goes_at_altitude,
    heading_of,
    move_depth,
    move_heading,
    within,
)
from uwserver.frames import Vec3
from uwserver.physics.kernel.deferred import compiled, separate

_CRAB_S = 4.0
"""Time constant of the estimates of `crab` and `sag`, s."""
_LEVEL = 0.03
"""Slope of the path (rad) above which `sag` is hardly learnt: on a steep path a current along it has the same effect."""
_START_S = 3.0
"""Time constant of the speed while it is not measured, s."""


@compiled
def speed_ahead(e: Any, m: Any, now: Any) -> float:
    """Return the speed ahead, m/s: measured, or as the propeller should have made it."""
    return float(rotate(conjugate(four(e.q)), three(e.v))[0] if now.velocity else m.through)


@compiled
def torpedo(e: Any, m: Any, o: Any, c: Any, now: Any) -> Six:
    """Return the wrench (in B) that carries out the orders. Moves the set points by the sticks."""
    u = speed_ahead(e, m, now)
    _learn(e, m, o, c, u, now)
    surge = _surge(e, m, o, c, u, now)
    per_speed = o.gains.shaft_per_speed
    goal = speed_for(c.shaft, surge if surge == surge else 0.0, u) / per_speed if per_speed != 0.0 else 0.0
    m.through += (goal - m.through) * c.dt / _START_S
    if o.mode == MANUAL:
        k = max(u, SLOW_MPS) ** 2 * o.gains.stick
        set_three(m.twist, STILL)
        s, r = o.stick, c.reach
        return surge, 0.0, 0.0, s[3] * r[3] * k, s[4] * r[4] * k, s[5] * r[5] * k
    tx, ty, tz = _moment(e, m, o, c, u, now)
    return surge, 0.0, 0.0, tx, ty, tz


@compiled
def _learn(e: Any, m: Any, o: Any, c: Any, u: float, now: Any) -> None:
    """Update the estimates of `crab` and `sag`, at speed u (m/s)."""
    if now.velocity and u > SLOW_MPS:
        crab = within(math.atan2(e.v[1], e.v[0]) - heading_of(e))
        m.crab += (at_most(crab, 0.5) - m.crab) * c.dt / _CRAB_S
    if now.depth and u > SLOW_MPS:
        _, pitch, _ = rpy_from_quat(four(e.q))
        slope = at_most(e.v[2] / u, 0.5)
        weight = 1.0 / (1.0 + (slope / _LEVEL) ** 2)
        m.sag += weight * (at_most(slope + pitch, o.gains.max_tilt_rad) - m.sag) * c.dt / _CRAB_S


# -- ahead ----------------------------------------------------------------------------------------------------------------------------------


@compiled
def _surge(e: Any, m: Any, o: Any, c: Any, u: float, now: Any) -> float:
    """Return the force ahead at speed u (m/s), N."""
    g = o.gains
    wanted = _speed_setpoint(e, o, c)
    if wanted != wanted:
        set_three(m.push, STILL)
        return float(o.stick[0] * abs(o.stick[0]) * c.reach[0] * g.stick)
    force = thrust_at(c.shaft, wanted * g.shaft_per_speed, max(wanted, 0.0))
    if not now.velocity or wanted == 0.0:
        set_three(m.push, STILL)
        return float(force)
    off = wanted - u
    push = m.push[0] + g.velocity_i * off * c.dt - g.unwind * c.dt * m.lack[0] / c.inertia[0]
    set_three(m.push, (push, 0.0, 0.0))
    return float(force + c.inertia[0] * (g.velocity_p * off + push))


@compiled
def _speed_setpoint(e: Any, o: Any, c: Any) -> float:
    """Return the demanded speed ahead, m/s; nan where the stick acts on the propeller."""
    g, mode, v = o.gains, o.mode, o.velocity
    if mode == VELOCITY or (mode == GUIDED and o.frame != NO_FRAME):
        if o.frame == NO_FRAME:
            return float(o.stick[0] * g.max_speed_mps)
        return float(v[0] if o.frame == IN_B else math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))
    if mode == SURFACE:
        return float(0.0 if e.p[2] < c.up else g.cruise_mps)
    if mode in (POSITION_HOLD, GUIDED, MISSION):
        return float(g.cruise_mps if o.speed != o.speed else min(o.speed, g.max_speed_mps))
    return NAN


# -- pitch and heading ----------------------------------------------------------------------------------------------------------------------


@separate
def _moment(e: Any, m: Any, o: Any, c: Any, u: float, now: Any) -> Vec3:
    """Return the moment in B at speed u (m/s), N m."""
    g, dt, i, s = o.gains, c.dt, c.inertia, o.stick
    roll, pitch, _ = rpy_from_quat(four(e.q))
    held = 0.0
    if o.mode == ACRO:
        p, q, r = s[3] * g.max_rate_radps, s[4] * g.max_rate_radps, s[5] * g.max_yaw_rate_radps
    else:
        target = _pitch(e, m, o, c, u, now)
        held = c.righting * math.sin(target)
        _course(e, m, o, now)
        turn = move_heading(o, e, dt)
        p = g.attitude_p * at_most(-roll, 0.5)
        q = at_most(g.attitude_p * (target - pitch), g.max_rate_radps)
        limit = min(g.max_yaw_rate_radps, o.turn_limit)
        r = at_most(turn + g.heading_p * within(o.heading - heading_of(e)), limit)
    dp, dq, dr = p - e.w[0], q - e.w[1], r - e.w[2]
    unwind = g.unwind * dt
    b, k = m.twist[1], m.twist[2]
    if u > SLOW_MPS:  # at less speed the fins have too little effect to learn from
        b += g.rate_i * dq * dt - unwind * m.lack[4] / i[4]
        k += g.yaw_rate_i * dr * dt - unwind * m.lack[5] / i[5]
    set_three(m.twist, (0.0, b, k))
    return i[3] * g.rate_p * dp, i[4] * (g.rate_p * dq + b) + held, i[5] * (g.yaw_rate_p * dr + k)


@compiled
def _pitch(e: Any, m: Any, o: Any, c: Any, u: float, now: Any) -> float:
    """Return the pitch to hold at speed u (m/s), rad."""
    g, mode = o.gains, o.mode
    if o.attitude[0] == o.attitude[0]:
        return float(rpy_from_quat(four(o.attitude))[1])
    if mode in (STABILISE, HEADING_HOLD):
        return float(o.stick[4] * g.max_tilt_rad)
    if not now.depth:
        return float(g.max_tilt_rad if mode == SURFACE else 0.0)
    dive = move_depth(o, e, now.altitude, c.dt)
    if o.frame != NO_FRAME and o.velocity[2] != 0.0:
        dive = o.velocity[2]
        o.depth = e.p[2] + at_most(o.depth + dive * c.dt - e.p[2], 1.0)
    slope = g.depth_p * (o.depth - e.p[2]) + dive / max(u, SLOW_MPS)
    up = g.max_tilt_rad
    if now.altitude and goes_at_altitude(o):
        # A bottom may rise more steeply than its usual path.
        up = max(up, min(g.max_rise_rad, up - fall(e) / max(u, SLOW_MPS)))
    return float(max(-g.max_tilt_rad, min(up, m.sag - slope)))


@compiled
def _course(e: Any, m: Any, o: Any, now: Any) -> None:
    """Set the heading so that the vehicle follows its line, its circle, its attitude, or its velocity."""
    mode = o.mode
    if o.attitude[0] == o.attitude[0]:
        o.heading = rpy_from_quat(four(o.attitude))[2]
    elif o.frame == IN_N and math.hypot(o.velocity[0], o.velocity[1]) > 1e-3:
        o.heading = within(math.atan2(o.velocity[1], o.velocity[0]) - m.crab)
    elif o.frame == NO_FRAME and mode in (POSITION_HOLD, GUIDED, MISSION) and now.position:
        o.heading = within(_towards(e, o) - m.crab)


@compiled
def _towards(e: Any, o: Any) -> float:
    """Return the course over ground to the place, rad."""
    orbit, dx, dy, dz = o.gains.orbit_m, o.place[0] - e.p[0], o.place[1] - e.p[1], o.place[2] - e.p[2]
    away, bearing = math.hypot(dx, dy), math.atan2(dy, dx)
    if goes_at_altitude(o):
        dz = 0.0  # the depth varies with the bottom
    if o.mode != MISSION and math.sqrt(dx * dx + dy * dy + dz * dz) <= o.radius:
        o.settled = 1
    if o.origin[0] != o.origin[0] or o.settled != 0:
        # Clockwise round the place: from far away towards it, on the circle at a right angle to it.
        return bearing - 0.5 * math.pi + math.atan2(away - orbit, 0.5 * orbit)
    if o.astray != 0:
        # The place is behind the vehicle and inside its turning circle: first it goes away from it.
        if away < 2.5 * orbit:
            return float(within(bearing + math.pi))
        o.astray = 0
        set_three(o.origin, three(e.p))
    lx, ly = o.place[0] - o.origin[0], o.place[1] - o.origin[1]
    length = math.hypot(lx, ly)
    if length < 1e-6:
        return bearing
    along, across = (lx * dx + ly * dy) / length, (lx * dy - ly * dx) / length
    if along < -o.radius:
        o.astray = 1
    ahead = min(o.gains.look_ahead_m, max(along, 0.5 * o.gains.look_ahead_m))
    return math.atan2(ly, lx) + math.atan2(across, ahead)
