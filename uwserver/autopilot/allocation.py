"""Which command each actuator gets so that together they make a wrench: pseudo-inverse, limits, and inverted thrust curves.

When the actuators cannot give everything, heave and moments keep their share before surge and sway: a vehicle that turns over or sinks loses more
than one that is slow.

Closed forms: f = W^-1 B^T (B W^-1 B^T + lambda I)^-1 tau is the least sum of (f_i / limit_i)^2 among all forces that make tau (Fossen 2011,
section 12.3.2), with a small damping lambda against axes that are almost out of reach.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul
from typing import Protocol

import numpy as np

from uwserver.autopilot.state import Six
from uwserver.physics.kernel.arrays import FloatArray

SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)
IMPORTANCE = (HEAVE, YAW, SURGE, SWAY, ROLL, PITCH)
"""Which axes are controlled where there are not enough actuators for all."""
DAMPING = 1e-3
"""Square root of lambda over the largest singular value."""
_OUT_OF_REACH = 0.05
"""An axis is out of reach whose wrench, in the best case, leaves this part of it to the axes that are controlled already."""

Given = tuple[tuple[float, ...] | None, ...]


@dataclass(frozen=True)
class Thrust:
    """One thruster as its maker describes it.

    Attributes:
        column: (6) wrench about the origin in B per newton.
        curve: (u, N) ascending in both, installed, at the supply's voltage.
    """

    column: Six
    curve: tuple[tuple[float, float], ...]


class Allocation(Protocol):
    """The actuators of a vehicle, seen as a wrench."""

    axes: tuple[int, ...]
    reach: Six

    def allocate(self, tau: Sequence[float], speed: float) -> tuple[list[Given], Six]:
        """Commands of the held actuators, in their order, and the wrench that they will make.

        Args:
            tau: demanded (6), N and N m in B; what is demanded of axes out of reach is ignored.
            speed: surge through the water, m/s.
        """


def controllable(columns: FloatArray) -> tuple[int, ...]:
    """Axes (ascending) that can be commanded independently, the most important first; `columns` is (6, n), each of unit strength."""
    kept: list[int] = []
    arm = max(float(np.abs(columns[3:]).max(initial=0.0)), 1e-9)
    scaled = columns.copy()
    scaled[3:] /= arm
    for axis in IMPORTANCE:
        row = scaled[axis]
        length = float(np.linalg.norm(row))
        if length < 1e-9:
            continue
        if kept:
            base = scaled[kept]
            rest = row - base.T @ np.linalg.lstsq(base.T, row, rcond=None)[0]
            if float(np.linalg.norm(rest)) < _OUT_OF_REACH * length:
                continue
        if length > _OUT_OF_REACH * float(np.abs(scaled).max()):
            kept.append(axis)
    return tuple(sorted(kept))


def inverse(columns: FloatArray, limits: FloatArray, axes: Sequence[int]) -> FloatArray:
    """(n, 6) from a wrench to actuators; zero columns for axes that are not among `axes`.

    Args:
        columns: (6, n) wrench per unit of each actuator.
        limits: (n) of each actuator, which weigh them against each other.
        axes: those that are made exactly, but for the damping.
    """
    arm = max(float(np.abs(columns[3:]).max(initial=0.0)), 1e-9)
    rows = np.array([1.0] * 3 + [1.0 / arm] * 3)[list(axes)]
    weighted = (columns[list(axes)] * rows[:, None]) * limits
    damping = (DAMPING * np.linalg.norm(weighted, 2)) ** 2
    small = weighted.T @ np.linalg.inv(weighted @ weighted.T + damping * np.eye(len(axes)))
    result = np.zeros((columns.shape[1], 6))
    result[:, list(axes)] = (small * limits[:, None]) * rows
    return result


def fitted(first: Sequence[float], rest: Sequence[float], low: Sequence[float], high: Sequence[float]) -> list[float]:
    """The important forces, scaled down if they alone are too much, and as much of the rest as fits beside them (n each)."""
    a = _share(first, None, low, high)
    if a < 1.0:
        first = [a * f for f in first]
    b = _share(rest, first, low, high)
    return [f + b * r for f, r in zip(first, rest, strict=True)]


def _share(wanted: Sequence[float], base: Sequence[float] | None, low: Sequence[float], high: Sequence[float]) -> float:
    """The largest part s <= 1 of `wanted` for which base + s wanted keeps the limits."""
    share = 1.0
    for k, w in enumerate(wanted):
        b = 0.0 if base is None else base[k]
        if w > 0.0 and b + w > high[k]:
            share = min(share, max(0.0, (high[k] - b) / w))
        elif w < 0.0 and b + w < low[k]:
            share = min(share, max(0.0, (low[k] - b) / w))
    return share


class Curve:
    """A force table turned round: the least command that makes a force."""

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        """Of (u, N) points, ascending in both. Within the dead band the command is zero."""
        forward = [(f, u) for u, f in points if f > 0.0]
        astern = [(f, u) for u, f in points if f < 0.0]
        # The edges of the dead band: the last points without force on either side.
        edge = max((u for u, f in points if f == 0.0), default=0.0)
        back = min((u for u, f in points if f == 0.0), default=0.0)
        self._forward = [(0.0, edge), *forward]
        self._astern = [*astern, (0.0, back)]
        self._keys = [f for f, _ in self._forward]
        self._back_keys = [f for f, _ in self._astern]

    def command(self, force: float) -> float:
        """u for a force (N)."""
        if force == 0.0:
            return 0.0
        points, keys = (self._forward, self._keys) if force > 0.0 else (self._astern, self._back_keys)
        k = bisect_right(keys, force)
        if k == 0:
            return points[0][1]
        if k == len(points):
            return points[-1][1]
        (f0, u0), (f1, u1) = points[k - 1], points[k]
        return u0 + (u1 - u0) * (force - f0) / (f1 - f0)


def reaches(columns: FloatArray, low: FloatArray, high: FloatArray, into: FloatArray) -> Six:
    """The largest wrench on each axis alone, in the direction in which it is less; 0 out of reach."""
    values = []
    for axis in range(6):
        f = into[:, axis]
        if not f.any():
            values.append(0.0)
            continue
        scale = min(_largest(f, low, high), _largest(-f, low, high))
        values.append(scale * float(columns[axis] @ f))
    a, b, c, d, e, g = values
    return (a, b, c, d, e, g)


def _largest(direction: FloatArray, low: FloatArray, high: FloatArray) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(direction > 0.0, high / direction, np.where(direction < 0.0, low / direction, math.inf))
    return float(room.min())


class Thrusters:
    """Thrusters of one or several actuators. At these sizes plain floats are faster than numpy."""

    def __init__(self, groups: Sequence[tuple[Sequence[Thrust], bool]]) -> None:
        """Of each actuator its thrusters, and whether it is commanded by force rather than u."""
        thrusts = [thrust for group, _ in groups for thrust in group]
        columns = np.array([thrust.column for thrust in thrusts]).T.copy()
        low = np.array([thrust.curve[0][1] for thrust in thrusts])
        high = np.array([thrust.curve[-1][1] for thrust in thrusts])
        self.axes = controllable(columns)
        into = inverse(columns, np.minimum(-low, high), self.axes)
        self.reach = reaches(columns, low, high, into)
        self._low, self._high = low.tolist(), high.tolist()
        self._into = [tuple(row) for row in into.tolist()]
        self._columns = [tuple(row) for row in columns.tolist()]
        self._curves = [Curve(thrust.curve).command for thrust in thrusts]
        # (first, last, by force) of each actuator.
        self._slices: list[tuple[int, int, bool]] = []
        start = 0
        for group, by_force in groups:
            self._slices.append((start, start + len(group), by_force))
            start += len(group)

    def allocate(self, tau: Sequence[float], speed: float) -> tuple[list[Given], Six]:
        """See `Allocation`."""
        x, y, z, k, m, n = tau
        # Heave, roll, pitch and yaw, which keep their share, then surge and sway.
        first = [row[2] * z + row[3] * k + row[4] * m + row[5] * n for row in self._into]
        rest = [row[0] * x + row[1] * y for row in self._into]
        forces = fitted(first, rest, self._low, self._high)
        a, b, c, d, e, f = [sum(map(mul, row, forces)) for row in self._columns]
        given: list[Given] = []
        for begin, end, by_force in self._slices:
            part = forces[begin:end]
            if not by_force:
                part = [curve(force) for curve, force in zip(self._curves[begin:end], part, strict=True)]
            given.append((tuple(part),))
        return given, (a, b, c, d, e, f)


class Wrench:
    """A vehicle that is driven by a wrench."""

    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def __init__(self, limits: Six) -> None:
        """Within these limits of each axis, N and N m."""
        self.reach = limits

    def allocate(self, tau: Sequence[float], speed: float) -> tuple[list[Given], Six]:
        """See `Allocation`."""
        a, b, c, d, e, f = (min(max(t, -limit), limit) for t, limit in zip(tau, self.reach, strict=True))
        return [((a, b, c), (d, e, f))], (a, b, c, d, e, f)
