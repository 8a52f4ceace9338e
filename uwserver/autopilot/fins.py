"""Fins and a propeller as a wrench: fins whose effect grows with the square of the speed, and a shaft whose thrust falls with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from uwserver.autopilot.allocation import FINS, PITCH, ROLL, YAW, controllable, inverse, no_curves, share
from uwserver.autopilot.rows import DEVICE, FIN, SHAFT_SPEED
from uwserver.autopilot.state import Six
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, separate

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

    def fill(self, row: Any) -> None:
        """Write it into a SHAFT."""
        for field in fields(self):
            row[field.name] = getattr(self, field.name)


def shaft_thrust(shaft: Shaft, speed_radps: float, u: float) -> float:
    """Thrust (N) at a shaft speed (rad/s) and a speed through the water (m/s)."""
    n = speed_radps / (2.0 * math.pi)
    if n < 0.0:
        return -shaft.astern * shaft.strength * shaft.a * n * n
    return shaft.strength * (shaft.a * n * n - shaft.b * n * shaft.advance * max(u, 0.0) / shaft.diameter)


def shaft_speed(shaft: Shaft, thrust: float, u: float) -> float:
    """The least shaft speed (rad/s) that makes a thrust (N), within the limit."""
    n = 0.0
    if thrust < 0.0:
        n = -math.sqrt(-thrust / (shaft.astern * shaft.strength * shaft.a))
    elif thrust > 0.0:
        half = 0.5 * shaft.b * shaft.advance * max(u, 0.0) / shaft.diameter
        n = (half + math.sqrt(half * half + shaft.a * thrust / shaft.strength)) / shaft.a
    return min(max(2.0 * math.pi * n, -shaft.limit), shaft.limit)


thrust_at, speed_for = compiled(shaft_thrust), compiled(shaft_speed)
"""The same for compiled code, of a SHAFT."""


class FinsAndShaft:
    """The actuators of a torpedo. Its `reach` is that at rest ahead, and at 1 m/s of its fins.

    Attributes:
        axes, reach, devices, curves: as of `allocation.Allocation`; the shafts are the last devices.
        shaft: stands for all of them together, which turn alike.
    """

    means = FINS

    def __init__(self, fins: Sequence[FinEffect], shaft: Shaft, shafts: int = 1) -> None:
        self.shaft = shaft
        columns = np.array([fin.column for fin in fins]).T.copy()
        moments = columns.copy()
        moments[:3] = 0.0
        limits = np.array([fin.limit for fin in fins])
        turning = controllable(moments)
        self.axes: tuple[int, ...] = (0, *turning)
        strongest = [float(np.abs(columns[axis]) @ limits) if axis in turning else 0.0 for axis in range(6)]
        self.reach: Six = (
            shaft_thrust(shaft, shaft.limit, 0.0), 0.0, 0.0, strongest[ROLL], strongest[PITCH], strongest[YAW],
        )  # fmt: skip
        self.devices: Any = np.zeros(len(fins) + shafts, DEVICE)
        self.devices["kind"] = [FIN] * len(fins) + [SHAFT_SPEED] * shafts
        rows = self.devices[: len(fins)]
        rows["into"], rows["column"] = inverse(moments, limits, turning), columns.T
        rows["low"], rows["high"] = -limits, limits
        self.curves = no_curves()


@separate
def allocate_fins(c: Any, devices: Array, tau: Six, speed: float) -> Six:
    """Put the commands into `force` of the devices; returns the wrench that they will make. Pitch and roll keep their share before yaw: a torpedo
    that loses its depth is worse off than one off its line.

    Args:
        c: CRAFT.
        devices: DEVICE rows, first the fins, then the shafts.
        tau: demanded (6), N and N m in B; what is demanded of axes out of reach is ignored.
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
