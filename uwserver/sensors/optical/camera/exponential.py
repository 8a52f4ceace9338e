"""A fast exponential, by a table and a short series (compiled). A picture needs ten of them for each pixel."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.deferred import inlined

_FAR = 32.0
"""exp(-32) of any light is nothing, and arguments above 32 are rare."""
_STEPS = 8.0
"""Entries of the table per unit."""
_HALF = int(_FAR * _STEPS)
_TABLE: FloatArray = np.exp((np.arange(2 * _HALF + 1) - _HALF) / _STEPS)


@inlined
def exponential(x: float) -> float:
    """Return exp(x) with a relative error below 1e-8; 0 if x is below -32 or NaN."""
    if not x >= -_FAR:
        return 0.0
    if x > _FAR:
        return math.exp(x)
    k = int(x * _STEPS + (_HALF + 0.5))
    f = x - (k - _HALF) * (1.0 / _STEPS)
    return float(_TABLE[k] * (1.0 + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0))))))
