"""Beams of a line array of hydrophones, half a wavelength apart: taper, size, and pattern with its side lobes."""

from __future__ import annotations

import math
from functools import cache
from typing import Literal

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

Taper = Literal["none", "cosine", "hamming"]
"""How the elements are weighted: side lobes of 13.3, 23.0 and 42.7 dB."""
MOST_ELEMENTS = 4096


def weights(taper: Taper, elements: int) -> FloatArray:
    """(elements) weights, of sum 1."""
    x = (np.arange(elements) + 0.5) / elements
    shape = {
        "none": np.ones(elements),
        "cosine": np.sin(math.pi * x),
        "hamming": 0.54 - 0.46 * np.cos(2.0 * math.pi * x),
    }
    result: FloatArray = shape[taper] / shape[taper].sum()
    return result


def response(weight: FloatArray, off: FloatArray) -> FloatArray:
    """Amplitude of a beam, 1 on its axis, for sound that comes from elsewhere.

    Args:
        weight: (n) of the elements, symmetric.
        off: sine of the angle of the sound minus that of the beam, of any shape.
    """
    half = len(weight) // 2
    place = np.arange(len(weight) - half, len(weight)) - 0.5 * (len(weight) - 1)
    result: FloatArray = np.full(off.shape, weight[half] if len(weight) % 2 else 0.0)
    for x, w in zip(place, weight[len(weight) - half :], strict=True):
        result += 2.0 * w * np.cos(math.pi * x * off)
    return result


@cache
def _spread(taper: Taper) -> float:
    """Width between half-power points of a large array, in sines, times its elements."""
    n = 1000
    weight, low, high = weights(taper, n), 0.0, 4.0 / n
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if response(weight, np.array([middle]))[0] ** 2 > 0.5 else (low, middle)
    return 2.0 * low * n


def elements(taper: Taper, width: float) -> int:
    """So many make a beam of this width (rad) between half-power points, ahead; at an angle it is 1 / cos wider."""
    return min(max(2, round(_spread(taper) / (2.0 * math.sin(0.5 * width)))), MOST_ELEMENTS)


def pattern(weight: FloatArray, beams: FloatArray, columns: FloatArray) -> FloatArray:
    """(beams, columns) amplitude that each beam hears of each column; angles in rad."""
    return response(weight, np.sin(columns)[None, :] - np.sin(beams)[:, None])
