"""What the examples share: from forces to the eight thrusters of a BlueROV2 Heavy, and control that neither overshoots nor chatters. SI, angles in rad."""

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
        self.value: float | None = None
        self.rate = 0.0

    def update(self, measured: float) -> None:
        """Take in one value each control step."""
        if self.value is None:
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


def body_forces(north: float, east: float, heading: float) -> tuple[float, float]:
    """Surge and sway of a force in N."""
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
