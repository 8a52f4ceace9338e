"""The rays of one beam: cells of equal angles around the axis of a transducer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, Records

CELL = np.dtype([("direction", "f8", 3), ("across", "f8", 3), ("along", "f8", 3), ("emitted", "f8")])
"""A cell of a fan: unit direction of its middle in the frame of the fan; unit vectors towards growing azimuth and elevation, times the angles that
the cell covers; and the intensity that goes into it, times its solid angle."""
FINEST = 32
"""Largest number of parts into which a cell is cut, across or along."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
FLANKS = 2.0
"""Rays fill so many beam widths: at their edge the two-way pattern is 36 dB down."""


class Grid(NamedTuple):
    """Cells of equal angles around the x axis of a transducer, and their rays; row after row from below, each column after column.

    Attributes:
        cells, direction, place: as in `Fan`; `emitted` is 0.
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
        """Return a grid that covers these angles (rad); for `staggered` see `Fan`."""
        azimuth, da = _cells(width, columns)
        elevation, de = _cells(height, rows)
        az, el = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
        cells = np.zeros(len(az), CELL)
        cells["direction"] = _unit(az, el)
        direction: FloatArray = cells["direction"].copy()
        column, row = (grid.ravel() for grid in np.meshgrid(np.arange(columns), np.arange(rows)))
        place = np.stack((column + 0.5, row + 0.5), axis=1)
        if staggered:
            # The shift across depends on the row, the shift along on the column.
            off = np.stack((_spread(rows)[row], _spread(columns)[column]), axis=1)
            place += off
            direction = _unit(az + da * off[:, 0], el + de * off[:, 1])
        across = np.stack((-np.sin(az), np.cos(az), np.zeros(az.shape)), axis=1)
        cells["across"] = across * (da * np.cos(el))[:, None]
        along = np.stack((-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)), axis=1)
        cells["along"] = along * de
        return cls(cells, direction, place, (da, de), azimuth, elevation)

    def areas(self, level: float = 1.0) -> FloatArray:
        """Return (rows) the solid angle of a cell (sr) times a level."""
        da, de = self.size
        result: FloatArray = level * da * (np.sin(self.elevation + de / 2) - np.sin(self.elevation - de / 2))
        return result


class Fan:
    """Rays around the x axis of a transducer, one in each cell of equal angles; row after row from below, each column after column.

    In a staggered fan the rays are at different places in their cells. The rays of a column have as many azimuths as there are rows, spread evenly
    over the width of a cell, and those of a row likewise. So nothing that is upright or level and thinner than a cell fits between all rays.

    Attributes:
        columns, rows: of cells.
        direction: (n, 3) unit vectors of the rays in the transducer's frame.
        cells: (n) of CELL; `emitted` is the two-way beam pattern (a line array's in each direction, 1 on the axis) times the solid angle (sr) and the
            level.
        place: (n, 2) place of each ray across and along, in cells from the corner of the fan.
        size: width and height of a cell, rad.
        area: (rows) solid angle of a cell (sr) times the level.
        across_power, along_power: (2 FINEST columns + 1) and (2 FINEST rows + 1) two-way pattern over azimuth and elevation, 2 FINEST steps a cell.
    """

    def __init__(
        self, width: float, height: float, columns: int, rows: int, cover: float, level: float = 1.0, staggered: bool = True
    ) -> None:  # fmt: skip
        """Lay out the rays.

        Args:
            width, height: angles between the half-power points, rad.
            columns, rows: number of rays.
            cover: part of these angles that the rays fill; more than 1 includes the flanks of the pattern.
            level: factor of `emitted`.
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


class Pencil:
    """The rays of a narrow conical beam along x, whose echoes are heard as one.

    The pattern of a round piston is taken as the product of the patterns of two lines.

    Attributes:
        grid: its cells; `emitted` is the pattern of transmitter and receiver, times the solid angle (sr).
        directivity: of the receiver, as a ratio.
    """

    def __init__(self, width: float, side: int) -> None:
        """Lay out the rays.

        Args:
            width: angle between half-power points of transmitter and receiver each, rad.
            side: square root of the number of rays.
        """
        self.grid = Grid.of(FLANKS * width, FLANKS * width, side, side)
        along = two_way(self.grid.elevation, width) * self.grid.areas()
        self.grid.cells["emitted"] = np.outer(along, two_way(self.grid.azimuth, width)).ravel()
        self.directivity = directivity(width, width)


def directivity(width: float, height: float) -> float:
    """Return the directivity of a rectangular aperture, as a ratio: 4 pi over the product of the beam widths (rad)."""
    return 4.0 * math.pi / (width * height)


def _cells(angle: float, count: int) -> tuple[FloatArray, float]:
    """Return the middles of cells and their size, rad."""
    size = angle / count
    middle: FloatArray = np.arange(count, dtype=np.float64)
    return (middle + 0.5) * size - angle / 2.0, size


def _unit(az: FloatArray, el: FloatArray) -> FloatArray:
    result: FloatArray = np.stack((np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=1)
    return result


def _spread(count: int) -> FloatArray:
    """Return (count) evenly spaced places from -1/2 to 1/2, in an order in which neighbours are far apart.

    They are multiples, modulo 1, of a step close to the golden ratio that has no common divisor with `count`.
    """
    by = max(1, round(count * GOLDEN))
    while math.gcd(by, count) > 1:
        by += 1
    result: FloatArray = (np.arange(count) * by % count + 0.5) / count - 0.5
    return result


def two_way(angle: FloatArray, width: float) -> FloatArray:
    """Return the two-way power pattern of a line array at angles off its axis (rad); `width`: between half-power points, rad."""
    result: FloatArray = np.sinc(2.0 * 0.442946 * angle / width) ** 4
    return result


def _two_way(count: int, size: float, width: float) -> FloatArray:
    """Return the pattern in 2 FINEST steps a cell, for `count` cells of this size (rad)."""
    return two_way((np.arange(2 * FINEST * count + 1) / (2 * FINEST) - 0.5 * count) * size, width)
