"""How a hull is cut into strips, for waves that differ along its length; plain numpy, at load.

The strips cover the length of a uniform hull with the same second moment of the displaced volume along its axis. So both the first correction for a
body that is small against the wave, 1 - k^2 <x^2> / 2, and the moment of a long wave are right for any form. For a box this is the length of its
edge. A body has as many Gauss-Legendre points as the shortest wave of the sea needs for force and moment (`strips_needed`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.physics.kernel.layout import SHAPE_SPHERE, STRIP

MOST_STRIPS = 16
"""Largest number of strips. They resolve waves down to a quarter of the hull's length; the effect of shorter waves is small, and not accurate."""
POINT = 0.01
"""Value of k L below which a hull is a point for waves: they are then 600 times as long as the hull, like the tide."""
TOLERANCE = 2e-3
"""Largest error of force and moment by the rule, relative to the same water along the whole hull."""


class HullLine(NamedTuple):
    """The line along which a hull has its strips.

    Attributes:
        axis: axis of B along which it lies.
        half: half its length, m; 0 if the hull is a point.
        turn: (3) what the first moment of the water's velocity (m2/s, along each axis of B) becomes as a turning (rad/s) that acts in M_A and
            damping, 1/m2: (s_a^2 - s_j^2) / (s_a^2 + s_j^2) / s_a^2, with the second moments s^2 of the volume along the hull (a) and across
            (j). A wave strains the water and does not turn it: so it turns a slender hull with its slope, and a ball not at all.
        moment: (3) factors of the moment of the Froude-Krylov force, 1 - s_j^2 / s_a^2: what acts along the hull, less what acts across it.
    """

    axis: int
    half: float
    turn: Vec3
    moment: Vec3


def hull_line(shapes: Records, r_b: Vec3, length: float | None) -> HullLine:
    """Return the line of a hull.

    Args:
        shapes: its SHAPE rows.
        r_b: their common centre, B, m.
        length: m along x; None: the one of the shapes, along the axis of B in which they are longest; without shapes a point.
    """
    second = np.zeros(3)
    for row in shapes:
        half = row["half"]
        own = np.full(3, half[0] ** 2 / 5.0) if row["kind"] == SHAPE_SPHERE else half**2 / 3.0
        second += row["share"] * ((row["center"] - np.array(r_b)) ** 2 + own)
    axis = 0 if length is not None else int(np.argmax(second))
    if length is not None:
        second[0] = length**2 / 12.0
    along = float(second[axis])
    turn, moment = [0.0] * 3, [0.0] * 3
    for i in range(3):
        if i != axis and along > 0.0:
            across = min(float(second[3 - axis - i]), along)
            turn[i] = (along - across) / (along + across) / along
            moment[i] = 1.0 - across / along
    return HullLine(axis, math.sqrt(3.0 * along), (turn[0], turn[1], turn[2]), (moment[0], moment[1], moment[2]))


def strip_rows(line: HullLine, r_b: Vec3, wave_number: float) -> Records:
    """Return the STRIP rows of a hull, for waves of at most a wave number (rad/m)."""
    n = strips_needed(wave_number * line.half)
    rows = np.zeros(n, STRIP)
    if n:
        places, weights = _rule(n)
        rows["r"] = r_b
        rows["r"][:, line.axis] += line.half * places
        rows["share"], rows["place"] = 0.5 * weights, places
        # Barycentric weights of Gauss-Legendre points, up to a common factor (Wang and Xiang 2012).
        rows["barycentric"] = (-1.0) ** np.arange(n) * np.sqrt((1.0 - places**2) * weights)
        rows["bend"] = places / (1.0 - places**2)
    return rows


@lru_cache(maxsize=256)
def strips_needed(phase: float) -> int:
    """Return the number of strips for waves whose phase differs by `phase` (rad) between the middle and an end of the hull.

    It is the smallest with which the rule gives sin(p)/p for the force, and (sin p - p cos p)/p^2 for the moment, within `TOLERANCE`; 0 for a point.
    """
    if 2.0 * phase < POINT:
        return 0
    force, moment = math.sin(phase) / phase, (math.sin(phase) - phase * math.cos(phase)) / phase**2
    for n in range(2, MOST_STRIPS):
        places, weights = _rule(n)
        wrong = abs(0.5 * np.sum(weights * np.cos(phase * places)) - force)
        turned = abs(0.5 * np.sum(weights * places * np.sin(phase * places)) - moment)
        if max(wrong, turned) < TOLERANCE:
            return n
    return MOST_STRIPS


@lru_cache(maxsize=MOST_STRIPS)
def _rule(n: int) -> tuple[FloatArray, FloatArray]:
    """Return points from -1 to 1 and weights of the Gauss-Legendre rule."""
    places, weights = np.polynomial.legendre.leggauss(n)
    return places, weights
