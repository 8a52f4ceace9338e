"""Forces of single appendages: the lift and drag of a foil, the thrust and torque of a propeller, and the motion of the servo that sets them
(compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


@compiled
def advance_servo(servo: Any, h: float) -> float:
    """Advance a SERVO row by h seconds, exactly, as the command is constant in a tick. Return its value.

    The servo follows its command with a first-order lag at a limited rate: value' = (command - value) / tau within +-rate. This is a straight line
    until the error is rate tau, and an exponential from there on.
    """
    target = min(max(servo.command, servo.low), servo.high)
    error = target - servo.value
    size = abs(error)
    bend = servo.rate * servo.tau if servo.tau > 0.0 else 0.0
    if size > bend:
        way = servo.rate * h
        if size - way >= bend:
            servo.value += math.copysign(way, error)
            return float(servo.value)
        h -= (size - bend) / servo.rate
        size = bend
    size *= math.exp(-h / servo.tau) if servo.tau > 0.0 else 0.0
    servo.value = target - math.copysign(size, error)
    return float(servo.value)


@compiled
def foil_coefficients(foil: Any, alpha: float) -> tuple[float, float]:
    """Return C_L and C_D of a FOIL row at an angle of attack of -pi..pi (rad): linear lift, stall, flat plate.

    Up to `stall`, C_L = slope alpha and C_D = cd0 + induced C_L^2 (lifting line). From `stall_end` on, the plate's normal force is cd90 sin(alpha),
    with the parts C_L = cd90 sin(alpha) cos(alpha) and C_D = cd0 + cd90 sin(alpha)^2. Between the two is a linear blend.
    """
    attached = 1.0
    size = abs(alpha)
    if size > foil.stall:
        attached = max(0.0, (foil.stall_end - size) / (foil.stall_end - foil.stall))
    lift = foil.slope * alpha
    sine = math.sin(alpha)
    separated = (1.0 - attached) * foil.cd90 * sine
    return (
        attached * lift + separated * math.cos(alpha),
        foil.cd0 + attached * foil.induced * lift * lift + separated * sine,
    )


@compiled
def foil_force(foil: Any, angle: float, ahead: float, across: float, square: float) -> tuple[float, float]:
    """Return the force (N) along the chord at zero angle, and along the normal of that chord.

    Args:
        foil: FOIL record.
        angle: by which the foil is turned, rad; a positive angle lifts towards the normal.
        ahead, across: velocity through the water along chord and normal, m/s.
        square: squared speed of the dynamic pressure, m2/s2.
    """
    speed = math.sqrt(ahead * ahead + across * across)
    if speed == 0.0:
        return 0.0, 0.0
    alpha = angle - math.atan2(across, ahead)
    if alpha > math.pi:
        alpha -= 2.0 * math.pi
    elif alpha < -math.pi:
        alpha += 2.0 * math.pi
    lift, drag = foil_coefficients(foil, alpha)
    pressure = foil.pressure_area * square
    # Drag acts against the velocity, lift perpendicular to it.
    x, z = ahead / speed, across / speed
    return pressure * (-drag * x - lift * z), pressure * (lift * x - drag * z)


@compiled
def propeller_force(propeller: Any, speed: float, advance: float) -> tuple[float, float]:
    """Return the thrust on the vehicle (N) along the axis, and the moment on it (N m) about the axis.

    Args:
        propeller: PROPELLER record.
        speed: speed of the shaft, rad/s; positive drives along the axis.
        advance: advance of the vehicle through the water along the axis, m/s.
    """
    va = propeller.wake * advance
    if propeller.harmonics > 0:
        thrust, torque = _by_series(propeller, speed, va)
    else:
        thrust, torque = _by_curves(propeller, speed, va)
    return propeller.deduction * thrust, propeller.sense * torque


@compiled
def _by_series(propeller: Any, speed: float, va: float) -> tuple[float, float]:
    """Return thrust and torque at a shaft speed (rad/s) and a speed of advance (m/s) of any sign.

    T = rho/2 (V_a^2 + V_t^2) pi/4 D^2 C_T*(beta), Q likewise with D^3 and C_Q*, where V_t = 0.7 pi n D is the speed of the blade at 0.7 of
    its radius and tan(beta) = V_a / V_t (van Lammeren, van Manen and Oosterveld, "The Wageningen B-screw series", SNAME 77, 1969). Nothing
    is divided by n, so a stopped propeller (beta = +-90 degrees) has its drag. The part of it that the hull's damping contains is subtracted.
    """
    D, series, stopped = propeller.diameter, propeller.series, propeller.stopped
    vt = 0.35 * speed * D
    square = va * va + vt * vt
    if square == 0.0:
        return 0.0, 0.0
    c, s = vt / math.sqrt(square), va / math.sqrt(square)
    ct, cq, ck, sk = 0.0, 0.0, 1.0, 0.0  # cosine and sine of k beta
    for k in range(propeller.harmonics):
        ct += series[k, 0] * ck + series[k, 1] * sk
        cq += series[k, 2] * ck + series[k, 3] * sk
        ck, sk = ck * c - sk * s, sk * c + ck * s
    astern = 2 if va < 0.0 else 0
    ct -= stopped[astern] * s * s
    cq -= stopped[astern + 1] * s * s
    scale = 0.125 * math.pi * propeller.density * square * D * D
    return scale * ct, scale * D * cq


@compiled
def _by_curves(propeller: Any, speed: float, va: float) -> tuple[float, float]:
    """Return thrust and torque by open-water curves of the first quadrant.

    T = rho n^2 D^4 K_T(J), Q = rho n^2 D^5 K_Q(J), J = V_a / (n D), with each straight piece K = a + b J written as
    a |n| n + b |n| V_a / D: finite at any n and zero at n = 0 (a stopped propeller has no drag here). Astern the propeller is taken as the
    mirror of itself: J counts along the turned axis, thrust and torque are scaled by `astern`. Beyond the table the first and last piece
    are extended: an extrapolation, in particular against the inflow (J < 0), where measured curves bend.
    """
    n = abs(speed) / (2.0 * math.pi)
    if n == 0.0:
        return 0.0, 0.0
    direction = 1.0 if speed > 0.0 else -propeller.astern
    if speed < 0.0:
        va = -va
    D = propeller.diameter
    J = va / (n * D)
    a, b = _piece(J, propeller.points, propeller.J, propeller.KT)
    thrust = propeller.density * D**4 * (a * n * n + b * n * va / D)
    a, b = _piece(J, propeller.points, propeller.J, propeller.KQ)
    torque = propeller.density * D**5 * (a * n * n + b * n * va / D)
    return direction * thrust, direction * torque


@compiled
def _piece(J: float, points: int, xs: Array, ys: Array) -> tuple[float, float]:
    """Return (a, b) of the straight piece y = a + b J of a curve. The first and last piece are extended beyond the ends."""
    k = 0
    while k < points - 2 and xs[k + 1] < J:
        k += 1
    b = (ys[k + 1] - ys[k]) / (xs[k + 1] - xs[k])
    return ys[k] - b * xs[k], b
