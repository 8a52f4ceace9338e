"""Beams of a line array of hydrophones, half a wavelength apart: taper, size, and pattern with its side lobes."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray

Taper = Literal["none", "cosine", "hamming"]
"""How the elements are weighted; the side lobes are 13.3, 23.0 and 42.7 dB down."""
MOST_ELEMENTS = 4096
_WEIGHTS: dict[Taper, tuple[tuple[float, float], ...]] = {
    "none": ((0.0, 1.0),),
    "cosine": ((1.0, 0.5), (-1.0, 0.5)),
    "hamming": ((0.0, 0.54), (2.0, 0.23), (-2.0, 0.23)),
}
"""Shifts s and amplitudes a of each taper. The weight of an element is the sum of a cos(pi s x), with x from -1/2 to 1/2 over the array."""
_ON_AXIS = 1e-9
_BLOCK = 1 << 18


def response(taper: Taper, elements: int, off: FloatArray) -> FloatArray:
    """Return the amplitude of a beam for sound from off its axis; it is 1 on the axis.

    Args:
        taper, elements: those of the array.
        off: sine of the angle of the sound minus that of the beam, of any shape.
    """
    return _tapered(_untapered, taper, elements, off)


def difference(taper: Taper, elements: int, off: FloatArray) -> FloatArray:
    """Return what the right half of the array hears minus what the left half hears, a quarter of a period late, on the scale of `response`.

    It is 0 on the axis and positive for sound from the right. `response` and this are real and imaginary part of one half alone; the phases of the
    halves are opposite.

    Args:
        taper, elements: those of the array.
        off: as for `response`.
    """
    return _tapered(_odd, taper, elements, off)


def _tapered(of: Callable[[int, FloatArray], FloatArray], taper: Taper, elements: int, off: FloatArray) -> FloatArray:
    """Return the weighted sum of a function of an untapered array, relative to the amplitude on the axis."""
    result: FloatArray = np.zeros(off.shape)
    for shift, amplitude in _WEIGHTS[taper]:
        result += amplitude * of(elements, off + shift / elements)
    result /= sum(a * _untapered(elements, np.array([shift / elements]))[0] for shift, a in _WEIGHTS[taper])
    return result


def _odd(elements: int, off: FloatArray) -> FloatArray:
    """Return the sum over the elements of sin(pi |place| off), with places as in `_untapered` (the conjugate Dirichlet kernel)."""
    half = 0.5 * math.pi * off
    below = np.sin(half)
    near = np.abs(below) < _ON_AXIS
    below[near] = 1.0
    first, second = (
        (0.5 * elements, 0.5 * elements) if elements % 2 == 0 else (0.5 * elements - 0.5, 0.5 * elements + 0.5)
    )
    result: FloatArray = 2.0 * np.sin(first * half) * np.sin(second * half) / below
    result[near] = 0.0
    return result


def _untapered(elements: int, off: FloatArray) -> FloatArray:
    """Return the sum over the elements of cos(pi place off), with places one apart around the middle of the array (the Dirichlet kernel)."""
    lobe = np.round(0.5 * off)  # grating lobes are 2 apart in sine: counted from the nearest one, small sines are exact
    half = 0.5 * math.pi * (off - 2.0 * lobe)
    below = np.sin(half)
    near = np.abs(below) < _ON_AXIS
    below[near] = 1.0
    result: FloatArray = np.sin(elements * half) / below
    result[near] = elements
    return result if elements % 2 else np.where(lobe % 2.0 == 0.0, result, -result)


@cache
def _spread(taper: Taper) -> float:
    """Return the width between half-power points of a large array, in sines, times its number of elements."""
    n = 1000
    low, high = 0.0, 4.0 / n
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if response(taper, n, np.array([middle]))[0] ** 2 > 0.5 else (low, middle)
    return 2.0 * low * n


def elements(taper: Taper, width: float) -> int:
    """Return the number of elements that make a beam of this width (rad) between half-power points ahead; at an angle it is 1 / cos wider."""
    return min(max(2, round(_spread(taper) / (2.0 * math.sin(0.5 * width)))), MOST_ELEMENTS)


def pattern(
    taper: Taper, elements: int, beams: FloatArray, columns: FloatArray, of: Callable[[Taper, int, FloatArray], FloatArray] = response
) -> npt.NDArray[np.float32]:  # fmt: skip
    """Return (beams, columns) float32, the `response` of each beam to each column, or its `difference`; `beams`, `columns`: angles, rad."""
    of_columns, of_beams = np.sin(columns), np.sin(beams)
    result = np.empty((len(beams), len(columns)), np.float32)
    rows = max(_BLOCK // len(columns), 1)
    for first in range(0, len(beams), rows):  # a few MB of double precision at a time
        part = slice(first, first + rows)
        result[part] = of(taper, elements, of_columns[None, :] - of_beams[part, None])
    return result
