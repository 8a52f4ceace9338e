"""Thrust and torque of a propeller from its open-water curves (compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


@compiled
def _curve(J: float, points: int, xs: Array, ys: Array) -> tuple[float, float]:
    """(a, b) of the straight piece y = a + b J of a curve; the first and last piece go on beyond the ends."""
    k = 0
    while k < points - 2 and xs[k + 1] < J:
        k += 1
    b = (ys[k + 1] - ys[k]) / (xs[k + 1] - xs[k])
    return ys[k] - b * xs[k], b


@compiled
def propeller_force(propeller: Any, speed: float, advance: float) -> tuple[float, float]:
    """Thrust on the vehicle (N) along the axis, and moment (N m) about it.

    T = rho n^2 D^4 K_T(J), Q = rho n^2 D^5 K_Q(J), J = V_a / (n D), with each straight piece K = a + b J written as
    a |n| n + b |n| V_a / D: finite at any n and zero at n = 0 (a stopped propeller has no drag here). Astern the propeller is taken as the
    mirror of itself: J counts along the turned axis, thrust and torque are scaled by `astern`. Beyond the table the first and last piece
    go on straight: an extrapolation, in particular against the inflow (J < 0), where measured curves bend.

    Args:
        propeller: PROPELLER record.
        speed: of the shaft, rad/s; positive drives along the axis.
        advance: of the vehicle through the water along the axis, m/s.
    """
    n = abs(speed) / (2.0 * math.pi)
    if n == 0.0:
        return 0.0, 0.0
    direction = 1.0 if speed > 0.0 else -propeller.astern
    va = propeller.wake * (advance if speed > 0.0 else -advance)
    D = propeller.diameter
    J = va / (n * D)
    a, b = _curve(J, propeller.points, propeller.J, propeller.KT)
    thrust = propeller.density * D**4 * (a * n * n + b * n * va / D)
    a, b = _curve(J, propeller.points, propeller.J, propeller.KQ)
    torque = propeller.density * D**5 * (a * n * n + b * n * va / D)
    return direction * propeller.deduction * thrust, direction * propeller.sense * torque
