"""The picture that a fan of rays gives: energy of echoes over range, independent of how many rays there are.

A ray stands for a small solid angle. What it hits is taken as flat across that angle, so its echo covers an interval of ranges, not a point:
neither gaps nor moire appear where a bottom is seen at grazing incidence, and the energy stays the same whatever the number of rays.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.geometry import FloatArray, Hits

_LEAST_COSINE = 0.01
"""Of incidence: nothing is so flat that a ray along it meets only one piece."""
_LONGEST = 0.25
"""Largest q of `Fan.incidence`."""


class Fan:
    """Rays about the x axis of a transducer, in cells of equal angles.

    Attributes:
        direction: (n, 3) unit, in the transducer's frame.
        solid_angle: (n) of the cells, sr.
        pattern: (n) two-way beam pattern, as a ratio of intensities: that of a line array in each direction, 1 on the axis.
    """

    def __init__(self, width: float, height: float, columns: int, rows: int, cover: float) -> None:
        """Spread the rays.

        Args:
            width, height: angles between the half-power points, rad.
            columns, rows: number of rays.
            cover: part of these angles that the rays fill; beyond 1 are the flanks of the pattern.
        """
        azimuth, self._da = _cells(cover * width, columns)
        elevation, self._de = _cells(cover * height, rows)
        az, el = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
        self.direction: FloatArray = np.stack((np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), axis=1)
        self._across: FloatArray = np.stack((-np.sin(az), np.cos(az), np.zeros(az.shape)), axis=1)
        self._along: FloatArray = np.stack((-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)), axis=1)
        self._cosine = np.cos(el)
        self.solid_angle: FloatArray = self._da * (
            np.sin(el + self._de / 2) - np.sin(el - self._de / 2)
        )  # exact on the sphere
        one_way = _line_array(az, width) * _line_array(el, height)
        self.pattern: FloatArray = one_way * one_way

    def incidence(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n) cosine of incidence, and (n) the part q by which it changes to the edges of the cell: what a ray meets at range r reaches from
        r / (1 + q) to r / (1 - q). Normals (n, 3) are in the transducer's frame."""
        cosine = np.maximum(np.abs(np.einsum("ij,ij->i", normal, self.direction)), _LEAST_COSINE)
        across = np.einsum("ij,ij->i", normal, self._across) * (self._da * self._cosine)
        along = np.einsum("ij,ij->i", normal, self._along) * self._de
        q = np.minimum(0.5 * np.sqrt(across * across + along * along) / cosine, _LONGEST)
        return cosine, q


def energy_per_bin(start: FloatArray, stop: FloatArray, energy: FloatArray, bins: int) -> FloatArray:
    """(bins) energy of echoes that each spread evenly from start to stop (n, in bins, not negative); what lies behind the last bin is lost."""
    slope = energy / (stop - start)
    edges = np.concatenate((start, stop))
    np.minimum(edges, bins + 1.0, out=edges)
    whole = edges.astype(np.int64)
    part = edges - whole
    slopes = np.concatenate((slope, -slope))
    # The energy before an edge is a ramp: its second difference is two numbers, and one running sum of all of them gives the bins.
    second = np.bincount(whole, slopes * (1.0 - part), bins + 3) + np.bincount(whole + 1, slopes * part, bins + 3)
    result: FloatArray = np.maximum(np.cumsum(second)[:bins], 0.0)
    return result


def dot_products(fan: Fan, hits: Hits, normal: FloatArray, reach: float, bins: int) -> FloatArray:
    """(bins) the picture of the paper (UW-MORSE, section IV-B): the cosine of incidence of each ray, summed over the bin of its range; 1 if
    all rays hit at right angles."""
    found = hits.distance <= reach
    cosine = np.abs(np.einsum("ij,ij->i", normal, fan.direction))[found]
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
