"""Solves for the angle of a ray that covers a given distance, between two angles with vertices in the same layers.

A ray that passes i times through A, d times through D and j times through B (see `search`) is identified by its grazing angle theta at the fastest
depth between its ends.
"""

from __future__ import annotations

import math

from uwserver.environment.acoustics.layers import Medium, advance_slope
from uwserver.physics.kernel.deferred import compiled

_ASIDE = 1e-9
"""Relative distance to an angle at which a ray just turns at a node."""
_EXACT_M = 1e-7
"""Error of the distance at which the search ends."""


@compiled
def reach(m: Medium, theta: float, i: int, d: int, j: int) -> tuple[float, float]:
    """Return the horizontal distance of a ray that passes so often through A, D and B, m, and its derivative with theta."""
    sine = math.sin(theta)
    q, p = sine * sine, math.cos(theta) / m.fastest
    x, slope = advance_slope(m, p, q, m.upper, m.lower)
    x, slope = d * x, d * slope
    if i:
        way, more = advance_slope(m, p, q, m.upper, 0)
        x, slope = x + i * way, slope + i * more
    if j:
        way, more = advance_slope(m, p, q, m.lower, len(m.c) - 1)
        x, slope = x + j * way, slope + j * more
    return x, -slope * sine / m.fastest


@compiled
def _drop(m: Medium, i: int, d: int, j: int) -> float:
    """Return the total vertical distance of a ray that is reflected at surface and bottom, m."""
    last = len(m.c) - 1
    drop: float = d * (m.z[m.lower] - m.z[m.upper]) + i * (m.z[m.upper] - m.z[0]) + j * (m.z[last] - m.z[m.lower])
    return drop


@compiled
def solve(m: Medium, low: float, high: float, at_low: float, at_high: float, x: float, i: int, d: int, j: int) -> float:
    """Return the angle between `low` and `high` at which a ray covers the distance x. At these two the distances exceed x by `at_low` and
    `at_high`, which have opposite signs.

    Newton's method, kept between the two, with the variable sqrt(theta^2 - low^2): near a ray that just turns, the distance is nearly linear in it.
    A distance that falls is nearly a hyperbola farther away, so there the method is applied to its inverse.
    """
    base, falls = low, at_low > 0.0
    theta = math.atan2(_drop(m, i, d, j), x)
    if not low < theta < high:
        part = at_low / (at_low - at_high) * ((x + at_high) / x if falls else 1.0)
        part = min(max(part, 0.05), 0.95)
        theta = math.sqrt(base * base + part * part * (high - base) * (high + base))
    before = math.inf
    for _ in range(100):
        way, slope = reach(m, theta, i, d, j)
        over = way - x
        if abs(over) < _EXACT_M:
            break
        if (over > 0.0) == (at_low > 0.0):
            low = theta
        else:
            high = theta
        root, step = math.sqrt((theta - base) * (theta + base)), low
        if slope != 0.0 and root > 0.0:
            root = max(root - over * theta / (slope * root) * (way / x if falls else 1.0), 0.0)
            step = math.sqrt(base * base + root * root)
        if not low < step < high or abs(over) > 0.5 * before:
            # Bisection; in a wide interval near 0 it halves the order of magnitude.
            step = math.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high)
        if step == theta or not low < step < high:
            break
        before, theta = abs(over), step
    return theta


@compiled
def turn(m: Medium, low: float, high: float, at_low: float, x: float, i: int, d: int, j: int) -> float:
    """Return an angle between two at which the error of the distance has the other sign than at both of them; nan if there is none."""
    _, slope = reach(m, low * (1.0 + _ASIDE), i, d, j)
    _, after = reach(m, high * (1.0 - _ASIDE), i, d, j)
    if slope * at_low >= 0.0 or after * at_low <= 0.0:
        return math.nan
    for _ in range(60):
        middle = math.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high)
        way, slope = reach(m, middle, i, d, j)
        if (way - x) * at_low <= 0.0:
            return middle
        if abs(slope) * (high - low) < _EXACT_M:
            return math.nan
        if slope * at_low < 0.0:
            low = middle
        else:
            high = middle
    return math.nan
