"""Control of a vehicle that can hover: cascades from position to velocity to force, and from attitude to rate to moment.

Compiled code: `e` is the ESTIMATE of a vehicle, `m` its MEMORY, `o` its ORDERS, `c` its CRAFT, `now` what is `known`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
from uwserver.autopilot.state import NAN, Six
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
"""Part of the power upwards that brings a vehicle up which does not know its depth."""
_LEANING_RAD, _LEANT_RAD = 0.2, 0.6
"""A vehicle that cannot hold its tilt slows down from the first on, to a crawl at the second: heave and surge together lean it over."""
_CRAWL = 0.15
_SIDEWAYS = 0.7
"""Part of its speed with which a vehicle goes back to its line at most; the rest is for the way along it."""
_UNTURNED_RAD, _UNTURNED = 0.8, 0.3
"""A vehicle that looks where it goes goes with this part of its speed while it has farther to turn."""
_FOLLOWING = 0.7
"""Part of its climb with which a vehicle follows a rising bottom: where that is steeper it goes slower."""
_NEAR, _TOO_NEAR, _WAITING = 0.75, 0.25, 0.05
"""Nearer to the bottom than the first part of its altitude it slows down, at the second to a standstill but for the third of its speed, to rise."""
_FORGET_S = 5.0
"""Time constant with which a learnt current is forgotten while nobody holds against it, s."""
_SHORT_M = 0.5
"""Places nearer together than this have no line: the vehicle goes there straight."""
_STILL: Vec3 = (0.0, 0.0, 0.0)
_FREE: Vec3 = (NAN, NAN, NAN)
_NO_ATTITUDE: Quat = (NAN, NAN, NAN, NAN)


@dataclass(frozen=True)
class Hover:
    """What the cascades know of one vehicle.

    Attributes:
        inertia: with added mass, kg and kg m2, of each axis.
        linear, quadratic: damping of each axis, N s/m and N s2/m2.
        reach: largest wrench of each axis, N and N m.
    """

    inertia: Six
    linear: Six
    quadratic: Six
    reach: Six

    def fill(self, craft: Any) -> None:
        """Write it into a CRAFT."""
        craft["torpedo"], craft["inertia"], craft["reach"] = 0, self.inertia, self.reach
        craft["linear"], craft["quadratic"] = self.linear, self.quadratic


@compiled
def hover(e: Any, m: Any, o: Any, c: Any, now: Any) -> Six:
    """The wrench (B) that carries out the orders; moves set points by the sticks."""
    force, moment, v, q, rates = _wish(e, o, c, now)
    _unwind(e, m, o, c)
    fx, fy, fz = _force(e, m, o, c, force, v)
    tx, ty, tz = _moment(e, m, o, c, moment, q, rates)
    return fx, fy, fz, tx, ty, tz


# -- what is wanted -------------------------------------------------------------------------------------------------------------------------


@separate
def _wish(e: Any, o: Any, c: Any, now: Any) -> tuple[Vec3, Vec3, Vec3, Quat, Vec3]:
    """What the outer loops want: force (N) and moment (N m) in B from the sticks; velocity in N, nan where the sticks act on forces (x and y go
    together); attitude, nan for none; rates beside it or alone in B, nan for none."""
    g, mode, s, r = o.gains, o.mode, o.stick, c.reach
    k = g.stick
    fx, fy, fz = s[0] * r[0] * k, s[1] * r[1] * k, s[2] * r[2] * k
    if mode == MANUAL:
        return (fx, fy, fz), (s[3] * r[3] * k, s[4] * r[4] * k, s[5] * r[5] * k), _FREE, _NO_ATTITUDE, _FREE
    if mode == ACRO:
        rates = (s[3] * g.max_rate_radps, s[4] * g.max_rate_radps, s[5] * g.max_yaw_rate_radps)
        return (fx, fy, fz), _STILL, _FREE, _NO_ATTITUDE, rates
    slow = _caution(e, c)
    vx, vy, vz = _wanted(e, o, c, now)
    vx, vy, vz = slow * vx, slow * vy, slow * vz
    if mode == SURFACE and not now.depth:
        fz = -_RISE * r[2]
    else:
        fz = fz if vz != vz else 0.0
        if vx == vx:
            fx = fy = 0.0
    if o.attitude[0] == o.attitude[0]:
        return (fx, fy, fz), _STILL, (vx, vy, vz), four(o.attitude), _STILL
    turn = move_heading(o, e, c.dt)
    # Where nothing can be done about a tilt it must not be seen as an error of heading either.
    roll, pitch, _ = rpy_from_quat(four(e.q))
    if c.axes[3] != 0:
        roll = s[3] * g.max_tilt_rad
    if c.axes[4] != 0:
        pitch = s[4] * g.max_tilt_rad
    return (fx, fy, fz), _STILL, (vx, vy, vz), quat_from_rpy(roll, pitch, o.heading), (0.0, 0.0, turn)


@compiled
def _caution(e: Any, c: Any) -> float:
    """By how much to slow down because of a tilt that nothing holds."""
    if _holds_tilt(c):
        return 1.0
    up = rotate(conjugate(four(e.q)), (0.0, 0.0, 1.0))
    tilt = math.acos(at_most(up[2], 1.0))
    return max(_CRAWL, 1.0 - max(0.0, tilt - _LEANING_RAD) / (_LEANT_RAD - _LEANING_RAD))


@compiled
def _holds_tilt(c: Any) -> bool:
    return bool(c.axes[3] != 0 and c.axes[4] != 0)


@compiled
def _wanted(e: Any, o: Any, c: Any, now: Any) -> Vec3:
    """Velocity in N, m/s; nan where the sticks act on forces."""
    free = o.frame == NO_FRAME and o.attitude[0] != o.attitude[0]
    goes = (o.mode == GUIDED or o.mode == MISSION) and now.position and free
    if goes and max(abs(o.stick[0]), abs(o.stick[1]), abs(o.stick[2])) <= CENTRED:
        a, b, at_altitude = o.origin, o.place, goes_at_altitude(o)
        ux, uy, uz = b[0] - a[0], b[1] - a[1], 0.0 if at_altitude else b[2] - a[2]
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        # There is no line where nothing began, or another depth was told on the way.
        if length > _SHORT_M and o.depth == b[2]:
            vx, vy, vz = _follow(e, o, c, now, (ux / length, uy / length, uz / length))
            return vx, vy, _climb(e, o, c, now) if at_altitude else vz
    vx, vy = _drive(e, o, c, now)
    return vx, vy, _climb(e, o, c, now)


@compiled
def _follow(e: Any, o: Any, c: Any, now: Any, towards: Vec3) -> Vec3:
    """Along the line to the place, and back to it: straight to the place a current would carry it on an arc, and each corner would be cut."""
    g, (ux, uy, uz) = o.gains, towards
    dx, dy, dz = o.place[0] - e.p[0], o.place[1] - e.p[1], o.place[2] - e.p[2]
    left = dx * ux + dy * uy + dz * uz  # along the line; negative past the place
    bx, by, bz = dx - left * ux, dy - left * uy, dz - left * uz  # to its nearest point
    speed = _unhurried(e, o, now, ux, uy)
    back = g.position_p * math.hypot(bx, by)
    share = g.position_p * (min(1.0, _SIDEWAYS * speed / back) if back > 0.0 else 1.0)
    back = min(back, _SIDEWAYS * speed)
    along = math.sqrt(speed * speed - back * back)
    if (o.looks != 0 or c.axes[1] == 0) and math.hypot(ux, uy) * left > 2.0 * o.radius:
        # Without a thruster to the side the bow alone brings it back to the line.
        x, y = (0.0, 0.0) if c.axes[1] != 0 else (share * bx, share * by)
        o.heading = math.atan2(along * uy + y, along * ux + x)
        if abs(within(o.heading - heading_of(e))) > _UNTURNED_RAD:
            along *= _UNTURNED
    along = at_most(g.position_p * left, min(along, g.max_climb_mps / max(abs(uz), 1e-9)))
    climb = at_most(uz * along + g.depth_p * bz, g.max_climb_mps)
    return along * ux + share * bx, along * uy + share * by, climb


@compiled
def _unhurried(e: Any, o: Any, now: Any, ux: float, uy: float) -> float:
    """Speed on the way in a direction (unit, N), m/s: as told, but no faster than the vehicle can climb with the bottom."""
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
    """Vertical speed, m/s down; nan where the stick acts on the force."""
    g, mode, holds_attitude = o.gains, o.mode, o.attitude[0] == o.attitude[0]
    if mode in (STABILISE, HEADING_HOLD) or not now.depth:
        return NAN
    fast = g.surface_mps if mode == SURFACE else g.max_climb_mps
    if holds_attitude:
        wanted = at_most(o.heave, 1.0) * g.max_climb_mps
    elif o.frame == IN_N or o.frame == IN_B:  # B counts as level: down is the same
        wanted = o.velocity[2]
    else:
        wanted = move_depth(o, e, now.altitude, c.dt)
    if (holds_attitude or o.frame != NO_FRAME) and wanted != 0.0:
        o.depth = e.p[2] + at_most(o.depth + wanted * c.dt - e.p[2], 1.0)
    return float(at_most(wanted + g.depth_p * (o.depth - e.p[2]), max(fast, abs(wanted))))


@compiled
def _drive(e: Any, o: Any, c: Any, now: Any) -> tuple[float, float]:
    """Velocity north and east, m/s; nan where the sticks act on forces."""
    g, mode = o.gains, o.mode
    if mode == VELOCITY or (mode == GUIDED and o.frame != NO_FRAME):
        vx, vy = _velocity(e, o)
        return vx, vy
    holds_place = mode in (POSITION_HOLD, GUIDED, MISSION)
    if not holds_place or not now.position or o.attitude[0] == o.attitude[0]:
        return NAN, NAN
    vx, vy = move_place(o, e, c.dt)
    dx, dy = o.place[0] - e.p[0], o.place[1] - e.p[1]
    distance = math.hypot(dx, dy)
    speed = _unhurried(e, o, now, dx / max(distance, 1e-9), dy / max(distance, 1e-9))
    # Without a thruster to the side it gets to a place only bow first, whatever heading was asked for.
    if (o.looks != 0 or c.axes[1] == 0) and distance > 2.0 * o.radius:
        o.heading = math.atan2(dy, dx)
        # Not yet turned there: go slowly, as the vehicle is made to go ahead.
        if abs(within(o.heading - heading_of(e))) > _UNTURNED_RAD:
            speed *= _UNTURNED
    fast = min(speed, g.position_p * distance)
    scale = fast / distance if distance > 1e-9 else 0.0
    return vx + scale * dx, vy + scale * dy


@compiled
def _velocity(e: Any, o: Any) -> tuple[float, float]:
    v = three(o.velocity) if o.frame != NO_FRAME else _STILL
    if o.frame != IN_N:
        surge, sway = o.stick[0] * o.gains.max_speed_mps, o.stick[1] * o.gains.max_speed_mps
        v = rotate(quat_from_rpy(0.0, 0.0, heading_of(e)), (v[0] + surge, v[1] + sway, 0.0))
    return v[0], v[1]


# -- how it is done -------------------------------------------------------------------------------------------------------------------------


@compiled
def _unwind(e: Any, m: Any, o: Any, c: Any) -> None:
    """What the actuators could not give must not be asked for by the integrals: they give way."""
    k, lack, i = o.gains.unwind * c.dt, m.lack, c.inertia
    back = rotate(four(e.q), (k * lack[0] / i[0], k * lack[1] / i[1], k * lack[2] / i[2]))
    for n in range(3):
        m.push[n] -= back[n]
        m.twist[n] -= k * lack[3 + n] / i[3 + n]


@compiled
def _force(e: Any, m: Any, o: Any, c: Any, force: Vec3, v: Vec3) -> Vec3:
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
    # A vehicle that cannot choose its tilt would drive one axis by another's tilt, and tilt by that the more.
    back = conjugate(four(e.q) if _holds_tilt(c) else quat_from_rpy(0.0, 0.0, heading_of(e)))
    a = rotate(back, (ax, ay, az))
    # What the water takes at the wanted speed: the integrals need not learn it on the way, and forget it at the end.
    u = rotate(back, (vx, vy, vz))
    i, linear, square = c.inertia, c.linear, c.quadratic
    return (
        a[0] * i[0] + (linear[0] + square[0] * abs(u[0])) * u[0] + force[0],
        a[1] * i[1] + (linear[1] + square[1] * abs(u[1])) * u[1] + force[1],
        a[2] * i[2] + (linear[2] + square[2] * abs(u[2])) * u[2] + force[2],
    )


@compiled
def _moment(e: Any, m: Any, o: Any, c: Any, moment: Vec3, wanted: Quat, rates: Vec3) -> Vec3:
    g, dt, i, k = o.gains, c.dt, c.inertia, m.twist
    x, y, z = rates
    if x != x:
        set_three(k, _STILL)
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
