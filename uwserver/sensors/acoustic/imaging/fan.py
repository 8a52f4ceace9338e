"""A fan of rays: cells of equal angles about the axis of a transducer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, Records

CELL = np.dtype([("direction", "f8", 3), ("across", "f8", 3), ("along", "f8", 3), ("emitted", "f8")])
"""A cell of a fan: unit direction of its middle in the frame of the fan; unit vectors across it, towards growing azimuth and elevation, times the
angles that it covers; the intensity that goes into it, times its solid angle."""
FINEST = 32
"""A cell may be cut into so many, across or along."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


class Grid(NamedTuple):
    """Cells of equal angles about the x axis of a transducer, and their rays; row after row from below, each column after column.

    Attributes:
        cells, direction, place: as of `Fan`, `emitted` not filled in.
        size: width and height of a cell, rad.
        azimuth, elevation: (columns) and (rows) of the middles, rad.
    """

    cells: Records
    direction: FloatArray
    place: FloatArray
    size: tuple[float, float]
    azimuth: FloatArray
    elevation: FloatArray

    @classmethod
    def of(cls, width: float, height: float, columns: int, rows: int, staggered: bool = True) -> Grid:
        """Of these angles (rad); see `Fan` for what is staggered."""
        azimuth, da = _cells(width, columns)
        elevation, de = _cells(height, rows)
        az, el = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
        cells = np.zeros(len(az), CELL)
        cells["direction"] = _unit(az, el)
        direction: FloatArray = cells["direction"].copy()
        column, row = (grid.ravel() for grid in np.meshgrid(np.arange(columns), np.arange(rows)))
        place = np.stack((column + 0.5, row + 0.5), axis=1)
        if staggered:
            # The place across goes by the row, that along by the column.
            off = np.stack((_spread(rows)[row], _spread(columns)[column]), axis=1)
            place += off
            direction = _unit(az + da * off[:, 0], el + de * off[:, 1])
        across = np.stack((-np.sin(az), np.cos(az), np.zeros(az.shape)), axis=1)
        cells["across"] = across * (da * np.cos(el))[:, None]
        along = np.stack((-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)), axis=1)
        cells["along"] = along * de
        return cls(cells, direction, place, (da, de), azimuth, elevation)

    def areas(self, level: float = 1.0) -> FloatArray:
        """(rows) solid angle of a cell (sr) times a level."""
        da, de = self.size
        result: FloatArray = level * da * (np.sin(self.elevation + de / 2) - np.sin(self.elevation - de / 2))
        return result


class Fan:
    """Rays about the x axis of a transducer, one in each cell of equal angles; row after row from below, each column after column.

    A staggered fan has its rays at other places in each cell: those of a column at as many azimuths as it has rows, evenly over the width of a
    cell, and those of a row likewise. So what is upright or level and thinner than a cell cannot stand between all of them.

    Attributes:
        columns, rows: of cells.
        direction: (n, 3) unit, of the rays in the transducer's frame.
        cells: (n) of CELL, `direction` being that of the middle; `emitted` is the two-way beam pattern, that of a line array in each direction
            and 1 on the axis, times the solid angle (sr) and the level.
        place: (n, 2) of the rays across and along, in cells from the corner of the fan.
        size: width and height of a cell, rad.
        area: (rows) solid angle of a cell (sr) times the level.
        across_power, along_power: (2 FINEST columns + 1) and (2 FINEST rows + 1) two-way pattern over azimuth and elevation, 2 FINEST steps a cell.
    """

    def __init__(
        self, width: float, height: float, columns: int, rows: int, cover: float, level: float = 1.0, staggered: bool = True
    ) -> None:  # fmt: skip
        """Spread the rays.

        Args:
            width, height: angles between the half-power points, rad.
            columns, rows: number of rays.
            cover: part of these angles that the rays fill; beyond 1 are the flanks of the pattern.
            level: factor of all.
            staggered: otherwise each ray is in the middle of its cell.
        """
        self.columns, self.rows = columns, rows
        grid = Grid.of(cover * width, cover * height, columns, rows, staggered)
        self.cells, self.direction, self.place, self.size = grid.cells, grid.direction, grid.place, grid.size
        da, de = grid.size
        self.area: FloatArray = grid.areas(level)
        self.across_power, self.along_power = _two_way(columns, da, width), _two_way(rows, de, height)
        middle = slice(FINEST, None, 2 * FINEST)
        pattern = self.along_power[middle] * self.area
        self.cells["emitted"] = np.outer(pattern, self.across_power[middle]).ravel()


def directivity(width: float, height: float) -> float:
    """Directivity index of a rectangular aperture, as a ratio: 4 pi over the product of the beam widths (rad)."""
    return 4.0 * math.pi / (width * height)


def _cells(angle: float, count: int) -> tuple[FloatArray, float]:
    size = angle / count
    middle: FloatArray = np.arange(count, dtype=np.float64)
    middle = (middle + 0.5) * size - angle / 2.0
    return middle, size


def _unit(az: FloatArray, el: FloatArray) -> FloatArray:
    result: FloatArray = np.stack((np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=1)
    return result


def _spread(count: int) -> FloatArray:
    """(count) places from -1/2 to 1/2, evenly, neighbours far apart: multiples of what comes next to the golden part and shares no divisor."""
    by = max(1, round(count * _GOLDEN))
    while math.gcd(by, count) > 1:
        by += 1
    result: FloatArray = (np.arange(count) * by % count + 0.5) / count - 0.5
    return result


def two_way(angle: FloatArray, width: float) -> FloatArray:
    """Two-way power pattern of a line array with this angle between half-power points, at angles off its axis (rad)."""
    result: FloatArray = np.sinc(2.0 * 0.442946 * angle / width) ** 4
    return result


def _two_way(count: int, size: float, width: float) -> FloatArray:
    """The same over cells of a size."""
    return two_way((np.arange(2 * FINEST * count + 1) / (2 * FINEST) - 0.5 * count) * size, width)
