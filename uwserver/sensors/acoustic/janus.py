"""Slanted beams about an axis, as those of a Janus configuration: vectors and altitudes by least squares over those that tell something, and what
a velocity log makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Elsewhere, compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import BeamView
from uwserver.units import rad

solve: Any = Elsewhere("uwserver.physics.kernel.linear", "solve")

MOST_BEAMS = 12
ALTITUDE, MERIT, COVARIANCE, BEAMS = 3, 4, 5, 14
"""Places in a reading of n beams; velocities, ranges and locks of the beams follow each other, and then the velocity relative to the water."""
WATER = 16
"""First lane of random numbers for the water track, one for each beam."""
_FLAT = 1e12
"""So much more sure is one direction than another (as a variance) where beams lie in a plane, but for rounding: they give no vector then."""


def slanted(tilt: float, azimuths_deg: Iterable[float], near: float, far: float) -> tuple[BeamView, ...]:
    """Beams at an angle (rad) to the axis, as a picture shows them; near and far (m) along each beam."""
    across, along = math.sin(tilt), math.cos(tilt)
    turns = map(rad, azimuths_deg)
    return tuple(BeamView((across * math.cos(a), across * math.sin(a), along), 0.0, near, far) for a in turns)


@compiled
def told_by(told: Array) -> int:
    """How many beams tell something: a number that is not NaN."""
    count = 0
    for k in range(len(told)):
        count += 0 if math.isnan(told[k]) else 1
    return count


@compiled
def spread_of(beams: Array, told: Array) -> Array:
    """(3, 3) inverse of B^T B of those of n beams that tell something; B has their directions as rows. NaN where these lie in one plane.

    Args:
        beams: (n or more, 3) unit vectors.
        told: (n) what each beam tells; NaN for nothing.
    """
    total, inverse = np.zeros((3, 3)), np.eye(3)
    for i in range(len(told)):
        if not math.isnan(told[i]):
            for a in range(3):
                for b in range(3):
                    total[a, b] += beams[i, a] * beams[i, b]
    size = total[0, 0] + total[1, 1] + total[2, 2]
    solve(total, inverse)
    if not size * (abs(inverse[0, 0]) + abs(inverse[1, 1]) + abs(inverse[2, 2])) < _FLAT:
        inverse[:] = np.nan
    return inverse


@compiled
def _projected(beams: Array, spread: Array, i: int, a: int) -> float:
    """Row a, column i of the least squares' matrix from beams to a vector."""
    return float(spread[a, 0] * beams[i, 0] + spread[a, 1] * beams[i, 1] + spread[a, 2] * beams[i, 2])


@compiled
def vector_of(beams: Array, spread: Array, told: Array) -> Vec3:
    """The vector whose parts along the beams come nearest to what they tell; arguments as of `spread_of`, and what that gives."""
    x = y = z = 0.0
    for i in range(len(told)):
        if not math.isnan(told[i]):
            x += _projected(beams, spread, i, 0) * told[i]
            y += _projected(beams, spread, i, 1) * told[i]
            z += _projected(beams, spread, i, 2) * told[i]
    return x, y, z


@compiled
def altitude_of(beams: Array, spread: Array, ranges: Array) -> float:
    """Distance (m) along the axis of the plane that beams meet at (n) ranges (m; NaN for none); NaN where there is no such plane before them."""
    # 1 / r_i = n . u_i on a plane n . x = 1: the same least squares give its distance along the axis.
    normal = 0.0
    for i in range(len(ranges)):
        if not math.isnan(ranges[i]):
            normal += _projected(beams, spread, i, 2) / max(ranges[i], 1e-9)
    return 1.0 / normal if normal > 0.0 else math.nan


@compiled
def solve_bottom(head: Any, row: Any, out: Array) -> bool:
    """Velocity, altitude and what the device expects of them, from at least three beams in lock."""
    n = row.beams
    velocities, ranges = out[BEAMS : BEAMS + n], out[BEAMS + n : BEAMS + 2 * n]
    if told_by(velocities) < 3:
        return False
    spread = spread_of(row.believed, velocities)
    altitude = altitude_of(row.believed, spread, ranges)
    if math.isnan(altitude):
        return False
    out[0], out[1], out[2] = vector_of(row.believed, spread, velocities)
    out[ALTITUDE] = altitude
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
    n, sigma = row.beams, 0.0 if head.exact != 0 else row.water_sigma
    drawn = np.empty(n)
    for i in range(n):
        noise, _ = normals(head.key, head.number, SAMPLE, WATER + i)
        drawn[i] = gain * along(head, row, i, v) + sigma * noise
    first = BEAMS + 3 * n
    out[first], out[first + 1], out[first + 2] = vector_of(row.believed, spread_of(row.believed, drawn), drawn)


@compiled
def along(head: Any, row: Any, i: int, v: Vec3) -> float:
    """Part of a velocity in S along a beam as it really points."""
    beam = row.believed[i] if head.exact != 0 else row.real[i]
    return float(beam[0] * v[0] + beam[1] * v[1] + beam[2] * v[2])
