"""Lift and drag of a foil at any angle of attack: linear lift, stall, flat plate (compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.kernel.compiled import compiled


@compiled
def foil_coefficients(foil: Any, alpha: float) -> tuple[float, float]:
    """C_L and C_D of a FOIL row at an angle of attack of -pi..pi (rad).

    Up to `stall` C_L = slope alpha and C_D = cd0 + induced C_L^2 (lifting line); from `stall_end` on the plate's normal force cd90 sin(alpha),
    whose parts are C_L = cd90 sin(alpha) cos(alpha) and C_D = cd0 + cd90 sin(alpha)^2; between them a linear blend.
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
    """Force (N) along the chord of zero angle and along the normal to it.

    Args:
        foil: FOIL record.
        angle: by which it is turned, rad; positive lifts towards the normal.
        ahead, across: velocity through the water along chord and normal, m/s.
        square: of the speed that makes the dynamic pressure, m2/s2.
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
    # Drag against the velocity, lift square to it.
    x, z = ahead / speed, across / speed
    return pressure * (-drag * x - lift * z), pressure * (lift * x - drag * z)
