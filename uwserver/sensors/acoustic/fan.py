"""A fan of rays: cells of equal angles about the axis of a transducer, and the picture of the paper."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import CELL
from uwserver.physics.rays.raycast import Hits


class Fan:
    """Rays about the x axis of a transducer, in cells of equal angles.

    Attributes:
        direction: (n, 3) unit, in the transducer's frame.
        cells: (n) of CELL; `emitted` is the two-way beam pattern, that of a line array in each direction and 1 on the axis, times the solid
            angle (sr).
    """

    def __init__(self, width: float, height: float, columns: int, rows: int, cover: float) -> None:
        """Spread the rays.

        Args:
            width, height: angles between the half-power points, rad.
            columns, rows: number of rays.
            cover: part of these angles that the rays fill; beyond 1 are the flanks of the pattern.
        """
        azimuth, da = _cells(cover * width, columns)
        elevation, de = _cells(cover * height, rows)
        az, el = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
        self.direction: FloatArray = np.stack((np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=1)
        self.cells = np.empty(len(az), CELL)
        self.cells["direction"] = self.direction
        across = np.stack((-np.sin(az), np.cos(az), np.zeros(az.shape)), axis=1)
        self.cells["across"] = across * (da * np.cos(el))[:, None]
        along = np.stack((-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)), axis=1)
        self.cells["along"] = along * de
        solid_angle = da * (np.sin(el + de / 2) - np.sin(el - de / 2))  # exact on the sphere
        one_way = _line_array(az, width) * _line_array(el, height)
        self.cells["emitted"] = one_way * one_way * solid_angle


def dot_products(fan: Fan, hits: Hits, R: FloatArray, reach: float, bins: int) -> FloatArray:
    """(bins) the picture of the paper (UW-MORSE, section IV-B): the cosine of incidence of each ray, summed over the bin of its range; 1 if
    all rays hit at right angles. R is the attitude of the fan in N."""
    found = hits.distance <= reach
    cosine = np.abs(np.einsum("ij,ij->i", hits.normal @ R, fan.direction))[found]
    place = np.minimum((hits.distance[found] * (bins / reach)).astype(np.int64), bins - 1)
    result: FloatArray = np.bincount(place, cosine, bins) / len(found)
    return result


def _cells(angle: float, count: int) -> tuple[FloatArray, float]:
    size = angle / count
    middle: FloatArray = np.arange(count, dtype=np.float64)
    middle = (middle + 0.5) * size - angle / 2.0
    return middle, size


def _line_array(angle: FloatArray, width: float) -> FloatArray:
    """One-way pattern of a line array with this angle between half-power points."""
    result: FloatArray = np.sinc(2.0 * 0.442946 * angle / width) ** 2
    return result


def directivity(width: float, height: float) -> float:
    """Directivity index of a rectangular aperture, as a ratio: 4 pi over the product of the beam widths (rad)."""
    return 4.0 * math.pi / (width * height)
