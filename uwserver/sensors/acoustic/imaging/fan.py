"""The rays of sonars. A fan or a pencil has cells of equal angles around the axis of a transducer; a swath has columns, of which beams are made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.acoustic.imaging import array
from uwserver.sensors.acoustic.imaging.array import Taper
from uwserver.units import rad

CELL = np.dtype([("direction", "f8", 3), ("across", "f8", 3), ("along", "f8", 3), ("emitted", "f8")])
"""A cell of a fan: unit direction of its middle in the frame of the fan; unit vectors towards growing azimuth and elevation, times the angles that
the cell covers; and the intensity that goes into it, times its solid angle."""
FINEST = 32
"""Largest number of parts into which a cell is cut, across or along."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
FLANKS = 2.0
"""Rays fill so many beam widths: at their edge the two-way pattern is 36 dB down."""
_MARGIN = 2.0
"""Width of the margins beside the field in which the transmitter fades, in beam widths. The outer beams hear what lies there."""
_PER_BEAM = 3.0
"""Columns in a beam's half-power width. The pattern can tell two apart; with three, a point between two columns is 7 % wider."""
_BOTH_SIDES = 0.995 * math.pi
_MOST_RAYS = 1 << 18
_MOST_PAIRS = 1 << 22
"""Largest number of pairs of a beam and a column: pattern and power then take 16 MB each, and half a second to make."""
_TOGETHER = 2
"""All modes of a device together may have so many times more: they then take some 130 MB, and a second to make."""
_RAY_S, _BEAM_S, _GATE_S = 1.5e-7, 9e-11, 7e-9
"""Processor time on a common machine, s: of a ray over 100 000 triangles, of a column in a gate of a beam, of a gate of a beam or column."""
COLUMNS = 4
"""Columns of each side of `Sides`, over two beam widths: two within the half-power width. Their sum must be a multiple of four (`form_beams`)."""
_LEVEL = math.tan(rad(2.0))
"""Slope around which steps change from equal ratios of slopes to equal slopes."""
_LOWEST, _HIGHEST = rad(89.5), rad(80.0)
_ABOVE = 4
"""Ratio of the rows that look down to those that look up."""


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
        columns, rows: those of cells.
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
        directivity: directivity of the receiver, as a ratio.
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


def cost(columns: int, rows: int, beams: int, gates: int, heard: int | None = None) -> float:
    """Return about the processor time of a picture, s. `heard`: columns that each beam is made of; by default all."""
    summed = _BEAM_S * (columns if heard is None else heard) * beams * gates
    return _RAY_S * columns * rows + summed + _GATE_S * (columns + beams) * gates


def columns_of(field: float, width: float) -> int:
    """Return the number of columns of a swath; `field`, `width`: rad."""
    over = min(field + 2.0 * _MARGIN * width, _BOTH_SIDES)
    return 4 * math.ceil(0.25 * _PER_BEAM * over / width)


def check_size(columns: int, rows: int, beams: int, keys: str, where: str = "") -> None:
    """Raise ValueError if a ping would have too many rays, or too many pairs of a column and a beam.

    Args:
        columns, rows: numbers of columns of rays, and of rays in a column.
        beams: number of beams.
        keys: what to change in the table to have fewer rays.
        where: appended to what there is too much of.
    """
    if columns * rows > _MOST_RAYS:
        raise ValueError(f"{columns * rows} rays a ping{where} are more than {_MOST_RAYS}: {keys} need fewer")
    if columns * beams > _MOST_PAIRS:
        text = f"{beams} beams of {columns} columns of rays{where} are {columns * beams} pairs, more than {_MOST_PAIRS}"
        raise ValueError(f"{text}: wider beams, a smaller field or fewer beams make fewer")


def check_together(sizes: Sequence[tuple[int, int, int]], keys: str) -> None:
    """Raise ValueError if all swaths of a device, which it keeps, are too large together; `sizes`: columns, rows and beams of each."""
    rays, pairs = (_TOGETHER * most for most in (_MOST_RAYS, _MOST_PAIRS))
    found = sum(columns * rows for columns, rows, _ in sizes), sum(columns * beams for columns, _, beams in sizes)
    for count, most, what in zip(found, (rays, pairs), ("rays a ping", "pairs of a beam and a column"), strict=True):
        if count > most:
            raise ValueError(f"{len(sizes)} modes have {count} {what} together, more than {most}: {keys} have fewer")


Plane = npt.NDArray[np.float32]


class Swath:
    """Rays around the x axis of a transducer, and beams.

    Attributes:
        columns, rows: those of the rays.
        grid: their cells; `emitted` is the pattern of transmitter and receiver without that of the array, times the solid angle (sr).
        column: (n) number of each ray's column.
        azimuth: (beams) rad, from x towards y.
        pattern, power: (beams, columns) float32, part of a column's amplitude and power that a beam hears.
        directivity: directivity of a beam, as a ratio.
        aperture: length of the array, wavelengths; `Sides` have none.
    """

    def __init__(
        self, field: float, width: float, height: float, beams: int, rows: int, taper: Taper = "hamming"
    ) -> None:
        """Lay out the rays and beams.

        Args:
            field: angle that the beams cover, rad.
            width, height: angles between half-power points of a beam, rad; in elevation of transmitter and receiver each.
            beams, rows: numbers of beams, and of rays in a column.
            taper: taper of the array.
        """
        margin = _MARGIN * width
        over = min(field + 2.0 * margin, _BOTH_SIDES)
        self.columns, self.rows = columns_of(field, width), rows
        self.grid = Grid.of(over, FLANKS * height, self.columns, rows)
        beside = np.maximum(np.abs(self.grid.azimuth) - 0.5 * field, 0.0) / margin
        across = np.where(beside < 1.0, np.cos(0.5 * math.pi * np.minimum(beside, 1.0)) ** 2, 0.0)
        along = two_way(self.grid.elevation, height) * self.grid.areas()
        self.grid.cells["emitted"] = np.outer(along, across).ravel()
        self.column: IntArray = np.tile(np.arange(self.columns), rows)
        self.azimuth: FloatArray = ((np.arange(beams) + 0.5) / beams - 0.5) * field
        elements = array.elements(taper, width)
        self.pattern: Plane = array.pattern(taper, elements, self.azimuth, self.grid.azimuth)
        self.power: Plane = self.pattern**2
        self.directivity = directivity(width, height)
        self.aperture = 0.5 * elements


def rows_above(rows: int) -> int:
    """Return the number of rows that look up, beside so many that look down."""
    return max(rows // _ABOVE, 1)


def depressions(rows: int) -> FloatArray:
    """Return the edges (n + 1) of the rows from above to below the horizon, rad below it; `rows`: number of rows below it.

    A ray with depression a hits a level bottom h below at the distance h / tan a, so equal steps of log tan a are equal parts of the distance. Near
    the horizon, where these steps would never end, they are equal angles.
    """
    low, high = math.asinh(math.tan(_LOWEST) / _LEVEL), math.asinh(math.tan(_HIGHEST) / _LEVEL)
    below = np.linspace(0.0, low, rows + 1)
    above = np.linspace(-high, 0.0, rows_above(rows) + 1)[:-1]
    result: FloatArray = np.arctan(_LEVEL * np.sinh(np.concatenate([above, below])))
    return result


class Sides(Swath):
    """Rays and beams to port (beam 0) and starboard (beam 1) of a vehicle; each is narrow along the track and tall across it.

    The frame has x ahead, y starboard and z down. Each side hears only its own rays. Both patterns are those of line arrays that send and receive;
    there is no separate transmitter.
    """

    def __init__(self, width: float, height: float, tilt: float, rows: int) -> None:
        """Lay out the rays.

        Args:
            width: angle along the track between half-power points, rad.
            height: angle across the track between half-power points, rad.
            tilt: tilt of both axes below the horizon, rad.
            rows: number of rays below the horizon in each column.
        """
        edges = depressions(rows)
        self.columns, self.rows = 2 * COLUMNS, len(edges) - 1
        da = FLANKS * width / COLUMNS
        along_way: FloatArray = np.arange(COLUMNS, dtype=np.float64)
        along_way = (along_way + 0.5 - 0.5 * COLUMNS) * da
        azimuth, side = np.tile(along_way, 2), np.repeat((-1.0, 1.0), COLUMNS)
        middle: FloatArray = 0.5 * (edges[1:] + edges[:-1])
        size: FloatArray = edges[1:] - edges[:-1]
        column, row = (each.ravel() for each in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        # The shift across depends on the row, the shift along on the column; it is the same on both sides.
        off = np.stack((_staggered(row), _staggered(column % COLUMNS)), axis=1)
        cells = np.zeros(len(row), CELL)
        a, d, s = azimuth[column], middle[row], side[column]
        cells["direction"] = _unit_at(a, d, s)
        cells["across"] = da * np.stack((np.cos(a), -np.sin(a) * np.cos(d) * s, -np.sin(a) * np.sin(d)), axis=1)
        along = np.stack((np.zeros(a.shape), -np.cos(a) * np.sin(d) * s, np.cos(a) * np.cos(d)), axis=1)
        cells["along"] = along * size[row, None]
        cells["emitted"] = two_way(d - tilt, height) * da * size[row] * np.cos(a)
        direction = _unit_at(a + da * off[:, 0], d + size[row] * off[:, 1], s)
        place = np.stack((column + 0.5, row + 0.5), axis=1) + off
        self.grid = Grid(cells, direction, place, (da, float(size.mean())), along_way, -middle)
        self.column: IntArray = column
        self.azimuth: FloatArray = np.array((-0.5 * math.pi, 0.5 * math.pi))
        power = np.zeros((2, self.columns))
        power[0, :COLUMNS] = power[1, COLUMNS:] = two_way(along_way, width)
        self.power: Plane = power.astype(np.float32)
        self.pattern: Plane = np.sqrt(power).astype(np.float32)
        self.directivity = directivity(width, height)


def _unit_at(azimuth: FloatArray, depression: FloatArray, side: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) at angles ahead of abeam (around x as of a cone) and below the horizon; side: -1 port, 1 starboard."""
    flat = np.cos(azimuth)
    return np.stack((np.sin(azimuth), flat * np.cos(depression) * side, flat * np.sin(depression)), axis=1)


def _staggered(number: IntArray) -> FloatArray:
    """Return a place from -1/2 to 1/2 for each number; neighbours are far apart."""
    place: FloatArray = number.astype(np.float64)
    return place * GOLDEN % 1.0 - 0.5


def reflected(hits: Hits, chosen: IntArray, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return starts (m, 3) and directions (m, 3) of the chosen rays after what they hit has mirrored them; they start a little off the mirror."""
    normal, d = hits.normal[chosen], direction[chosen]
    normal = np.where(np.einsum("ij,ij->i", normal, d)[:, None] > 0.0, -normal, normal)
    start = origin + hits.distance[chosen, None] * d + 1e-3 * normal
    return start, d - 2.0 * np.einsum("ij,ij->i", d, normal)[:, None] * normal


def unfolded(hits: Hits, chosen: IntArray, second: Hits) -> Hits:
    """Return what rays hit after a mirror, as it seems from their origin: ranges along both parts of the path, and mirrored normals."""
    mirror = hits.normal[chosen]
    normal = second.normal - 2.0 * np.einsum("ij,ij->i", second.normal, mirror)[:, None] * mirror
    return Hits(hits.distance[chosen] + second.distance, normal, second.body, second.material)
