"""Control of a torpedo: speed by the propeller, depth by pitch by the stern planes, heading by the rudder, lines by looking ahead."""

from __future__ import annotations

import math

from uwserver.autopilot.estimator import Known
from uwserver.autopilot.fins import SLOW_MPS, Shaft
from uwserver.autopilot.state import NAN, STILL, Estimate, Memory, Orders, Six
from uwserver.autopilot.sticks import clamped, heading_of, move_depth, move_heading, wrapped
from uwserver.frames import conjugate, rotate, rpy_from_quat

_CRAB_S = 4.0
"""Time constant with which the drift across the heading is learnt, s; likewise that across the pitch."""
_LEVEL = 0.03
"""Slope of the way (rad) up to which the latter is learnt: on a steep way a current along it looks like drift."""
_START_S = 3.0
"""Time constant of the speed while it is not measured, s."""


class Torpedo:
    """The cascades of one vehicle; stateless."""

    def __init__(self, inertia: Six, righting: float, reach: Six, shaft: Shaft, up: float, dt: float) -> None:
        """For a vehicle.

        Args:
            inertia: with added mass, kg and kg m2, of each axis.
            righting: moment over the sine of roll or pitch, by weight and buoyancy, N m.
            reach: of the propeller at rest (N), of the fins at 1 m/s (N m).
            shaft: the propeller.
            up: depth of the origin from which on it has come up, m.
            dt: of a step, s.
        """
        self._inertia, self._righting, self._reach, self._shaft, self._up, self._dt = (
            inertia,
            righting,
            reach,
            shaft,
            up,
            dt,
        )

    def speed(self, e: Estimate, m: Memory, known: Known) -> float:
        """Ahead, m/s: measured, or as the propeller should have made it."""
        return rotate(conjugate(e.q), e.v)[0] if known.velocity else m.through

    def demand(self, e: Estimate, m: Memory, o: Orders, known: Known) -> Six:
        """The wrench (B) that carries out the orders; moves set points by the sticks."""
        u = self.speed(e, m, known)
        self._learn(e, m, o, u, known)
        pressure = max(u, SLOW_MPS) ** 2
        surge = self._surge(e, m, o, u, known)
        turned = surge if surge == surge else 0.0
        goal = self._shaft.speed(turned, u) / o.gains.shaft_per_speed if o.gains.shaft_per_speed else 0.0
        m.through += (goal - m.through) * self._dt / _START_S
        if o.mode == "manual":
            turning = zip(o.stick[3:], self._reach[3:], strict=True)
            roll, pitch, yaw = (s * r * pressure * o.gains.stick for s, r in turning)
            m.twist = STILL
            return (surge, 0.0, 0.0, roll, pitch, yaw)
        return (surge, 0.0, 0.0, *self._moment(e, m, o, u, known))

    def _learn(self, e: Estimate, m: Memory, o: Orders, u: float, known: Known) -> None:
        if known.velocity and u > SLOW_MPS:
            crab = wrapped(math.atan2(e.v[1], e.v[0]) - heading_of(e))
            m.crab += (clamped(crab, 0.5) - m.crab) * self._dt / _CRAB_S
        if known.depth and u > SLOW_MPS:
            _, pitch, _ = rpy_from_quat(e.q)
            slope = clamped(e.v[2] / u, 0.5)
            weight = 1.0 / (1.0 + (slope / _LEVEL) ** 2)
            m.sag += weight * (clamped(slope + pitch, o.gains.max_tilt_rad) - m.sag) * self._dt / _CRAB_S

    # -- ahead ----------------------------------------------------------------------------------------------------------------------

    def _surge(self, e: Estimate, m: Memory, o: Orders, u: float, known: Known) -> float:
        """Force ahead, N."""
        g = o.gains
        wanted = self._wanted(e, o)
        if wanted != wanted:
            m.push = STILL
            return o.stick[0] * abs(o.stick[0]) * self._reach[0] * g.stick
        force = self._shaft.thrust(wanted * g.shaft_per_speed, max(wanted, 0.0))
        if not known.velocity or wanted == 0.0:
            m.push = STILL
            return force
        off = wanted - u
        push = m.push[0] + g.velocity_i * off * self._dt - g.unwind * self._dt * m.lack[0] / self._inertia[0]
        m.push = (push, 0.0, 0.0)
        return force + self._inertia[0] * (g.velocity_p * off + push)

    def _wanted(self, e: Estimate, o: Orders) -> float:
        """Speed ahead, m/s; nan where the stick acts on the propeller."""
        g, mode = o.gains, o.mode
        if mode == "velocity" or (mode == "guided" and o.frame):
            if not o.frame:
                return o.stick[0] * g.max_speed_mps
            return o.velocity[0] if o.frame == "B" else math.hypot(*o.velocity)
        if mode == "surface":
            return 0.0 if e.p[2] < self._up else g.cruise_mps
        if mode in ("position_hold", "guided", "mission"):
            return g.cruise_mps if o.speed != o.speed else min(o.speed, g.max_speed_mps)
        return NAN

    # -- up, down and round ---------------------------------------------------------------------------------------------------------

    def _moment(self, e: Estimate, m: Memory, o: Orders, u: float, known: Known) -> tuple[float, float, float]:
        g, dt, i = o.gains, self._dt, self._inertia
        roll, pitch, _ = rpy_from_quat(e.q)
        held = 0.0
        if o.mode == "acro":
            p, q, r = (o.stick[3] * g.max_rate_radps, o.stick[4] * g.max_rate_radps, o.stick[5] * g.max_yaw_rate_radps)
        else:
            target = self._pitch(e, m, o, u, known)
            held = self._righting * math.sin(target)
            self._course(e, m, o, known)
            turn = move_heading(o, e, dt)
            p = g.attitude_p * clamped(-roll, 0.5)
            q = clamped(g.attitude_p * (target - pitch), g.max_rate_radps)
            limit = min(g.max_yaw_rate_radps, o.turn_limit)
            r = clamped(turn + g.heading_p * wrapped(o.heading - heading_of(e)), limit)
        dp, dq, dr = p - e.w[0], q - e.w[1], r - e.w[2]
        unwind = g.unwind * dt
        _, b, c = m.twist
        if u > SLOW_MPS:  # slower, the fins do nothing that could be learnt from
            b += g.rate_i * dq * dt - unwind * m.lack[4] / i[4]
            c += g.yaw_rate_i * dr * dt - unwind * m.lack[5] / i[5]
        m.twist = (0.0, b, c)
        return i[3] * g.rate_p * dp, i[4] * (g.rate_p * dq + b) + held, i[5] * (g.yaw_rate_p * dr + c)

    def _pitch(self, e: Estimate, m: Memory, o: Orders, u: float, known: Known) -> float:
        """Pitch to hold, rad."""
        g, mode = o.gains, o.mode
        if o.attitude is not None:
            return rpy_from_quat(o.attitude)[1]
        if mode in ("stabilise", "heading_hold"):
            return o.stick[4] * g.max_tilt_rad
        if not known.depth:
            return g.max_tilt_rad if mode == "surface" else 0.0
        dive = move_depth(o, e, known, self._dt)
        if o.frame and o.velocity[2]:
            dive = o.velocity[2]
            o.depth = e.p[2] + clamped(o.depth + dive * self._dt - e.p[2], 1.0)
        off = o.depth - e.p[2]
        slope = g.depth_p * off + dive / max(u, SLOW_MPS)
        return clamped(m.sag - slope, g.max_tilt_rad)

    def _course(self, e: Estimate, m: Memory, o: Orders, known: Known) -> None:
        """Set the heading so that the vehicle follows its line, its circle, or its velocity."""
        if o.attitude is not None:
            o.heading = rpy_from_quat(o.attitude)[2]
            return
        if o.frame == "N" and math.hypot(o.velocity[0], o.velocity[1]) > 1e-3:
            o.heading = wrapped(math.atan2(o.velocity[1], o.velocity[0]) - m.crab)
            return
        if o.frame or o.mode not in ("position_hold", "guided", "mission") or not known.position:
            return
        o.heading = wrapped(self._towards(e, o) - m.crab)

    def _towards(self, e: Estimate, o: Orders) -> float:
        """Course over ground to the place, rad."""
        dx, dy = o.place[0] - e.p[0], o.place[1] - e.p[1]
        away, bearing = math.hypot(dx, dy), math.atan2(dy, dx)
        if o.mode != "mission" and math.dist(e.p, o.place) <= o.radius:
            o.settled = True
        if o.origin[0] != o.origin[0] or o.settled:
            # Clockwise round the place: towards it from afar, square to it on the circle.
            return bearing - 0.5 * math.pi + math.atan2(away - o.gains.orbit_m, 0.5 * o.gains.orbit_m)
        if o.astray:
            # Past it, and inside its own turning circle: first away from it.
            if away < 2.5 * o.gains.orbit_m:
                return wrapped(bearing + math.pi)
            o.astray, o.origin = False, e.p
        lx, ly = o.place[0] - o.origin[0], o.place[1] - o.origin[1]
        length = math.hypot(lx, ly)
        if length < 1e-6:
            return bearing
        along, across = (lx * dx + ly * dy) / length, (lx * dy - ly * dx) / length
        if along < -o.radius:
            o.astray = True
        ahead = min(o.gains.look_ahead_m, max(along, 0.5 * o.gains.look_ahead_m))
        return math.atan2(ly, lx) + math.atan2(across, ahead)
