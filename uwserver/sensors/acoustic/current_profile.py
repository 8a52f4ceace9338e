"""What a current profiler makes of its beams: the weight of a cell, ambiguity, levels of one depth, and velocities by least squares."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from uwserver.physics.kernel.arrays import FloatArray

Mapping = Literal["off", "nearest", "linear"]
_SLOWEST = 0.3
"""A beam that goes down by less than this for each metre of distance crosses too few levels to be sorted by them."""


def points_of(distances: FloatArray, cell: float) -> FloatArray:
    """(2 cells + 1) distances (m) at which water is sampled: middles of cells, and halfway between them.

    Args:
        distances: (cells) of the middles, m.
        cell: size of a cell, m.
    """
    first = float(distances[0]) - 0.5 * cell
    points: FloatArray = first + 0.5 * cell * np.arange(2 * len(distances) + 1, dtype=np.float64)
    return points


def weigh(points: FloatArray) -> FloatArray:
    """(..., cells) means of (..., 2 cells + 1) points, by the triangle of two cells that gating a pulse as long as the cell makes.

    Equal weights of the middle and of both points half a cell away have the triangle's second moment, so that the mean is exact for cubics.
    A cell with a missing point (nan) is missing.
    """
    mean: FloatArray = (points[..., 0:-2:2] + points[..., 1:-1:2] + points[..., 2::2]) / 3.0
    return mean


def wrap(velocity: FloatArray, ambiguity: float) -> FloatArray:
    """Velocities as a phase shows them that goes once around from -ambiguity to +ambiguity, m/s."""
    return np.mod(velocity + ambiguity, 2.0 * ambiguity) - ambiguity


def to_levels(beams: FloatArray, down: FloatArray, blanking: float, cell: float, mapping: Mapping) -> FloatArray:
    """Beams' velocities by cells of their own, sorted into levels as far from the device, vertically, as the cells along the axis of a level device.

    Args:
        beams: (beams, cells) by distance along each beam.
        down: (beams) vertical way for each metre of distance along the axis of the device; 1 for a device that hangs straight.
        blanking, cell: m.
        mapping: take the nearest cell of the beam, or interpolate between two; the outermost serve half a cell beyond themselves.
    """
    count = beams.shape[1]
    if mapping == "off" or np.min(np.abs(down)) < _SLOWEST or np.ptp(np.sign(down)) != 0.0:
        return beams
    levels = blanking + cell * np.arange(1, count + 1)
    out = np.full_like(beams, np.nan)
    for i, way in enumerate(np.abs(down)):
        place = (levels / way - blanking) / cell - 1.0
        known = (place >= -0.5) & (place <= count - 0.5)
        place = place[known]
        if mapping == "nearest" or count == 1:
            out[i, known] = beams[i, np.clip(np.rint(place).astype(int), 0, count - 1)]
            continue
        low = np.clip(place.astype(int), 0, count - 2)
        part = place - low
        near, far = beams[i, low], beams[i, low + 1]
        # A missing neighbour that has no weight does not matter: rounding of a level device is no weight.
        out[i, known] = np.where(
            abs(part) < 1e-9, near, np.where(abs(part - 1.0) < 1e-9, far, near + part * (far - near))
        )
    return out


class Solver:
    """Vectors in S from velocities along slanted beams: least squares over those that are there, from three on."""

    def __init__(self, directions: FloatArray) -> None:
        """directions: (beams, 3) unit vectors in S."""
        self._directions = directions
        self._inverses: dict[bytes, FloatArray] = {}
        n = len(directions)
        self._error: FloatArray | None = None
        if n == 4:
            null: FloatArray = np.linalg.svd(directions.T)[2][-1]
            across = float(np.hypot(directions[0, 0], directions[0, 1]))
            self._error = null * np.copysign(1.0, null[0]) / (np.sqrt(2.0) * across)

    def inverse(self, there: NDArray[np.bool_]) -> FloatArray:
        """(3, beams) the least squares' matrix from the beams that are there; columns of the others are zero."""
        key = there.tobytes()
        if key not in self._inverses:
            matrix = np.zeros((3, len(there)))
            matrix[:, there] = np.linalg.pinv(self._directions[there])
            self._inverses[key] = matrix
        return self._inverses[key]

    def solve(self, beams: FloatArray) -> FloatArray:
        """(cells, 3) velocities of (beams, cells); nan where fewer than three beams are there."""
        cells = beams.shape[1]
        out, there = np.full((cells, 3), np.nan), np.isfinite(beams)
        filled = np.where(there, beams, 0.0)
        patterns: Any = np.unique(there.T, axis=0)
        for pattern in patterns:
            if pattern.sum() >= 3:
                chosen = (pattern == there.T).all(axis=1)
                out[chosen] = (self.inverse(pattern) @ filled[:, chosen]).T
        return out

    def errors(self, beams: FloatArray) -> FloatArray:
        """(cells) what four beams disagree by, scaled so that beams' noise shows in it as in a horizontal component; nan for other numbers."""
        if self._error is None:
            return np.full(beams.shape[1], np.nan)
        return self._error @ beams

    def altitude(self, ranges: FloatArray) -> float | None:
        """Distance (m) along the axis of the plane that (beams) ranges meet, nan for none: 1 / r_i = n . u_i on a plane n . x = 1."""
        there = np.isfinite(ranges)
        if there.sum() < 3:
            return None
        normal = float(self.inverse(there)[2, there] @ (1.0 / np.maximum(ranges[there], 1e-9)))
        return 1.0 / normal if normal > 0.0 else None
