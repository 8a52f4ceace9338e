"""Which command each actuator gets so that together they make a wrench: pseudo-inverse, limits, and inverted thrust curves.

When the actuators cannot give everything, heave and moments keep their share before surge and sway: a vehicle that turns over or sinks loses more
than one that is slow.

Closed forms: f = W^-1 B^T (B W^-1 B^T + lambda I)^-1 tau is the least sum of (f_i / limit_i)^2 among all forces that make tau (Fossen 2011,
section 12.3.2), with a small damping lambda against axes that are almost out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from uwserver.autopilot.rows import DEVICE, THRUSTER, WRENCH
from uwserver.autopilot.state import Six
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, separate

SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)
IMPORTANCE = (HEAVE, YAW, SURGE, SWAY, ROLL, PITCH)
"""Which axes are controlled where there are not enough actuators for all."""
DAMPING = 1e-3
"""Square root of lambda over the largest singular value."""
_OUT_OF_REACH = 0.05
"""An axis is out of reach whose wrench, in the best case, leaves this part of it to the axes that are controlled already."""

Given = tuple[tuple[float, ...] | None, ...]
THRUSTERS, FINS, WRENCHES = range(3)


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
    """The actuators of a vehicle, seen as a wrench.

    Attributes:
        means: THRUSTERS, FINS or WRENCHES: which compiled function shares a wrench out among them.
        axes: that can be controlled.
        reach: largest wrench of each axis, N and N m.
        devices: DEVICE rows of the components of the commands of the held actuators, in their order.
        curves: (n, 2) of `command_for`, of all of them.
    """

    means: int
    axes: tuple[int, ...]
    reach: Six
    devices: Any
    curves: FloatArray


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


@compiled
def share(devices: Array) -> None:
    """The important forces (`first`), scaled down if they alone are too much, and as much of the others (`rest`) as fits beside them, as `force`."""
    a, b = 1.0, 1.0
    for d in devices:
        a = _fitting(d.first, 0.0, d.low, d.high, a)
    for d in devices:
        b = _fitting(d.rest, a * d.first, d.low, d.high, b)
    for d in devices:
        d.force = a * d.first + b * d.rest


@compiled
def _fitting(wanted: float, base: float, low: float, high: float, part: float) -> float:
    """The largest part s <= `part` of a force for which base + s wanted keeps the limits."""
    if wanted > 0.0 and base + wanted > high:
        return min(part, max(0.0, (high - base) / wanted))
    if wanted < 0.0 and base + wanted < low:
        return min(part, max(0.0, (low - base) / wanted))
    return part


def curve_points(points: Sequence[tuple[float, float]]) -> tuple[FloatArray, int, int]:
    """A force table turned round, for `command_for`: (n, 2) points (N, u), and how many of them are astern and ahead.

    Args:
        points: (u, N), ascending in both.
    """
    forward = [(f, u) for u, f in points if f > 0.0]
    astern = [(f, u) for u, f in points if f < 0.0]
    # The edges of the dead band: the last points without force on either side.
    edge = max((u for u, f in points if f == 0.0), default=0.0)
    back = min((u for u, f in points if f == 0.0), default=0.0)
    return np.array([*astern, (0.0, back), (0.0, edge), *forward]), len(astern) + 1, len(forward) + 1


def no_curves() -> FloatArray:
    """Of devices that have none."""
    return np.zeros((0, 2))


@compiled
def command_for(curves: Array, first: int, astern: int, ahead: int, force: float) -> float:
    """The least command u that makes a force (N); within the dead band it is zero."""
    if force == 0.0:
        return 0.0
    last = first + astern - 1
    if force > 0.0:
        first, last = first + astern, first + astern + ahead - 1
    k = first
    while k <= last and curves[k, 0] <= force:
        k += 1
    if k == first:
        return float(curves[first, 1])
    if k > last:
        return float(curves[last, 1])
    f0, u0, f1, u1 = curves[k - 1, 0], curves[k - 1, 1], curves[k, 0], curves[k, 1]
    return float(u0 + (u1 - u0) * (force - f0) / (f1 - f0))


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
    """Thrusters of one or several actuators."""

    means = THRUSTERS

    def __init__(self, groups: Sequence[tuple[Sequence[Thrust], bool]]) -> None:
        """Of each actuator its thrusters, and whether it is commanded by force rather than u."""
        thrusts = [thrust for group, _ in groups for thrust in group]
        columns = np.array([thrust.column for thrust in thrusts]).T.copy()
        low = np.array([thrust.curve[0][1] for thrust in thrusts])
        high = np.array([thrust.curve[-1][1] for thrust in thrusts])
        self.axes = controllable(columns)
        into = inverse(columns, np.minimum(-low, high), self.axes)
        self.reach = reaches(columns, low, high, into)
        self.devices: Any = np.zeros(len(thrusts), DEVICE)
        self.devices["kind"], self.devices["into"], self.devices["column"] = THRUSTER, into, columns.T
        self.devices["low"], self.devices["high"] = low, high
        self.devices["by_force"] = [by_force for group, by_force in groups for _ in group]
        tables, first = [], 0
        for row, thrust in zip(self.devices, thrusts, strict=True):
            points, row["astern"], row["ahead"] = curve_points(thrust.curve)
            row["curve_first"] = first
            tables.append(points)
            first += len(points)
        self.curves = np.concatenate(tables)


@separate
def allocate_thrusters(devices: Array, tau: Six) -> Six:
    """Put forces (N) into the devices; returns the wrench that they will make. What is demanded of axes out of reach is ignored."""
    x, y, z, k, m, n = tau
    # Heave, roll, pitch and yaw, which keep their share, then surge and sway.
    for d in devices:
        i = d.into
        d.first, d.rest = i[2] * z + i[3] * k + i[4] * m + i[5] * n, i[0] * x + i[1] * y
    share(devices)
    fx = fy = fz = tx = ty = tz = 0.0
    for d in devices:
        u, f = d.column, d.force
        fx, fy, fz = fx + u[0] * f, fy + u[1] * f, fz + u[2] * f
        tx, ty, tz = tx + u[3] * f, ty + u[4] * f, tz + u[5] * f
    return fx, fy, fz, tx, ty, tz


class Wrench:
    """A vehicle that is driven by a wrench."""

    means = WRENCHES
    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def __init__(self, limits: Six) -> None:
        """Within these limits of each axis, N and N m."""
        self.reach = limits
        self.devices: Any = np.zeros(6, DEVICE)
        self.devices["kind"], self.devices["component"] = WRENCH, range(6)
        self.devices["high"], self.devices["low"] = limits, [-limit for limit in limits]
        self.curves = no_curves()


@compiled
def allocate_wrench(devices: Array, tau: Six) -> Six:
    """Put the components into the devices, cut axis by axis; returns them."""
    for k in range(6):
        d = devices[k]
        d.force = min(max(tau[k], d.low), d.high)
    return (
        devices[0].force, devices[1].force, devices[2].force, devices[3].force, devices[4].force, devices[5].force,
    )  # fmt: skip
