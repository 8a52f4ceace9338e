"""What the examples share: forces to the eight thrusters of a BlueROV2 Heavy, and control that neither overshoots nor chatters. SI, rad."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import uwclient

TICKS = 12
"""Of 240 Hz between two commands."""
DT_S = TICKS / 240.0

_FULL_N, _ARM_M, _COS = 30.4, 0.189, math.sqrt(0.5)
_HORIZONTAL = ((-1, 1, 1), (-1, -1, -1), (1, 1, -1), (1, -1, 1))
"""Signs of surge, sway and yaw in ArduSub's motor order: front right, front left, rear right, rear left."""

SURGE, SWAY, HEAVE, YAW = ((19.9, 4.0, 34.6), (20.6, 6.2, 74.5), (32.2, 5.2, 91.6), (0.59, 0.1, 1.5))
"""Mass with added mass (moment of inertia), linear and quadratic drag of the vehicle file: what a controller may know of its vehicle."""


def thrusters(surge: float, sway: float, heave: float, yaw: float) -> list[float]:
    """Commands u of eight thrusters for three forces (N) and a moment (N m)."""
    level = [(a * surge + b * sway) / (4 * _COS) + c * yaw / (4 * _ARM_M) for a, b, c in _HORIZONTAL]
    return [_command(force) for force in (*level, *[heave / 4] * 4)]


def _command(force_n: float) -> float:
    """u of a thruster. The step over its dead band is taken smoothly: a sign that changes with the noise of a sensor must not shake it."""
    share = force_n / _FULL_N
    u = 0.075 * math.tanh(force_n / 0.3) + math.copysign(0.92 * abs(share) ** 0.8, share)
    return max(-1.0, min(1.0, u))


class Tracker:
    """Position and rate of a noisy signal: an alpha-beta filter, critically damped."""

    def __init__(self, bandwidth: float = 9.0) -> None:
        fade = math.exp(-bandwidth * DT_S)
        self._alpha, self._beta = 1 - fade * fade, (1 - fade) ** 2
        self.value = math.nan
        self.rate = 0.0

    def update(self, measured: float) -> None:
        """Take in one value each control step."""
        if math.isnan(self.value):
            self.value = measured
        self.value += self.rate * DT_S
        miss = measured - self.value
        self.value += self._alpha * miss
        self.rate += self._beta / DT_S * miss


class Axis:
    """Force on a mass (moment on an inertia): what drag takes at the wanted rate, and PID so that an error goes away like exp(-bandwidth t)."""

    def __init__(self, body: tuple[float, float, float], bandwidth: float, limit: float) -> None:
        mass, *self._drag = body
        self._p, self._d, self._i = mass * bandwidth**2, 2 * mass * bandwidth, 0.2 * mass * bandwidth**3
        self._limit, self._sum = limit, 0.0

    def update(self, error: float, rate: float, wanted_rate: float = 0.0) -> float:
        """Error: wanted less found, in value; its integral stands while the force is at its limit."""
        linear, quadratic = self._drag
        force = (linear + quadratic * abs(wanted_rate)) * wanted_rate
        force += self._p * error + self._d * (wanted_rate - rate) + self._sum
        if abs(force) < self._limit:
            self._sum += self._i * error * DT_S
        return max(-self._limit, min(self._limit, force))


class Ramp:
    """A set point that moves to its goal no faster than the vehicle can follow, and gently."""

    def __init__(self, value: float, speed: float, acceleration: float, difference: Callable[[float], float] = float):
        self.value, self.rate = value, 0.0
        self._speed, self._acceleration, self._difference = speed, acceleration, difference

    def update(self, goal: float) -> None:
        """One control step towards the goal."""
        way = self._difference(goal - self.value)
        speed = min(self._speed, math.sqrt(2 * self._acceleration * abs(way)), abs(way) / DT_S)
        change = self._acceleration * DT_S
        self.rate += max(-change, min(change, math.copysign(speed, way) - self.rate))
        self.value += self.rate * DT_S


class DeadReckoning:
    """Place (north, east) from the velocity of a DVL, turned by the attitude of an AHRS; the last velocity stands while the DVL has no lock."""

    def __init__(self, north: float = 0.0, east: float = 0.0) -> None:
        self.north, self.east, self.heading = north, east, 0.0
        self.v_B = (0.0, 0.0, 0.0)

    def update(self, dvl: uwclient.Sample, ahrs: uwclient.Sample) -> None:
        """One control step."""
        if dvl.valid:
            self.v_B = dvl.vector("v_S")
        v_N = rotated(ahrs.vector("q_NS"), self.v_B)
        self.north, self.east = self.north + v_N[0] * DT_S, self.east + v_N[1] * DT_S
        self.heading = ahrs.number("heading")


class Pilot:
    """Velocity over ground, depth and heading together, from ramped set points to thrusters."""

    def __init__(self, depth: float, heading: float) -> None:
        self.depth = Tracker()
        self._surge, self._sway = Axis(SURGE, 1.3, 60.0), Axis(SWAY, 1.3, 60.0)
        self._heave, self._yaw = Axis(HEAVE, 1.2, 80.0), Axis(YAW, 3.0, 12.0)
        self._to_depth = Ramp(depth, 0.3, 0.1)
        self._to_heading = Ramp(heading, math.radians(30), math.radians(20), wrapped)
        self._to = [Ramp(0.0, 1.0, 0.2), Ramp(0.0, 1.0, 0.2)]
        self._behind = [0.0, 0.0]

    def command(
        self,
        place: DeadReckoning,
        depth: float,
        yaw_rate: float,
        goal: tuple[float, float],
        down: float,
        heading: float,
    ) -> list[float]:
        """Thrusters' u for one control step.

        Args:
            place: dead reckoning.
            depth, yaw_rate: of their sensors.
            goal: velocity over ground that is wanted, surge and sway.
            down, heading: depth and heading that are wanted.
        """
        self.depth.update(depth)
        self._to_depth.update(down)
        self._to_heading.update(heading)
        forces = []
        for k, axis in enumerate((self._surge, self._sway)):
            ramp = self._to[k]
            ramp.update(goal[k])
            # The way by which the vehicle is behind: so PID holds a speed, and a current is taken out.
            behind = self._behind[k] + (ramp.value - place.v_B[k]) * DT_S
            self._behind[k] = max(-0.3, min(0.3, behind))
            forces.append(axis.update(self._behind[k], place.v_B[k], ramp.value))
        heave = self._heave.update(self._to_depth.value - self.depth.value, self.depth.rate, self._to_depth.rate)
        error = wrapped(self._to_heading.value - place.heading)
        return thrusters(*forces, heave, self._yaw.update(error, yaw_rate, self._to_heading.rate))


def wrapped(angle: float) -> float:
    """The same angle between -pi and pi."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def rotated(q: Sequence[float], v: Sequence[float]) -> tuple[float, float, float]:
    """A vector of the turned frame (S or B) in N, by the attitude w x y z."""
    w, x, y, z = q
    tx, ty, tz = (2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0]))
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def body_axes(north: float, east: float, heading: float) -> tuple[float, float]:
    """Surge and sway of a force or velocity in N."""
    c, s = math.cos(heading), math.sin(heading)
    return c * north + s * east, -s * north + c * east


def until_heard(client: uwclient.Client, ports: Sequence[str], patience: int = 400) -> None:
    """Step the world until every port has told something valid: an AHRS settles for a second or two."""
    for _ in range(patience):
        client.step(TICKS)
        samples = [client.latest(port) for port in ports]
        if all(sample is not None and sample.valid for sample in samples):
            return
    raise SystemExit(f"not heard within {patience * DT_S:g} s: {', '.join(ports)}")
