"""Fins and a propeller as a wrench: fins whose effect grows with the square of the speed, and a shaft whose thrust falls with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np

from uwserver.autopilot.allocation import PITCH, ROLL, YAW, Given, controllable, fitted, inverse
from uwserver.autopilot.state import Six

SLOW_MPS = 0.3
"""Below this speed fins are taken to work as if at it."""


@dataclass(frozen=True)
class FinEffect:
    """One fin: wrench about the origin in B per rad at 1 m/s, and its largest angle, rad."""

    column: Six
    limit: float


@dataclass(frozen=True)
class Shaft:
    """A propeller: T = rho D^4 n^2 (a - b J), J = U / (n D), with n in revolutions a second.

    Attributes:
        a, b: of the thrust coefficient, straight over J.
        strength: rho D^4, with the thrust deduction.
        advance: 1 - wake fraction.
        diameter: m.
        astern: thrust astern over that ahead.
        limit: of its speed, rad/s.
    """

    a: float
    b: float
    strength: float
    advance: float
    diameter: float
    astern: float
    limit: float

    def thrust(self, speed_radps: float, u: float) -> float:
        """Thrust (N) at a shaft speed (rad/s) and a speed through the water (m/s)."""
        n = speed_radps / (2.0 * math.pi)
        if n < 0.0:
            return -self.astern * self.strength * self.a * n * n
        return self.strength * (self.a * n * n - self.b * n * self.advance * max(u, 0.0) / self.diameter)

    def speed(self, thrust: float, u: float) -> float:
        """The least shaft speed (rad/s) that makes a thrust (N), within the limit."""
        if thrust < 0.0:
            n = -math.sqrt(-thrust / (self.astern * self.strength * self.a))
        else:
            half = 0.5 * self.b * self.advance * max(u, 0.0) / self.diameter
            n = (half + math.sqrt(half * half + self.a * thrust / self.strength)) / self.a if thrust > 0.0 else 0.0
        return min(max(2.0 * math.pi * n, -self.limit), self.limit)


class FinsAndShaft:
    """The actuators of a torpedo. Its `reach` is that at rest ahead, and at 1 m/s of its fins."""

    def __init__(self, groups: Sequence[Sequence[FinEffect]], shaft: Shaft, shafts: int = 1) -> None:
        """Of each actuator its fins; those of the propellers come last. `shaft` stands for all of them together, which turn alike."""
        fins = [fin for group in groups for fin in group]
        self.shaft = shaft
        columns = np.array([fin.column for fin in fins]).T.copy()
        moments = columns.copy()
        moments[:3] = 0.0
        limits = np.array([fin.limit for fin in fins])
        turning = controllable(moments)
        self.axes: tuple[int, ...] = (0, *turning)
        into = inverse(moments, limits, turning)
        strongest = [float(np.abs(columns[axis]) @ limits) if axis in turning else 0.0 for axis in range(6)]
        self.reach: Six = (shaft.thrust(shaft.limit, 0.0), 0.0, 0.0, strongest[ROLL], strongest[PITCH], strongest[YAW])
        self._low, self._high = (-limits).tolist(), limits.tolist()
        self._into = [tuple(row[3:]) for row in into.tolist()]
        self._columns = [tuple(row) for row in columns[3:].tolist()]
        self._shafts = shafts
        self._sizes = [len(group) for group in groups]

    def allocate(self, tau: Sequence[float], speed: float) -> tuple[list[Given], Six]:
        """See `Allocation`. Pitch and roll keep their share before yaw: a torpedo that loses its depth is worse off than one off its line."""
        pressure = max(speed, SLOW_MPS) ** 2
        roll, pitch, yaw = (t / pressure for t in tau[3:])
        first = [row[0] * roll + row[1] * pitch for row in self._into]
        angles = fitted(first, [row[2] * yaw for row in self._into], self._low, self._high)
        shaft = self.shaft.speed(tau[0], speed)
        k, m, n = [pressure * sum(map(mul, row, angles)) for row in self._columns]
        given: list[Given] = []
        start = 0
        for size in self._sizes:
            given.append((tuple(angles[start : start + size]),))
            start += size
        given += [((shaft,),)] * self._shafts
        return given, (self.shaft.thrust(shaft, speed), 0.0, 0.0, k, m, n)
