"""Allocation for fins and a propeller. The effect of fins grows with the square of the speed, and the thrust of a propeller decreases with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uwserver.autopilot.allocation import FINS, NO_CURVES, PITCH, ROLL, YAW, Allocation, controllable, inverse, share
from uwserver.autopilot.rows import DEVICE, FIN, SHAFT_SPEED
from uwserver.autopilot.state import Six
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, separate

SLOW_MPS = 0.3
"""Below this speed the effect of fins is taken to be that at this speed."""


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
