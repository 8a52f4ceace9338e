"""What arrays are called, in plain code and in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Records = npt.NDArray[np.void]
"""Rows of a structured dtype of `layout`."""

Array = Any
"""An array inside compiled code, whose type numba finds from the call."""

_LINE = 64
"""Bytes that go from core to core together."""


def shared_numbers(size: int) -> IntArray:
    """Zeros for several threads, from the beginning of a cache line on."""
    raw = np.zeros(size + _LINE // 8, np.int64)
    first = -(raw.ctypes.data // 8) % (_LINE // 8)
    numbers: IntArray = raw[first : first + size]
    return numbers
