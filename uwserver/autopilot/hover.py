"""Control of a vehicle that can hover: cascades from position to velocity to force, and from attitude to rate to moment."""

from __future__ import annotations

import math
from typing import NamedTuple

from uwserver.autopilot import route
from uwserver.autopilot.estimator import Known
from uwserver.autopilot.state import NAN, STILL, Estimate, Memory, Orders, Six
from uwserver.autopilot.sticks import CENTRED, clamped, heading_of, move_depth, move_heading, move_place, wrapped
from uwserver.frames import Quat, Vec3, conjugate, multiply, quat_from_rpy, rotate, rpy_from_quat

_RISE = 0.4
"""Part of the power upwards that brings a vehicle up which does not know its depth."""
_LEANING_RAD, _LEANT_RAD = 0.2, 0.6
"""A vehicle that cannot hold its tilt slows down from the first on, to a crawl at the second: heave and surge together lean it over."""
_CRAWL = 0.15
_SIDEWAYS = 0.7
"""Part of its speed with which a vehicle goes back to its line at most; the rest is for the way along it."""
_UNTURNED_RAD, _UNTURNED = 0.8, 0.3
"""A vehicle that looks where it goes goes with this part of its speed while it has farther to turn."""
_FORGET_S = 5.0
"""Time constant with which a learnt current is forgotten while nobody holds against it, s."""


class Wish(NamedTuple):
    """What the outer loops want.

    Attributes:
        force: from the sticks, N in B; moment: likewise, N m.
        v: velocity in N that is to be reached, m/s; nan where the sticks act on forces: x and y go together.
        q: attitude that is to be reached; None for none.
        rates: beside it, or alone, rad/s in B; None for none.
    """

    force: Vec3
    moment: Vec3
    v: Vec3
    q: Quat | None
    rates: Vec3 | None


class Hover:
    """The cascades of one vehicle; stateless."""

    def __init__(self, inertia: Six, drag: tuple[Six, Six], reach: Six, axes: tuple[int, ...], dt: float) -> None:
        """For a vehicle.

        Args:
            inertia: with added mass, kg and kg m2, of each axis.
            drag: linear and quadratic damping of each axis, N s/m and N s2/m2.
            reach: largest wrench of each axis, N and N m.
            axes: that can be controlled.
            dt: of a step, s.
        """
        self._inertia, self._reach, self._dt = inertia, reach, dt
        self._drag = [(linear, quadratic) for linear, quadratic in zip(*drag, strict=True)]
        self._turns = tuple(1.0 if axis in axes else 0.0 for axis in (3, 4, 5))
        self._upright = 3 in axes and 4 in axes
        self._sideways = 1 in axes

    def speed(self, e: Estimate, m: Memory, known: Known) -> float:
        """Ahead, m/s; thrusters are taken to give the same at any."""
        return 0.0

    def demand(self, e: Estimate, m: Memory, o: Orders, known: Known) -> Six:
        """The wrench (B) that carries out the orders; moves set points by the sticks."""
        wish = self._wish(e, o, known)
        self._unwind(e, m, o)
        return (*self._force(e, m, o, wish), *self._moment(e, m, o, wish))

    # -- what is wanted -------------------------------------------------------------------------------------------------------------

    def _wish(self, e: Estimate, o: Orders, known: Known) -> Wish:
        g, mode = o.gains, o.mode
        fx, fy, fz, tx, ty, tz = (s * r * g.stick for s, r in zip(o.stick, self._reach, strict=True))
        if mode == "manual":
            return Wish((fx, fy, fz), (tx, ty, tz), (NAN,) * 3, None, None)
        if mode == "acro":
            rates = (o.stick[3] * g.max_rate_radps, o.stick[4] * g.max_rate_radps, o.stick[5] * g.max_yaw_rate_radps)
            return Wish((fx, fy, fz), STILL, (NAN,) * 3, None, rates)
        slow = self._caution(e)
        vx, vy, vz = (slow * v for v in self._wanted(e, o, known))
        force = (fx if vx != vx else 0.0, fy if vx != vx else 0.0, fz if vz != vz else 0.0)
        if mode == "surface" and not known.depth:
            force = (fx, fy, -_RISE * self._reach[2])
        if o.attitude is not None:
            return Wish(force, STILL, (vx, vy, vz), o.attitude, None)
        turn = move_heading(o, e, self._dt)
        # Where nothing can be done about a tilt it must not be seen as an error of heading either.
        roll, pitch, _ = rpy_from_quat(e.q)
        roll = o.stick[3] * g.max_tilt_rad if self._turns[0] else roll
        pitch = o.stick[4] * g.max_tilt_rad if self._turns[1] else pitch
        q = quat_from_rpy(roll, pitch, o.heading)
        return Wish(force, STILL, (vx, vy, vz), q, (0.0, 0.0, turn))

    def _caution(self, e: Estimate) -> float:
        """By how much to slow down because of a tilt that nothing holds."""
        if self._upright:
            return 1.0
        up = rotate(conjugate(e.q), (0.0, 0.0, 1.0))
        tilt = math.acos(clamped(up[2], 1.0))
        return max(_CRAWL, 1.0 - max(0.0, tilt - _LEANING_RAD) / (_LEANT_RAD - _LEANING_RAD))

    def _wanted(self, e: Estimate, o: Orders, known: Known) -> Vec3:
        """Velocity in N, m/s; nan where the sticks act on forces."""
        goes = o.mode in ("guided", "mission") and known.position and not o.frame and o.attitude is None
        leg = route.leg(o, e) if goes and max(map(abs, o.stick[:3])) <= CENTRED else None
        if leg is not None:
            return self._follow(e, o, leg)
        return (*self._drive(e, o, known), self._climb(e, o, known))

    def _follow(self, e: Estimate, o: Orders, leg: route.Leg) -> Vec3:
        """Along the line to the place, and back to it: straight to the place a current would carry it on an arc, and each corner would be cut."""
        g, (ux, uy, uz), (bx, by, bz) = o.gains, leg.towards, leg.beside
        speed = g.max_speed_mps if o.speed != o.speed else o.speed
        back = g.position_p * math.hypot(bx, by)
        share = g.position_p * (min(1.0, _SIDEWAYS * speed / back) if back > 0.0 else 1.0)
        back = min(back, _SIDEWAYS * speed)
        along = math.sqrt(speed * speed - back * back)
        flat = math.hypot(ux, uy)
        looks = (o.looks or not self._sideways) and flat * leg.left > 2.0 * o.radius
        if looks:
            # Without a thruster to the side the bow alone brings it back to the line.
            x, y = (0.0, 0.0) if self._sideways else (share * bx, share * by)
            o.heading = math.atan2(along * uy + y, along * ux + x)
            if abs(wrapped(o.heading - heading_of(e))) > _UNTURNED_RAD:
                along *= _UNTURNED
        along = clamped(g.position_p * leg.left, min(along, g.max_climb_mps / max(abs(uz), 1e-9)))
        climb = clamped(uz * along + g.depth_p * bz, g.max_climb_mps)
        return along * ux + share * bx, along * uy + share * by, climb

    def _climb(self, e: Estimate, o: Orders, known: Known) -> float:
        """Vertical speed, m/s down; nan where the stick acts on the force."""
        g, mode = o.gains, o.mode
        if mode in ("stabilise", "heading_hold") or not known.depth:
            return NAN
        fast = g.surface_mps if mode == "surface" else g.max_climb_mps
        if o.attitude is not None:
            wanted = clamped(o.heave, 1.0) * g.max_climb_mps
        elif o.frame == "N":
            wanted = o.velocity[2]
        elif o.frame == "B":
            wanted = rotate(quat_from_rpy(0.0, 0.0, heading_of(e)), o.velocity)[2]
        else:
            wanted = move_depth(o, e, known, self._dt)
        if (o.attitude is not None or o.frame) and wanted:
            o.depth = e.p[2] + clamped(o.depth + wanted * self._dt - e.p[2], 1.0)
        return clamped(wanted + g.depth_p * (o.depth - e.p[2]), max(fast, abs(wanted)))

    def _drive(self, e: Estimate, o: Orders, known: Known) -> tuple[float, float]:
        """Velocity north and east, m/s; nan where the sticks act on forces."""
        g, mode = o.gains, o.mode
        if mode == "velocity" or (mode == "guided" and o.frame):
            return self._velocity(e, o)
        if mode not in ("position_hold", "guided", "mission") or not known.position or o.attitude is not None:
            return NAN, NAN
        vx, vy = move_place(o, e, self._dt)
        dx, dy = o.place[0] - e.p[0], o.place[1] - e.p[1]
        distance = math.hypot(dx, dy)
        speed = g.max_speed_mps if o.speed != o.speed else o.speed
        # Without a thruster to the side it gets to a place only bow first, whatever heading was asked for.
        looks = (o.looks or not self._sideways) and distance > 2.0 * o.radius
        if looks:
            o.heading = math.atan2(dy, dx)
        # Not yet turned there: go slowly, as the vehicle is made to go ahead.
        if looks and abs(wrapped(o.heading - heading_of(e))) > _UNTURNED_RAD:
            speed *= _UNTURNED
        fast = min(speed, g.position_p * distance)
        scale = fast / distance if distance > 1e-9 else 0.0
        return vx + scale * dx, vy + scale * dy

    def _velocity(self, e: Estimate, o: Orders) -> tuple[float, float]:
        v = o.velocity if o.frame else STILL
        if o.frame != "N":
            surge, sway = o.stick[0] * o.gains.max_speed_mps, o.stick[1] * o.gains.max_speed_mps
            level = quat_from_rpy(0.0, 0.0, heading_of(e))
            v = rotate(level, (v[0] + surge, v[1] + sway, 0.0))
        return v[0], v[1]

    # -- how it is done -------------------------------------------------------------------------------------------------------------

    def _unwind(self, e: Estimate, m: Memory, o: Orders) -> None:
        """What the actuators could not give must not be asked for by the integrals: they give way."""
        if not any(m.lack):
            return
        k = o.gains.unwind * self._dt
        a, b, c, d, f, g = (k * lack / inertia for lack, inertia in zip(m.lack, self._inertia, strict=True))
        x, y, z = rotate(e.q, (a, b, c))
        m.push = (m.push[0] - x, m.push[1] - y, m.push[2] - z)
        m.twist = (m.twist[0] - d, m.twist[1] - f, m.twist[2] - g)

    def _force(self, e: Estimate, m: Memory, o: Orders, wish: Wish) -> Vec3:
        g, dt = o.gains, self._dt
        (vx, vy, vz), (px, py, pz) = wish.v, m.push
        ax = ay = az = 0.0
        if vx == vx:
            dx, dy = vx - e.v[0], vy - e.v[1]
            ax, ay = g.velocity_p * dx + px, g.velocity_p * dy + py
            px, py = px + g.velocity_i * dx * dt, py + g.velocity_i * dy * dt
        else:
            px, py = px - px * dt / _FORGET_S, py - py * dt / _FORGET_S
        if vz == vz:
            dz = vz - e.v[2]
            az = g.climb_p * dz + pz
            pz += g.climb_i * dz * dt
        m.push = (px, py, pz)
        # A vehicle that cannot choose its tilt would drive one axis by another's tilt, and tilt by that the more.
        back = conjugate(e.q if self._upright else quat_from_rpy(0.0, 0.0, heading_of(e)))
        a, b, c = rotate(back, (ax, ay, az))
        # What the water takes at the wanted speed: the integrals need not learn it on the way, and forget it at the end.
        u, v, w = rotate(back, (0.0 if vx != vx else vx, 0.0 if vx != vx else vy, 0.0 if vz != vz else vz))
        i, force = self._inertia, wish.force
        (lu, qu), (lv, qv), (lw, qw) = self._drag[:3]
        return (
            a * i[0] + (lu + qu * abs(u)) * u + force[0],
            b * i[1] + (lv + qv * abs(v)) * v + force[1],
            c * i[2] + (lw + qw * abs(w)) * w + force[2],
        )

    def _moment(self, e: Estimate, m: Memory, o: Orders, wish: Wish) -> Vec3:
        if wish.q is None and wish.rates is None:
            m.twist = STILL
            return wish.moment
        g, dt, i = o.gains, self._dt, self._inertia
        x, y, z = wish.rates or STILL
        if wish.q is not None:
            w, a, b, c = multiply(conjugate(e.q), wish.q)
            two = math.copysign(2.0, w)
            x += clamped(g.attitude_p * two * a, g.max_rate_radps)
            y += clamped(g.attitude_p * two * b, g.max_rate_radps)
            z += clamped(g.heading_p * two * c, min(g.max_yaw_rate_radps, o.turn_limit))
        tx, ty, tz = self._turns
        dx, dy, dz = tx * (x - e.w[0]), ty * (y - e.w[1]), tz * (z - e.w[2])
        kx, ky, kz = m.twist
        m.twist = (kx + g.rate_i * dx * dt, ky + g.rate_i * dy * dt, kz + g.yaw_rate_i * dz * dt)
        return (i[3] * (g.rate_p * dx + kx), i[4] * (g.rate_p * dy + ky), i[5] * (g.yaw_rate_p * dz + kz))
