"""Depth and slope of the bottom under a vehicle, estimated from the echoes of altimeter and DVL.

Compiled code. The slope is kept in N, so that it stays known when the vehicle turns.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.autopilot.rows import four, rotate
from uwserver.physics.kernel.deferred import compiled
from uwserver.units import NANOSECONDS

BOTTOM_S = 0.5
"""Time constant of the depth of the bottom, s; the gain of the slope follows from it (Benedict and Bordner 1962)."""
CREEP_MPS, STEEPEST = 0.1, 3.0
"""Speed below which the slope is not learnt; largest slope that is accepted."""
LEAP_M, LEAP, FEW = 0.5, 0.1, 3
"""An echo is rejected if it is off by more than LEAP_M plus the part LEAP of its range, unless FEW have been rejected in a row."""


@compiled
def correct_bottom(e: Any, sensor: Any, reach: float, t_ns: int, late: float) -> None:
    """Correct the depth and the slope of the bottom by the echo of a beam.

    Args:
        e: ESTIMATE of the vehicle.
        sensor: its SENSOR. The z axis of the sensor points along the beam.
        reach: range along the beam, m; nan without an echo.
        t_ns: time of the echo.
        late: age of the echo, s.
    """
    if not 0.0 <= reach < 1e9:
        return
    x, y, z = rotate(four(sensor.q), (0.0, 0.0, reach))
    ahead, aside, below = rotate(four(e.q), (x + sensor.p[0], y + sensor.p[1], z + sensor.p[2]))
    bottom = e.p[2] - e.v[2] * late + below
    dt = (t_ns - e.altitude_ns) / NANOSECONDS
    # The echo does not come from under the vehicle: the beam may be tilted, and the vehicle has moved since.
    north, east = ahead - e.v[0] * late, aside - e.v[1] * late
    off = bottom - e.bottom - e.grade[0] * north - e.grade[1] * east
    is_strange = abs(off) > LEAP_M + LEAP * reach
    if e.bottom != e.bottom or dt > 5.0 or (is_strange and e.strange >= FEW):
        e.bottom, e.grade[0], e.grade[1] = bottom, 0.0, 0.0
    elif is_strange:
        e.strange += 1
        return
    elif dt > 0.0:
        share = dt / (BOTTOM_S + dt)
        e.bottom += share * off
        speed = math.hypot(e.v[0], e.v[1])
        if speed > CREEP_MPS:
            k = share * share / (2.0 - share) * off / (dt * speed * speed)
            x = max(-STEEPEST, min(STEEPEST, e.grade[0] + k * e.v[0]))
            y = max(-STEEPEST, min(STEEPEST, e.grade[1] + k * e.v[1]))
            # The plane of the bottom is turned about the place of the echo. If it turned about the vehicle, it would oscillate with a beam that
            # points back.
            e.bottom -= (x - e.grade[0]) * north + (y - e.grade[1]) * east
            e.grade[0], e.grade[1] = x, y
    e.strange = 0
    e.altitude_ns = max(e.altitude_ns, t_ns)


@compiled
def fall(e: Any) -> float:
    """Return the rate at which the bottom under the vehicle gets deeper, m/s."""
    return float(e.grade[0] * e.v[0] + e.grade[1] * e.v[1])
