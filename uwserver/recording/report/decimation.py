"""Reduces samples to the points that a screen can show: the smallest and the largest number of each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwserver.recording.report.columns import FloatArray
from uwserver.recording.report.reading import IntArray

PIXELS = 900
"""Width of a plot; twice as many points are kept."""


@dataclass(frozen=True)
class Decimated:
    """The points that are kept.

    Attributes:
        t: (m) s, never decreasing.
        y: (m, k).
    """

    t: FloatArray
    y: FloatArray


def decimated(t: FloatArray, y: FloatArray, pixels: int = PIXELS) -> Decimated:
    """Reduce samples y (n, k) at t (n, ascending) to at most two rows per pixel: the extremes of each column, in the order in which they came.

    No peak is lost. A column without a number in a pixel has none there afterwards.
    """
    if len(t) <= 2 * pixels:
        return Decimated(t, y)
    edges = np.linspace(t[0], t[-1], pixels + 1)[1:-1]
    starts = np.concatenate([[0], np.searchsorted(t, edges)])
    ends = np.append(starts[1:], len(t))
    filled = ends > starts
    starts, ends = starts[filled], ends[filled]
    low = np.fmin.reduceat(y, starts, axis=0)
    high = np.fmax.reduceat(y, starts, axis=0)
    rising = _first_of(y, starts, ends, high) >= _first_of(y, starts, ends, low)
    pair = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1)
    middle = 0.5 * (t[starts] + t[ends - 1])
    times = np.stack([t[starts], np.maximum(middle, t[starts])], axis=1)
    return Decimated(times.reshape(-1), pair.reshape(-1, y.shape[1]))


def _first_of(y: FloatArray, starts: IntArray, ends: IntArray, value: FloatArray) -> FloatArray:
    """Return the index (pixels, k) at which each column first has this value in each pixel."""
    pixel = np.repeat(np.arange(len(starts)), ends - starts)
    number = np.arange(len(y), dtype=float)[:, None]
    places = np.where(y == value[pixel], number, np.inf)
    return np.minimum.reduceat(places, starts, axis=0)
