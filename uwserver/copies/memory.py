"""One stretch of memory for what ticks of all copies write, that of each copy side by side.

Built one after the other, worlds lie scattered among the objects of Python: a thousand of them are then stepped at a third of the pace, as the
processor waits for a page here and a line there. What lies in a row it fetches ahead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

LINE = 64
"""Bytes that come from memory together."""

Place = Callable[[Any], Any]
"""Gives a copy of an array in other memory."""


class Memory:
    """Of n copies."""

    def __init__(self, n: int, size: int) -> None:
        """With so many bytes for each, in whole lines."""
        self._size = size
        raw = np.zeros(n * size + LINE, np.uint8)
        first = -raw.ctypes.data % LINE
        self._bytes = raw[first : first + n * size]

    def of(self, i: int) -> Place:
        """Places of copy i, from the first one on; what is there already is lost."""
        free = self._bytes[i * self._size : (i + 1) * self._size]

        def place(array: Any) -> Any:
            nonlocal free
            if array.nbytes > len(free):  # more than other copies have
                return array.copy()
            there = free[: array.nbytes].view(array.dtype).reshape(array.shape)
            there.reshape(-1).view(np.uint8)[:] = array.reshape(-1).view(np.uint8)
            free = free[lines(array.nbytes) :]
            return there

        return place


def lines(count: int) -> int:
    """Bytes of the lines that so many bytes need."""
    return -(-count // LINE) * LINE
