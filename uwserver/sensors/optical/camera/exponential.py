"""How light dies away, quickly: exponentials by a table and a short series (compiled). Pictures have ten of them a pixel."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.deferred import inlined

_FAR = 32.0
"""Smaller than exp(-32) is nothing of any light, and larger than exp(32) hardly ever met."""
_STEPS = 8.0
"""Places of the table to one."""
_HALF = int(_FAR * _STEPS)
_TABLE: FloatArray = np.exp((np.arange(2 * _HALF + 1) - _HALF) / _STEPS)


@inlined
def exponential(x: float) -> float:
    """exp(x) within 1e-8 of itself; 0 below exp(-32), and of no number."""
    if not x >= -_FAR:
        return 0.0
    if x > _FAR:
        return math.exp(x)
    k = int(x * _STEPS + (_HALF + 0.5))
    f = x - (k - _HALF) * (1.0 / _STEPS)
    return float(_TABLE[k] * (1.0 + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0))))))
