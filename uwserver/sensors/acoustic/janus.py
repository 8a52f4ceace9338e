"""What a velocity log makes of its beams, as those of a Janus configuration: velocities and altitude by least squares."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Elsewhere, compiled
from uwserver.physics.kernel.random import SAMPLE, normals

solve: Any = Elsewhere("uwserver.physics.kernel.linear", "solve")

MOST_BEAMS = 12
ALTITUDE, MERIT, COVARIANCE, BEAMS = 3, 4, 5, 14
"""Places in a reading of n beams; velocities, ranges and locks of the beams follow each other, and then the velocity relative to the water."""
WATER = 16
"""First lane of random numbers for the water track, one for each beam."""


@compiled
def _spread_of(row: Any, out: Array, locks: int) -> Array:
    """(3, 3) inverse of B^T B of the beams in lock, or of all where `locks` is 0; B has their directions as rows."""
    total, inverse = np.zeros((3, 3)), np.eye(3)
    for i in range(row.beams):
        if locks == 0 or out[locks + i] != 0.0:
            for a in range(3):
                for b in range(3):
                    total[a, b] += row.believed[i, a] * row.believed[i, b]
    solve(total, inverse)
    return inverse


@compiled
def _projected(row: Any, spread: Array, i: int, a: int) -> float:
    """Row a, column i of the least squares' matrix from beams to a vector."""
    beam = row.believed[i]
    return float(spread[a, 0] * beam[0] + spread[a, 1] * beam[1] + spread[a, 2] * beam[2])


@compiled
def solve_bottom(head: Any, row: Any, out: Array) -> bool:
    """Velocity, altitude and what the device expects of them, from at least three beams in lock."""
    n = row.beams
    velocities, ranges, locks = BEAMS, BEAMS + n, BEAMS + 2 * n
    used = 0
    for i in range(n):
        used += 1 if out[locks + i] != 0.0 else 0
    if used < 3:
        return False
    spread = _spread_of(row, out, locks)
    # 1 / r_i = n . u_i on a plane n . x = 1: the same least squares give its distance along the axis.
    normal = 0.0
    v = (0.0, 0.0, 0.0)
    for i in range(n):
        if out[locks + i] != 0.0:
            normal += _projected(row, spread, i, 2) / max(out[ranges + i], 1e-9)
            s = out[velocities + i]
            v = (
                v[0] + _projected(row, spread, i, 0) * s,
                v[1] + _projected(row, spread, i, 1) * s,
                v[2] + _projected(row, spread, i, 2) * s,
            )
    if normal <= 0.0:
        return False
    out[0], out[1], out[2] = v
    out[ALTITUDE] = 1.0 / normal
    sigma = 0.0 if head.exact != 0 else row.beam_sigma
    trace = 0.0
    for a in range(3):
        trace += spread[a, a]
        for b in range(3):
            out[COVARIANCE + 3 * a + b] = sigma * sigma * spread[a, b]
    out[MERIT] = sigma * math.sqrt(trace)
    return True


@compiled
def track_water(head: Any, row: Any, out: Array, gain: float, v: Vec3) -> None:
    """Velocity relative to a layer of water, by all beams."""
    spread = _spread_of(row, out, 0)
    first, sigma = BEAMS + 3 * row.beams, 0.0 if head.exact != 0 else row.water_sigma
    out[first] = out[first + 1] = out[first + 2] = 0.0
    for i in range(row.beams):
        noise, _ = normals(head.key, head.number, SAMPLE, WATER + i)
        drawn = gain * along(head, row, i, v) + sigma * noise
        for a in range(3):
            out[first + a] += _projected(row, spread, i, a) * drawn


@compiled
def along(head: Any, row: Any, i: int, v: Vec3) -> float:
    """Part of a velocity in S along a beam as it really points."""
    beam = row.believed[i] if head.exact != 0 else row.real[i]
    return float(beam[0] * v[0] + beam[1] * v[1] + beam[2] * v[2])
