"""Control of a vehicle that can hover: cascades from position to velocity to force, and from attitude to rate to moment.

Compiled code. In all functions `e` is the ESTIMATE of a vehicle, `m` its MEMORY, `o` its ORDERS, `c` its SPEC, and `now` is from `modes.known`.
"""

from __future__ import annotations

import math
from typing import Any

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
    multiply,
    quat_from_rpy,
    rotate,
    rpy_from_quat,
    set_three,
    three,
)
from uwserver.autopilot.state import NAN, NOWHERE, STILL, Six
from uwserver.autopilot.sticks import (
    CENTRED,
    at_most,
    clearance,
    goes_at_altitude,
    heading_of,
    move_depth,
    move_heading,
    move_place,
    within,
)
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.deferred import compiled, separate

_RISE = 0.4
"""Part of the full upward force that brings a vehicle to the surface if it does not know its depth."""
_LEANING_RAD, _LEANT_RAD, _CRAWL = 0.2, 0.6, 0.15
"""A vehicle that cannot control its tilt slows down from the first tilt on, and keeps the third part of its speed at the second tilt: heave and surge
together would turn it over."""
_SIDEWAYS = 0.7
"""Largest part of its speed with which a vehicle returns to its line; the rest is for the way along the line."""
_UNTURNED_RAD, _UNTURNED = 0.8, 0.3
"""A vehicle that goes bow first reduces its speed to this part while its heading is farther off than this angle."""
_FOLLOWING = 0.7
"""Part of its largest vertical speed with which a vehicle follows a rising bottom. Over a steeper bottom it goes slower."""
_NEAR, _TOO_NEAR, _WAITING = 0.75, 0.25, 0.05
"""A vehicle slows down if its altitude is less than the first part of the wanted one. At the second part only the third part of its speed is left, so
that it rises."""
_FORGET_S = 5.0
"""Time constant with which the learnt horizontal force decays while the sticks act on forces, s."""
_SHORT_M = 0.5
"""If start and place are nearer together than this, there is no line: the vehicle goes straight to the place."""
_NO_ATTITUDE: Quat = (NAN, NAN, NAN, NAN)


@compiled
def hover(e: Any, m: Any, o: Any, c: Any, now: Any) -> Six:
    """Return the wrench (in B) that carries out the orders. Moves the set points by the sticks."""
    force, moment, v, q, rates = _wish(e, o, c, now)
    _unwind(e, m, o, c)
    fx, fy, fz = _force(e, m, o, c, force, v)
    tx, ty, tz = _moment(e, m, o, c, moment, q, rates)
    return fx, fy, fz, tx, ty, tz


# -- demands of the outer loops -------------------------------------------------------------------------------------------------------------


@separate
def _wish(e: Any, o: Any, c: Any, now: Any) -> tuple[Vec3, Vec3, Vec3, Quat, Vec3]:
    """Return what the outer loops demand.

    Returns:
        Force (N) in B from the sticks; moment (N m) in B from the sticks; velocity in N, nan where the sticks act on forces (x and y together);
        attitude, nan if there is none; rates in B, which add to those of the attitude loop, nan if there are none.
    """
    g, mode, s, r = o.gains, o.mode, o.stick, c.reach
    k = g.stick
    fx, fy, fz = s[0] * r[0] * k, s[1] * r[1] * k, s[2] * r[2] * k
    if mode == MANUAL:
        return (fx, fy, fz), (s[3] * r[3] * k, s[4] * r[4] * k, s[5] * r[5] * k), NOWHERE, _NO_ATTITUDE, NOWHERE
    if mode == ACRO:
        rates = (s[3] * g.max_rate_radps, s[4] * g.max_rate_radps, s[5] * g.max_yaw_rate_radps)
        return (fx, fy, fz), STILL, NOWHERE, _NO_ATTITUDE, rates
    slow = _caution(e, c)
    vx, vy, vz = _velocity_setpoint(e, o, c, now)
    vx, vy, vz = slow * vx, slow * vy, slow * vz
    if mode == SURFACE and not now.depth:
        fz = -_RISE * r[2]
    else:
        fz = fz if vz != vz else 0.0
        if vx == vx:
            fx = fy = 0.0
    if o.attitude[0] == o.attitude[0]:
        return (fx, fy, fz), STILL, (vx, vy, vz), four(o.attitude), STILL
    turn = move_heading(o, e, c.dt)
    # On an axis that cannot be controlled the present tilt is demanded, so that it does not count as an error, of heading either.
    roll, pitch, _ = rpy_from_quat(four(e.q))
    if c.axes[3] != 0:
        roll = s[3] * g.max_tilt_rad
    if c.axes[4] != 0:
        pitch = s[4] * g.max_tilt_rad
    return (fx, fy, fz), STILL, (vx, vy, vz), quat_from_rpy(roll, pitch, o.heading), (0.0, 0.0, turn)


@compiled
def _caution(e: Any, c: Any) -> float:
    """Return the factor of speed for a vehicle that cannot control its tilt: 1 when it is upright, less when it leans."""
    if _holds_tilt(c):
        return 1.0
    up = rotate(conjugate(four(e.q)), (0.0, 0.0, 1.0))
    tilt = math.acos(at_most(up[2], 1.0))
    return max(_CRAWL, 1.0 - max(0.0, tilt - _LEANING_RAD) / (_LEANT_RAD - _LEANING_RAD))


@compiled
def _holds_tilt(c: Any) -> bool:
    return bool(c.axes[3] != 0 and c.axes[4] != 0)


@compiled
def _velocity_setpoint(e: Any, o: Any, c: Any, now: Any) -> Vec3:
    """Return the demanded velocity in N, m/s; nan where the sticks act on forces."""
    free = o.frame == NO_FRAME and o.attitude[0] != o.attitude[0]
    goes = (o.mode == GUIDED or o.mode == MISSION) and now.position and free
    if goes and max(abs(o.stick[0]), abs(o.stick[1]), abs(o.stick[2])) <= CENTRED:
        a, b, at_altitude = o.origin, o.place, goes_at_altitude(o)
        ux, uy, uz = b[0] - a[0], b[1] - a[1], 0.0 if at_altitude else b[2] - a[2]
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        # There is no line without an origin (nan), or after another depth was commanded on the way.
        if length > _SHORT_M and o.depth == b[2]:
            vx, vy, vz = _follow(e, o, c, now, (ux / length, uy / length, uz / length))
            return vx, vy, _climb(e, o, c, now) if at_altitude else vz
    vx, vy = _drive(e, o, c, now)
    return vx, vy, _climb(e, o, c, now)


@compiled
def _follow(e: Any, o: Any, c: Any, now: Any, towards: Vec3) -> Vec3:
    """Return the velocity along the line to the place, and back to the line.

    If the vehicle steered straight at the place, a current would make its path an arc, and it would cut corners.
    """
    g, (ux, uy, uz) = o.gains, towards
    dx, dy, dz = o.place[0] - e.p[0], o.place[1] - e.p[1], o.place[2] - e.p[2]
    left = dx * ux + dy * uy + dz * uz  # along the line; negative past the place
    bx, by, bz = dx - left * ux, dy - left * uy, dz - left * uz  # to its nearest point
    speed = _unhurried(e, o, now, ux, uy)
    back = g.position_p * math.hypot(bx, by)
    share = g.position_p * (min(1.0, _SIDEWAYS * speed / back) if back > 0.0 else 1.0)
    back = min(back, _SIDEWAYS * speed)
    along = math.sqrt(speed * speed - back * back)
    # Without sideways thrust only the heading brings it back to the line.
    x, y = (0.0, 0.0) if c.axes[1] != 0 else (share * bx, share * by)
    along *= _point_bow(e, o, c, math.hypot(ux, uy) * left, along * ux + x, along * uy + y)
    along = at_most(g.position_p * left, min(along, g.max_climb_mps / max(abs(uz), 1e-9)))
    climb = at_most(uz * along + g.depth_p * bz, g.max_climb_mps)
    return along * ux + share * bx, along * uy + share * by, climb


@compiled
def _point_bow(e: Any, o: Any, c: Any, away: float, north: float, east: float) -> float:
    """Point the bow in a direction, if the vehicle goes bow first and is not near its place yet.

    Args:
        e, o, c: those of the vehicle.
        away: horizontal distance of the place, m.
        north, east: the direction, of any length.

    Returns:
        A factor of the speed: less than 1 while the vehicle turns, because vehicles are made to go ahead.
    """
    # Without sideways thrust it can only go bow first, whatever heading was commanded.
    if (o.looks != 0 or c.axes[1] == 0) and away > 2.0 * o.radius:
        o.heading = math.atan2(east, north)
        if abs(within(o.heading - heading_of(e))) > _UNTURNED_RAD:
            return _UNTURNED
    return 1.0


@compiled
def _unhurried(e: Any, o: Any, now: Any, ux: float, uy: float) -> float:
    """Return the speed in a direction (unit vector, N), m/s: that of the orders, or less where the bottom rises faster than the vehicle can climb."""
    g = o.gains
    speed = g.max_speed_mps if o.speed != o.speed else o.speed
    if not (goes_at_altitude(o) and now.altitude):
        return float(speed)
    part = ((e.bottom - e.p[2]) / clearance(o) - _TOO_NEAR) / (_NEAR - _TOO_NEAR)
    slow = speed * max(_WAITING, min(1.0, part))
    rise = -(e.grade[0] * ux + e.grade[1] * uy)
    return float(min(slow, _FOLLOWING * g.max_climb_mps / max(rise, 1e-9)))


@compiled
def _climb(e: Any, o: Any, c: Any, now: Any) -> float:
    """Return the demanded vertical speed, m/s down; nan where the stick acts on the force."""
    g, mode, holds_attitude = o.gains, o.mode, o.attitude[0] == o.attitude[0]
    if mode in (STABILISE, HEADING_HOLD) or not now.depth:
        return NAN
    fast = g.surface_mps if mode == SURFACE else g.max_climb_mps
    if holds_attitude:
        wanted = at_most(o.heave, 1.0) * g.max_climb_mps
    elif o.frame == IN_N or o.frame == IN_B:  # B is taken as level, so down is the same in both
        wanted = o.velocity[2]
    else:
        wanted = move_depth(o, e, now.altitude, c.dt)
    if (holds_attitude or o.frame != NO_FRAME) and wanted != 0.0:
        o.depth = e.p[2] + at_most(o.depth + wanted * c.dt - e.p[2], 1.0)
    return float(at_most(wanted + g.depth_p * (o.depth - e.p[2]), max(fast, abs(wanted))))


@compiled
def _drive(e: Any, o: Any, c: Any, now: Any) -> tuple[float, float]:
    """Return the demanded velocity north and east, m/s; nan where the sticks act on forces."""
    g, mode = o.gains, o.mode
    if mode == VELOCITY or (mode == GUIDED and o.frame != NO_FRAME):
        v = three(o.velocity) if o.frame != NO_FRAME else STILL
        if o.frame != IN_N:
            # The sticks add to a velocity in B, which is taken as level.
            surge, sway = o.stick[0] * g.max_speed_mps, o.stick[1] * g.max_speed_mps
            v = rotate(quat_from_rpy(0.0, 0.0, heading_of(e)), (v[0] + surge, v[1] + sway, 0.0))
        return v[0], v[1]
    holds_place = mode in (POSITION_HOLD, GUIDED, MISSION)
    if not holds_place or not now.position or o.attitude[0] == o.attitude[0]:
        return NAN, NAN
    vx, vy = move_place(o, e, c.dt)
    dx, dy = o.place[0] - e.p[0], o.place[1] - e.p[1]
    distance = math.hypot(dx, dy)
    speed = _unhurried(e, o, now, dx / max(distance, 1e-9), dy / max(distance, 1e-9))
    speed *= _point_bow(e, o, c, distance, dx, dy)
    fast = min(speed, g.position_p * distance)
    scale = fast / distance if distance > 1e-9 else 0.0
    return vx + scale * dx, vy + scale * dy


# -- force and moment -----------------------------------------------------------------------------------------------------------------------


@compiled
def _unwind(e: Any, m: Any, o: Any, c: Any) -> None:
    """Reduce the integrals by the part of the last wrench that the actuators could not make (anti-windup)."""
    k, lack, i = o.gains.unwind * c.dt, m.lack, c.inertia
    back = rotate(four(e.q), (k * lack[0] / i[0], k * lack[1] / i[1], k * lack[2] / i[2]))
    for n in range(3):
        m.push[n] -= back[n]
        m.twist[n] -= k * lack[3 + n] / i[3 + n]


@compiled
def _force(e: Any, m: Any, o: Any, c: Any, force: Vec3, v: Vec3) -> Vec3:
    """Return the force in B (N) for a velocity in N (m/s, nan for none), plus a force of the sticks."""
    g, dt, (vx, vy, vz), (px, py, pz) = o.gains, c.dt, v, three(m.push)
    ax = ay = az = 0.0
    if vx == vx:
        dx, dy = vx - e.v[0], vy - e.v[1]
        ax, ay = g.velocity_p * dx + px, g.velocity_p * dy + py
        px, py = px + g.velocity_i * dx * dt, py + g.velocity_i * dy * dt
    else:
        px, py = px - px * dt / _FORGET_S, py - py * dt / _FORGET_S
        vx = vy = 0.0
    if vz == vz:
        dz = vz - e.v[2]
        az = g.climb_p * dz + pz
        pz += g.climb_i * dz * dt
    else:
        vz = 0.0
    set_three(m.push, (px, py, pz))
    # A vehicle that cannot control its tilt is taken as level. Otherwise a tilt would mix its axes, and this would increase the tilt.
    back = conjugate(four(e.q) if _holds_tilt(c) else quat_from_rpy(0.0, 0.0, heading_of(e)))
    a = rotate(back, (ax, ay, az))
    # Damping at the wanted speed is fed forward: so the integrals need not learn it on the way, and unlearn it at the end.
    u = rotate(back, (vx, vy, vz))
    i, linear, square = c.inertia, c.linear, c.quadratic
    return (
        a[0] * i[0] + (linear[0] + square[0] * abs(u[0])) * u[0] + force[0],
        a[1] * i[1] + (linear[1] + square[1] * abs(u[1])) * u[1] + force[1],
        a[2] * i[2] + (linear[2] + square[2] * abs(u[2])) * u[2] + force[2],
    )


@compiled
def _moment(e: Any, m: Any, o: Any, c: Any, moment: Vec3, wanted: Quat, rates: Vec3) -> Vec3:
    """Return the moment in B (N m) for an attitude (nan for none) and rates (rad/s); `moment`, that of the sticks, if there are no rates."""
    g, dt, i, k = o.gains, c.dt, c.inertia, m.twist
    x, y, z = rates
    if x != x:
        set_three(k, STILL)
        return moment
    if wanted[0] == wanted[0]:
        q = multiply(conjugate(four(e.q)), wanted)
        two = math.copysign(2.0, q[0])
        x += at_most(g.attitude_p * two * q[1], g.max_rate_radps)
        y += at_most(g.attitude_p * two * q[2], g.max_rate_radps)
        z += at_most(g.heading_p * two * q[3], min(g.max_yaw_rate_radps, o.turn_limit))
    dx, dy, dz = c.axes[3] * (x - e.w[0]), c.axes[4] * (y - e.w[1]), c.axes[5] * (z - e.w[2])
    made = (
        i[3] * (g.rate_p * dx + k[0]),
        i[4] * (g.rate_p * dy + k[1]),
        i[5] * (g.yaw_rate_p * dz + k[2]),
    )
    k[0] += g.rate_i * dx * dt
    k[1] += g.rate_i * dy * dt
    k[2] += g.yaw_rate_i * dz * dt
    return made
