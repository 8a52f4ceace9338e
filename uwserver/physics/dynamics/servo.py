"""What moves a fin, a shaft, a piston or a sliding mass: first order towards its command, at a limited rate (compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.kernel.compiled import compiled


@compiled
def advance_servo(servo: Any, h: float) -> float:
    """Carry a SERVO row over h seconds, exactly, as the command is constant in a tick. Returns its value.

    value' = (command - value) / tau within +-rate: a straight line until the error is rate tau, an exponential from there on.
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
