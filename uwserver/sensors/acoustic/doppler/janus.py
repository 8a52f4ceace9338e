"""Slanted beams around an axis, as in a Janus configuration: vectors and altitudes by least squares, and profiles of velocity over depth.

The least squares use only the beams that have a value; NaN stands for none. The equations are those of a velocity log and of a current profiler.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import Elsewhere, compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import BeamView
from uwserver.units import rad

solve: Any = Elsewhere("uwserver.physics.kernel.linear", "solve")

MOST_BEAMS = 12
ALTITUDE, MERIT, COVARIANCE, BEAMS = 3, 4, 5, 14
"""Places in a reading of a velocity log with n beams. From BEAMS on there are n velocities, n ranges and n locks, and then the velocity relative to
the water."""
WATER = 16
"""First lane of random numbers for water track, one for each beam."""
_FLAT = 1e12
"""Ratio of variances in the surest and the least sure direction. It is larger only for beams in one plane, but for rounding; these give no vector."""

Mapping = Literal["off", "nearest", "linear"]
OFF, NEAREST, LINEAR = 0, 1, 2
"""Values of `Mapping` in a record, in their order."""
_SLOWEST = 0.3
"""A beam that goes down by less than this for each metre of distance crosses too few levels to be sorted by them."""


def directions_of(tilt: float, azimuths_deg: Iterable[float]) -> FloatArray:
    """Return unit vectors (n, 3) of beams at an angle `tilt` (rad) to the z axis, at azimuths (deg) from x to y."""
    across, along = math.sin(tilt), math.cos(tilt)
    return np.array([(across * math.cos(a), across * math.sin(a), along) for a in map(rad, azimuths_deg)])


def slanted(tilt: float, azimuths_deg: Iterable[float], near: float, far: float) -> tuple[BeamView, ...]:
    """Return beams for a picture of the world, as of `directions_of`; near and far (m) are measured along each beam."""
    return tuple(BeamView((x, y, z), 0.0, near, far) for x, y, z in directions_of(tilt, azimuths_deg).tolist())


@compiled
def count_values(values: Array) -> int:
    """Return how many values are not NaN."""
    count = 0
    for k in range(len(values)):
        count += 0 if math.isnan(values[k]) else 1
    return count


@compiled
def inverse_of(beams: Array, values: Array) -> Array:
    """Return (3, 3) the inverse of B^T B, where the rows of B are the directions of the beams with a value; NaN if these lie in one plane.

    Args:
        beams: (n or more, 3) unit vectors.
        values: (n) value of each beam; NaN for none.
    """
    total, inverse = np.zeros((3, 3)), np.eye(3)
    for i in range(len(values)):
        if not math.isnan(values[i]):
            for a in range(3):
                for b in range(3):
                    total[a, b] += beams[i, a] * beams[i, b]
    size = total[0, 0] + total[1, 1] + total[2, 2]
    solve(total, inverse)
    if not size * (abs(inverse[0, 0]) + abs(inverse[1, 1]) + abs(inverse[2, 2])) < _FLAT:
        inverse[:] = np.nan
    return inverse


@compiled
def _projected(beams: Array, inverse: Array, i: int, a: int) -> float:
    """Return element (a, i) of the least-squares matrix (B^T B)^-1 B^T, which leads from beams to a vector."""
    return float(inverse[a, 0] * beams[i, 0] + inverse[a, 1] * beams[i, 1] + inverse[a, 2] * beams[i, 2])


@compiled
def vector_of(beams: Array, inverse: Array, values: Array) -> Vec3:
    """Return the vector whose components along the beams fit their values best.

    Args:
        beams, values: as of `inverse_of`.
        inverse: that it returns.
    """
    x = y = z = 0.0
    for i in range(len(values)):
        if not math.isnan(values[i]):
            x += _projected(beams, inverse, i, 0) * values[i]
            y += _projected(beams, inverse, i, 1) * values[i]
            z += _projected(beams, inverse, i, 2) * values[i]
    return x, y, z


@compiled
def altitude_of(beams: Array, inverse: Array, ranges: Array) -> float:
    """Return the distance (m) along the axis to the plane that the beams hit; NaN if there is no such plane ahead.

    Args:
        beams, inverse: as of `vector_of`.
        ranges: (n) of the beams, m; NaN for none.
    """
    # On a plane n . x = 1 a beam has 1 / r_i = n . u_i. The same least squares give n, and 1 / n_z is the distance along the axis.
    normal = 0.0
    for i in range(len(ranges)):
        if not math.isnan(ranges[i]):
            normal += _projected(beams, inverse, i, 2) / max(ranges[i], 1e-9)
    return 1.0 / normal if normal > 0.0 else math.nan


@compiled
def solve_bottom(head: Any, row: Any, out: Array) -> bool:
    """Write velocity, altitude, covariance and figure of merit of a velocity log. Returns False with fewer than three beams in lock."""
    n = row.beams
    velocities, ranges = out[BEAMS : BEAMS + n], out[BEAMS + n : BEAMS + 2 * n]
    if count_values(velocities) < 3:
        return False
    inverse = inverse_of(row.believed, velocities)
    altitude = altitude_of(row.believed, inverse, ranges)
    if math.isnan(altitude):
        return False
    out[0], out[1], out[2] = vector_of(row.believed, inverse, velocities)
    out[ALTITUDE] = altitude
    sigma = 0.0 if head.exact != 0 else row.beam_sigma
    trace = 0.0
    for a in range(3):
        trace += inverse[a, a]
        for b in range(3):
            out[COVARIANCE + 3 * a + b] = sigma * sigma * inverse[a, b]
    out[MERIT] = sigma * math.sqrt(trace)
    return True


@compiled
def track_water(head: Any, row: Any, out: Array, gain: float, v: Vec3) -> None:
    """Write the velocity relative to a layer of water, measured by all beams. `gain`: measured over true velocity; `v`: true velocity in S, m/s."""
    n, sigma = row.beams, 0.0 if head.exact != 0 else row.water_sigma
    drawn = np.empty(n)
    for i in range(n):
        noise, _ = normals(head.key, head.number, SAMPLE, WATER + i)
        drawn[i] = gain * along(head, row, i, v) + sigma * noise
    first = BEAMS + 3 * n
    out[first], out[first + 1], out[first + 2] = vector_of(row.believed, inverse_of(row.believed, drawn), drawn)


@compiled
def along(head: Any, row: Any, i: int, v: Vec3) -> float:
    """Return the component of a velocity in S along the true direction of beam i."""
    beam = row.believed[i] if head.exact != 0 else row.real[i]
    return float(beam[0] * v[0] + beam[1] * v[1] + beam[2] * v[2])


@compiled
def mapping_of(down: Array, mapping: int) -> int:
    """Return `mapping`, or `OFF` if the beams cannot be sorted by depth: one is too near the horizontal, or one goes up and another down.

    Args:
        down: (beams) vertical distance for each metre along the axis of the device; 1 for a device that hangs straight.
        mapping: take the nearest cell of the beam (`NEAREST`), interpolate between two (`LINEAR`), or neither (`OFF`).
    """
    for way in down:
        if abs(way) < _SLOWEST or (way < 0.0) != (down[0] < 0.0):
            return OFF
    return mapping


@compiled
def at_level(column: Array, down: float, k: int, blanking: float, cell: float, mapping: int) -> float:
    """Return the value of a beam at level k, whose vertical distance is that of cell k along the axis of a level device.

    Args:
        column: (cells) values by distance along the beam.
        down: as of `mapping_of`, which has returned `mapping`.
        k: from 0.
        blanking, cell: m.
        mapping: the first and the last cell serve half a cell beyond themselves; farther out there is NaN.
    """
    count = len(column)
    if mapping == OFF:
        return float(column[k])
    place = ((blanking + cell * (k + 1)) / abs(down) - blanking) / cell - 1.0
    if not -0.5 <= place <= count - 0.5:
        return math.nan
    if mapping == NEAREST or count == 1:
        return float(column[min(max(int(np.rint(place)), 0), count - 1)])
    low = min(max(int(place), 0), count - 2)
    part, near, far = place - low, column[low], column[low + 1]
    # A neighbour of weight 0 may be missing. For a level device rounding alone would give it a weight.
    if abs(part) < 1e-9:
        return float(near)
    return float(far if abs(part - 1.0) < 1e-9 else near + part * (far - near))


@compiled
def solve_levels(row: Any, along: Array, down: Array, velocities: Array, errors: Array) -> bool:
    """Find the velocity vector of each level from the slanted beams of a current profiler. Returns whether there is one.

    Args:
        row: record of the profiler: directions of its slanted beams, its cells, and how it maps them.
        along: (cells beams) velocity along each beam in its own cells, m/s; all beams of a cell together, the axial one last.
        down: (slanted) as of `mapping_of`.
        velocities: (3 cells) receives the vectors in S, m/s; NaN where beams of fewer than three directions have a value.
        errors: (cells) receives the error velocity of four beams, scaled so that it is as noisy as a horizontal component; NaN for other numbers.
    """
    n, mapping, found = row.slanted, mapping_of(down, row.mapping), False
    values, inverse, last = np.empty(n), np.empty((3, 3)), 0
    for k in range(row.cells):
        error, beams = 0.0, 0
        for i in range(n):
            values[i] = at_level(along[i :: row.beams], down[i], k, row.blanking, row.cell, mapping)
            error += row.disagreement[i] * values[i]
            beams |= 0 if math.isnan(values[i]) else 1 << i
        errors[k] = error
        if count_values(values) < 3:
            continue
        # The inverse depends only on which beams have a value, and most levels have the same ones.
        if beams != last:
            inverse, last = inverse_of(row.direction, values), beams
        velocity: Vec3 = vector_of(row.direction, inverse, values)
        velocities[3 * k], velocities[3 * k + 1], velocities[3 * k + 2] = velocity
        found = found or not math.isnan(velocity[0])
    return found
