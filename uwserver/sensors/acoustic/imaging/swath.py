"""A swath: the rays of an imaging sonar in columns, and the beams that its array makes of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.acoustic.imaging import array
from uwserver.sensors.acoustic.imaging.array import Taper
from uwserver.sensors.acoustic.imaging.fan import Grid, two_way

FLANKS = 2.0
"""Rays fill so many beam widths over elevation: at their edge the two-way pattern is 36 dB down."""
_MARGIN = 2.0
"""Beam widths beside the field, in which the transmitter fades: what lies there is heard by the outer beams."""
_PER_BEAM = 3.0
"""Columns in a beam's half-power width: two are what its pattern can tell apart; of three a point between two is 7 % wider."""
_BOTH_SIDES = 0.995 * math.pi
_MOST_RAYS = 1 << 18
_MOST_PAIRS = 1 << 22
"""Of a beam and a column: their patterns are 16 MB each, and made in half a second."""
_TOGETHER = 2
"""So many times as many have all modes of a device together: they take some 130 MB, and a second to make."""

_RAY_S, _BEAM_S, _GATE_S = 1.5e-7, 9e-11, 7e-9
"""What a picture costs on one core of a common machine: a ray over 100 000 triangles, a column in a gate of a beam, a gate of a beam or column."""


def cost(columns: int, rows: int, beams: int, gates: int, heard: int | None = None) -> float:
    """About the processor time (s) of a picture, each beam of which is made of so many columns; default: of all."""
    summed = _BEAM_S * (columns if heard is None else heard) * beams * gates
    return _RAY_S * columns * rows + summed + _GATE_S * (columns + beams) * gates


def columns_of(field: float, width: float) -> int:
    """How many columns a swath has; angles in rad."""
    over = min(field + 2.0 * _MARGIN * width, _BOTH_SIDES)
    return 4 * math.ceil(0.25 * _PER_BEAM * over / width)


def check_size(columns: int, rows: int, beams: int, keys: str, where: str = "") -> None:
    """ValueError where a ping would have too many rays, or too many columns for its beams.

    Args:
        columns, rows: of rays.
        beams: of the array.
        keys: of the table that make fewer rays.
        where: follows what is too many.
    """
    if columns * rows > _MOST_RAYS:
        raise ValueError(f"{columns * rows} rays a ping{where} are more than {_MOST_RAYS}: {keys} need fewer")
    if columns * beams > _MOST_PAIRS:
        text = f"{beams} beams of {columns} columns of rays{where} are {columns * beams} pairs, more than {_MOST_PAIRS}"
        raise ValueError(f"{text}: wider beams, a smaller field or fewer beams make fewer")


def check_together(sizes: Sequence[tuple[int, int, int]], keys: str) -> None:
    """ValueError where swaths of one device, each of so many columns, rows and beams, are too large together: all are kept."""
    rays, pairs = (_TOGETHER * most for most in (_MOST_RAYS, _MOST_PAIRS))
    found = sum(columns * rows for columns, rows, _ in sizes), sum(columns * beams for columns, _, beams in sizes)
    for count, most, what in zip(found, (rays, pairs), ("rays a ping", "pairs of a beam and a column"), strict=True):
        if count > most:
            raise ValueError(f"{len(sizes)} modes have {count} {what} together, more than {most}: {keys} have fewer")


Plane = npt.NDArray[np.float32]


class Swath:
    """Rays about the x axis of a transducer, and beams.

    Attributes:
        columns, rows: of the rays.
        grid: their cells; `emitted` is the pattern of transmitter and receiver but for the array's, times the solid angle (sr).
        column: (n) of each ray.
        azimuth: (beams) rad, from x towards y.
        pattern, power: (beams, columns) float32, amplitude and power that a beam hears of a column.
        directivity: of a beam, as a ratio.
        aperture: length of the array, wavelengths.
    """

    def __init__(
        self, field: float, width: float, height: float, beams: int, rows: int, taper: Taper = "hamming"
    ) -> None:
        """Lay out rays and beams.

        Args:
            field: angle that the beams cover, rad.
            width, height: angles between half-power points of a beam, rad; each of transmitter and receiver over elevation.
            beams, rows: numbers of beams, and of rays in a column.
            taper: of the array.
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
        self.directivity = 4.0 * math.pi / (width * height)
        self.aperture = 0.5 * elements


def reflected(hits: Hits, chosen: IntArray, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the chosen rays of one origin (3) go on from what they hit, as from a mirror: starts (m, 3), a little off it, and directions."""
    normal, d = hits.normal[chosen], direction[chosen]
    normal = np.where(np.einsum("ij,ij->i", normal, d)[:, None] > 0.0, -normal, normal)
    start = origin + hits.distance[chosen, None] * d + 1e-3 * normal
    return start, d - 2.0 * np.einsum("ij,ij->i", d, normal)[:, None] * normal


def unfolded(hits: Hits, chosen: IntArray, second: Hits) -> Hits:
    """What rays met after the mirror as their first part would have met it straight on: ranges along both parts, normals mirrored."""
    mirror = hits.normal[chosen]
    normal = second.normal - 2.0 * np.einsum("ij,ij->i", second.normal, mirror)[:, None] * mirror
    return Hits(hits.distance[chosen] + second.distance, normal, second.body, second.material)
