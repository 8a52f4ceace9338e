"""Two fans of rays that look to the sides of a vehicle, each narrow along its way and tall across it."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.acoustic.imaging.fan import CELL, Grid, two_way
from uwserver.sensors.acoustic.imaging.swath import Plane, Swath
from uwserver.units import rad

COLUMNS = 4
"""Of each side, over two beam widths: two in the width between half-power points, and a sum that is a multiple of four."""
_FLANKS = 2.0
_LEVEL = math.tan(rad(2.0))
"""Slope about which steps go over from equal ratios of slopes to equal slopes."""
_LOWEST, _HIGHEST = rad(89.5), rad(80.0)
_ABOVE = 4
"""So many times fewer rows look up than down."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def rows_above(rows: int) -> int:
    """How many look up beside so many that look down."""
    return max(rows // _ABOVE, 1)


def depressions(rows: int) -> FloatArray:
    """Edges (n + 1) of the rows from above to below the horizon, rad below it; `rows` of them below.

    A level bottom h below is met at the distance h / tan: equal steps of log tan are equal parts of the distance. Near the horizon, where these steps
    would never end, they are equal angles.
    """
    low, high = math.asinh(math.tan(_LOWEST) / _LEVEL), math.asinh(math.tan(_HIGHEST) / _LEVEL)
    below = np.linspace(0.0, low, rows + 1)
    above = np.linspace(-high, 0.0, rows_above(rows) + 1)[:-1]
    result: FloatArray = np.arctan(_LEVEL * np.sinh(np.concatenate([above, below])))
    return result


class Sides(Swath):
    """Rays and beams of port (number 0) and starboard (1), in a frame whose x is ahead, y starboard and z down.

    Each side hears its own rays alone. Both patterns are those of line arrays that send and hear; there is no transmitter of its own.
    """

    def __init__(self, width: float, height: float, tilt: float, rows: int) -> None:
        """Lay out rays.

        Args:
            width: angle along the way between half-power points, rad.
            height: angle across the way between half-power points, rad.
            tilt: of both axes below the horizon, rad.
            rows: of the rays below the horizon.
        """
        edges = depressions(rows)
        count = len(edges) - 1
        self.columns, self.rows = 2 * COLUMNS, count
        da = _FLANKS * width / COLUMNS
        along_way: FloatArray = np.arange(COLUMNS, dtype=np.float64)
        along_way = (along_way + 0.5 - 0.5 * COLUMNS) * da
        azimuth, side = np.tile(along_way, 2), np.repeat((-1.0, 1.0), COLUMNS)
        middle: FloatArray = 0.5 * (edges[1:] + edges[:-1])
        size: FloatArray = edges[1:] - edges[:-1]
        column, row = (each.ravel() for each in np.meshgrid(np.arange(self.columns), np.arange(count)))
        # The place across goes by the row, that along by the column; both sides look the same way.
        off = np.stack((_staggered(row), _staggered(column % COLUMNS)), axis=1)
        cells = np.zeros(len(row), CELL)
        a, d, s = azimuth[column], middle[row], side[column]
        cells["direction"] = _unit(a, d, s)
        cells["across"] = da * np.stack((np.cos(a), -np.sin(a) * np.cos(d) * s, -np.sin(a) * np.sin(d)), axis=1)
        along = np.stack((np.zeros(a.shape), -np.cos(a) * np.sin(d) * s, np.cos(a) * np.cos(d)), axis=1)
        cells["along"] = along * size[row, None]
        cells["emitted"] = two_way(d - tilt, height) * da * size[row] * np.cos(a)
        direction = _unit(a + da * off[:, 0], d + size[row] * off[:, 1], s)
        place = np.stack((column + 0.5, row + 0.5), axis=1) + off
        self.grid = Grid(cells, direction, place, (da, float(size.mean())), along_way, -middle)
        self.column: IntArray = column
        self.azimuth: FloatArray = np.array((-0.5 * math.pi, 0.5 * math.pi))
        power = np.zeros((2, self.columns))
        power[0, :COLUMNS] = power[1, COLUMNS:] = two_way(along_way, width)
        self.power: Plane = power.astype(np.float32)
        self.pattern: Plane = np.sqrt(power).astype(np.float32)
        self.directivity = 4.0 * math.pi / (width * height)
        self.aperture = 0.886 / width


def _unit(azimuth: FloatArray, depression: FloatArray, side: FloatArray) -> FloatArray:
    """(n, 3) of rays at angles ahead of the side (as of a cone about x) and below the horizon."""
    result: FloatArray = np.empty((len(azimuth), 3))
    result[:, 0] = np.sin(azimuth)
    result[:, 1] = np.cos(azimuth) * np.cos(depression) * side
    result[:, 2] = np.cos(azimuth) * np.sin(depression)
    return result


def _staggered(number: IntArray) -> FloatArray:
    """Places from -1/2 to 1/2 of these numbers, neighbours far apart."""
    place: FloatArray = number.astype(np.float64)
    return place * _GOLDEN % 1.0 - 0.5
