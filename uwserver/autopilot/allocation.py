"""Control allocation: which command each actuator gets so that together they make a wrench. Pseudo-inverse, limits, and inverted thrust curves.

If the actuators cannot make the whole wrench, heave and the moments come before surge and sway: to turn over or to sink is worse than to be slow.

Closed form: f = W^-1 B^T (B W^-1 B^T + lambda I)^-1 tau has the least sum of (f_i / limit_i)^2 among all forces that make tau (Fossen 2011,
section 12.3.2). The small damping lambda keeps forces small on axes that are almost out of reach.

The effect of fins grows with the square of the speed, and the thrust of a propeller decreases with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uwserver.autopilot.rows import DEVICE, FIN, SHAFT_SPEED, THRUSTER, WRENCH
from uwserver.autopilot.state import Six
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, separate

SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)
IMPORTANCE = (HEAVE, YAW, SURGE, SWAY, ROLL, PITCH)
"""The axes by importance: if there are not enough actuators for all axes, the first ones are controlled."""
DAMPING = 1e-3
"""Square root of lambda, over the largest singular value."""
_OUT_OF_REACH = 0.05
"""An axis is out of reach if less than this part of its wrench is independent of the axes that are controlled already."""

THRUSTERS, FINS, WRENCHES = range(3)
NO_CURVES = np.zeros((0, 2))
"""The curves of devices that have none."""
SLOW_MPS = 0.3
"""Below this speed the effect of fins is taken to be that at this speed."""


@dataclass(frozen=True)
class Thrust:
    """One thruster as its maker describes it.

    Attributes:
        column: (6) wrench about the origin in B per newton.
        curve: (u, N), ascending in both; installed, at the voltage of the supply.
    """

    column: Six
    curve: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Allocation:
    """The actuators of a vehicle, and the wrench that they can make.

    Attributes:
        means: THRUSTERS, FINS or WRENCHES: the kind of the actuators, for which there is a compiled function each.
        axes: the axes that can be controlled.
        reach: largest wrench of each axis, N and N m.
        devices: a DEVICE for each component of the commands of the actuators, in their order.
        curves: (n, 2) points of the curves of all devices, for `command_for`.
    """

    means: int
    axes: tuple[int, ...]
    reach: Six
    devices: Any
    curves: FloatArray


def controllable(columns: FloatArray) -> tuple[int, ...]:
    """Return the axes that can be commanded independently, ascending. The more important axes are preferred. `columns` is (6, n): the wrench of each
    actuator at unit strength."""
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
    """Return the matrix (n, 6) from a wrench to the actuators. Its columns are zero for axes that are not in `axes`.

    Args:
        columns: (6, n) wrench of each actuator per unit.
        limits: (n) limits of the actuators, which weight them.
        axes: the axes that are made exactly, apart from the damping.
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
    """Set `force` of all devices within their limits: the important forces (`first`), which are scaled down only if they alone exceed a limit, and
    as much of the others (`rest`) as the limits leave. Each of the two is scaled by one factor for all devices, which keeps its direction."""
    a, b = 1.0, 1.0
    for d in devices:
        a = _fitting(d.first, 0.0, d.low, d.high, a)
    for d in devices:
        b = _fitting(d.rest, a * d.first, d.low, d.high, b)
    for d in devices:
        d.force = a * d.first + b * d.rest


@compiled
def _fitting(wanted: float, base: float, low: float, high: float, part: float) -> float:
    """Return the largest s <= `part` for which base + s wanted is within the limits."""
    if wanted > 0.0 and base + wanted > high:
        return min(part, max(0.0, (high - base) / wanted))
    if wanted < 0.0 and base + wanted < low:
        return min(part, max(0.0, (low - base) / wanted))
    return part


def curve_points(points: Sequence[tuple[float, float]]) -> tuple[FloatArray, int, int]:
    """Invert a force table for `command_for`. Returns (n, 2) points (N, u), and how many of them are astern and ahead.

    Args:
        points: (u, N), ascending in both.
    """
    forward = [(f, u) for u, f in points if f > 0.0]
    astern = [(f, u) for u, f in points if f < 0.0]
    # The edges of the dead band: the last points without force on either side.
    edge = max((u for u, f in points if f == 0.0), default=0.0)
    back = min((u for u, f in points if f == 0.0), default=0.0)
    return np.array([*astern, (0.0, back), (0.0, edge), *forward]), len(astern) + 1, len(forward) + 1


@compiled
def command_for(curves: Array, first: int, astern: int, ahead: int, force: float) -> float:
    """Return the least command u that makes a force (N); 0 for no force."""
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
    """Return the largest wrench on each axis alone, in its weaker direction; 0 for an axis that is out of reach."""
    values = [0.0] * 6
    for axis, f in enumerate(into.T):
        if f.any():
            values[axis] = min(_largest(f, low, high), _largest(-f, low, high)) * float(columns[axis] @ f)
    a, b, c, d, e, g = values
    return (a, b, c, d, e, g)


def _largest(direction: FloatArray, low: FloatArray, high: FloatArray) -> float:
    """Return the largest factor of a direction that keeps all limits."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(direction > 0.0, high / direction, np.where(direction < 0.0, low / direction, math.inf))
    return float(room.min())


def thruster_allocation(groups: Sequence[tuple[Sequence[Thrust], bool]]) -> Allocation:
    """Return the allocation of one or several actuators. `groups` gives the thrusters of each, and whether it is commanded by force instead of u."""
    thrusts = [thrust for group, _ in groups for thrust in group]
    columns = np.array([thrust.column for thrust in thrusts]).T.copy()
    low = np.array([thrust.curve[0][1] for thrust in thrusts])
    high = np.array([thrust.curve[-1][1] for thrust in thrusts])
    axes = controllable(columns)
    into = inverse(columns, np.minimum(-low, high), axes)
    devices: Any = np.zeros(len(thrusts), DEVICE)
    devices["kind"], devices["into"], devices["column"] = THRUSTER, into, columns.T
    devices["low"], devices["high"] = low, high
    devices["by_force"] = [by_force for group, by_force in groups for _ in group]
    tables, first = [], 0
    for row, thrust in zip(devices, thrusts, strict=True):
        points, row["astern"], row["ahead"] = curve_points(thrust.curve)
        row["curve_first"] = first
        tables.append(points)
        first += len(points)
    return Allocation(THRUSTERS, axes, reaches(columns, low, high, into), devices, np.concatenate(tables))


@separate
def allocate_thrusters(devices: Array, tau: Six) -> Six:
    """Set the forces (N) of the devices for a wrench. Returns the wrench that they will make. Axes that are out of reach are ignored."""
    x, y, z, k, m, n = tau
    # `first`: heave, roll, pitch and yaw; `rest`: surge and sway.
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


def wrench_allocation(limits: Six) -> Allocation:
    """Return the allocation of a vehicle that is driven by a wrench. `limits` are those of each axis, N and N m."""
    devices: Any = np.zeros(6, DEVICE)
    devices["kind"], devices["component"] = WRENCH, range(6)
    devices["high"], devices["low"] = limits, [-limit for limit in limits]
    return Allocation(WRENCHES, (0, 1, 2, 3, 4, 5), limits, devices, NO_CURVES)


@compiled
def allocate_wrench(devices: Array, tau: Six) -> Six:
    """Set the forces of the devices for a wrench, each limited by itself. Returns the wrench that they make."""
    for k in range(6):
        d = devices[k]
        d.force = min(max(tau[k], d.low), d.high)
    return (
        devices[0].force, devices[1].force, devices[2].force, devices[3].force, devices[4].force, devices[5].force,
    )  # fmt: skip


@dataclass(frozen=True)
class FinEffect:
    """One fin: wrench about the origin in B per rad at 1 m/s, and its largest angle, rad."""

    column: Six
    limit: float


@dataclass(frozen=True)
class Shaft:
    """A propeller: T = rho D^4 n^2 (a - b J), J = U / (n D), with n in revolutions per second. The fields are those of `rows.SHAFT`, in its order.

    Attributes:
        a, b: the thrust coefficient as a line over J.
        strength: rho D^4, thrust deduction included.
        advance: 1 - wake fraction.
        diameter: m.
        astern: thrust astern over thrust ahead.
        limit: largest speed of the shaft, rad/s.
    """

    a: float
    b: float
    strength: float
    advance: float
    diameter: float
    astern: float
    limit: float


def shaft_thrust(shaft: Shaft, speed_radps: float, u: float) -> float:
    """Return the thrust (N) at a shaft speed (rad/s) and a speed through the water (m/s)."""
    n = speed_radps / (2.0 * math.pi)
    if n < 0.0:
        return -shaft.astern * shaft.strength * shaft.a * n * n
    return shaft.strength * (shaft.a * n * n - shaft.b * n * shaft.advance * max(u, 0.0) / shaft.diameter)


def shaft_speed(shaft: Shaft, thrust: float, u: float) -> float:
    """Return the least shaft speed (rad/s) that makes a thrust (N) at a speed through the water (m/s), within the limit."""
    n = 0.0
    if thrust < 0.0:
        n = -math.sqrt(-thrust / (shaft.astern * shaft.strength * shaft.a))
    elif thrust > 0.0:
        half = 0.5 * shaft.b * shaft.advance * max(u, 0.0) / shaft.diameter
        n = (half + math.sqrt(half * half + shaft.a * thrust / shaft.strength)) / shaft.a
    return min(max(2.0 * math.pi * n, -shaft.limit), shaft.limit)


thrust_at, speed_for = compiled(shaft_thrust), compiled(shaft_speed)
"""The same for compiled code, for a SHAFT."""


def fin_allocation(fins: Sequence[FinEffect], shaft: Shaft, shafts: int = 1) -> Allocation:
    """Return the allocation of a torpedo. Its last devices are the shafts. Its `reach` is that of the propeller at rest, and of the fins at 1 m/s.

    Args:
        fins: in the order of the devices.
        shaft: has the strength of all shafts together, which turn at the same speed.
        shafts: number of shafts.
    """
    columns = np.array([fin.column for fin in fins]).T.copy()
    moments = columns.copy()
    moments[:3] = 0.0
    limits = np.array([fin.limit for fin in fins])
    turning = controllable(moments)
    strongest = [float(np.abs(columns[axis]) @ limits) if axis in turning else 0.0 for axis in range(6)]
    thrust = shaft_thrust(shaft, shaft.limit, 0.0)
    devices: Any = np.zeros(len(fins) + shafts, DEVICE)
    devices["kind"] = [FIN] * len(fins) + [SHAFT_SPEED] * shafts
    rows = devices[: len(fins)]
    rows["into"], rows["column"] = inverse(moments, limits, turning), columns.T
    rows["low"], rows["high"] = -limits, limits
    reach = (thrust, 0.0, 0.0, strongest[ROLL], strongest[PITCH], strongest[YAW])
    return Allocation(FINS, (0, *turning), reach, devices, NO_CURVES)


@separate
def allocate_fins(c: Any, devices: Array, tau: Six, speed: float) -> Six:
    """Set `force` of the devices for a wrench. Returns the wrench that they will make.

    Pitch and roll come before yaw: for a torpedo it is worse to lose its depth than to leave its line.

    Args:
        c: SPEC.
        devices: DEVICE rows, first of the fins, then of the shafts.
        tau: demanded (6), N and N m in B; axes that are out of reach are ignored.
        speed: surge through the water, m/s.
    """
    pressure = max(speed, SLOW_MPS) ** 2
    roll, pitch, yaw = tau[3] / pressure, tau[4] / pressure, tau[5] / pressure
    for d in devices:
        d.first, d.rest = d.into[3] * roll + d.into[4] * pitch, d.into[5] * yaw
    share(devices)
    shaft = speed_for(c.shaft, tau[0], speed)
    k = m = n = 0.0
    for d in devices:
        if d.kind == SHAFT_SPEED:
            d.force = shaft
            continue
        k += d.column[3] * d.force
        m += d.column[4] * d.force
        n += d.column[5] * d.force
    return thrust_at(c.shaft, shaft, speed), 0.0, 0.0, pressure * k, pressure * m, pressure * n
