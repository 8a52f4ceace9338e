"""What a current profiler makes of its beams: the weight of a cell, ambiguity, levels of one depth, and velocities by least squares."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.sensors.acoustic.janus import spread_of, told_by, vector_of

Mapping = Literal["off", "nearest", "linear"]
OFF, NEAREST, LINEAR = 0, 1, 2
"""Its values in a record, in their order."""
_SLOWEST = 0.3
"""A beam that goes down by less than this for each metre of distance crosses too few levels to be sorted by them."""


@compiled
def point_of(blanking: float, cell: float, j: int) -> float:
    """Distance (m) of point j at which water is sampled: middles of cells, at 1, 3, ..., and halfway between them, from the front of the first on.

    Args:
        blanking: before the first cell, m; its middle lies a cell farther.
        cell: size of a cell, m.
        j: from 0 to twice the number of cells.
    """
    return float((blanking + cell) - 0.5 * cell + 0.5 * cell * j)


@compiled
def weigh(front: float, middle: float, back: float) -> float:
    """Mean of a cell by its three points, as of the triangle of two cells that gating a pulse as long as the cell makes.

    Equal weights of the middle and of both points half a cell away have the triangle's second moment, so that the mean is exact for cubics.
    A cell with a missing point (NaN) is missing.
    """
    return (front + middle + back) / 3.0


@compiled
def wrap(velocity: float, ambiguity: float) -> float:
    """A velocity as a phase shows it that goes once around from -ambiguity to +ambiguity, m/s."""
    return float((velocity + ambiguity) % (2.0 * ambiguity) - ambiguity)


@compiled
def mapping_of(down: Array, mapping: int) -> int:
    """`mapping`, or `OFF` where the beams cannot be sorted by depth: one is too near the horizontal, or one goes up and another down.

    Args:
        down: (beams) vertical way for each metre of distance along the axis of the device; 1 for a device that hangs straight.
        mapping: take the nearest cell of the beam (`NEAREST`), interpolate between two (`LINEAR`), or neither (`OFF`).
    """
    for way in down:
        if abs(way) < _SLOWEST or (way < 0.0) != (down[0] < 0.0):
            return OFF
    return mapping


@compiled
def at_level(column: Array, down: float, k: int, blanking: float, cell: float, mapping: int) -> float:
    """What a beam tells of the k-th level: as far from the device, vertically, as the k-th cell along the axis of a level device.

    Args:
        column: (cells) by distance along the beam.
        down: as of `mapping_of`, whose answer `mapping` is.
        k: from 0 on.
        blanking, cell: m.
        mapping: the outermost cells serve half a cell beyond themselves; NaN farther out.
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
    # A missing neighbour that has no weight does not matter: rounding of a level device is no weight.
    if abs(part) < 1e-9:
        return float(near)
    return float(far if abs(part - 1.0) < 1e-9 else near + part * (far - near))


@compiled
def solve_levels(row: Any, along: Array, down: Array, velocities: Array, errors: Array) -> bool:
    """Vectors in S from what slanted beams tell, level by level; whether there is one.

    Args:
        row: record of a profiler: directions of its slanted beams, its cells, and how it maps them.
        along: (cells beams) along each beam by its own cells, the beams of a cell together, the axial one last, m/s.
        down: (slanted) as of `mapping_of`.
        velocities: (3 cells) receives them, m/s; NaN where beams of fewer than three directions tell something.
        errors: (cells) receives what four beams disagree by, so that beams' noise shows in it as in a horizontal component; NaN of other numbers.
    """
    n, mapping, found = row.slanted, mapping_of(down, row.mapping), False
    told, spread, last = np.empty(n), np.empty((3, 3)), 0
    for k in range(row.cells):
        error, beams = 0.0, 0
        for i in range(n):
            told[i] = at_level(along[i :: row.beams], down[i], k, row.blanking, row.cell, mapping)
            error += row.disagreement[i] * told[i]
            beams |= 0 if math.isnan(told[i]) else 1 << i
        errors[k] = error
        if told_by(told) < 3:
            continue
        if beams != last:
            spread, last = spread_of(row.direction, told), beams
        velocity: Vec3 = vector_of(row.direction, spread, told)
        velocities[3 * k], velocities[3 * k + 1], velocities[3 * k + 2] = velocity
        found = found or not math.isnan(velocity[0])
    return found
