"""One block of memory for everything that the ticks of all copies write, copy after copy.

Worlds that are built one after the other lie scattered among Python's objects. A thousand of them would be stepped at a third of the speed,
as the processor waits for memory pages. Memory in sequence is fetched ahead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

LINE = 64
"""Bytes of a memory line, which the processor fetches together."""

Place = Callable[[Any], Any]
"""Returns a copy of an array in other memory."""


class Memory:
    """The memory of n copies."""

    def __init__(self, n: int, size: int) -> None:
        """Reserve `size` bytes for each of n copies, in whole lines."""
        self._size = size
        raw = np.zeros(n * size + LINE, np.uint8)
        first = -raw.ctypes.data % LINE
        self._bytes = raw[first : first + n * size]

    def of(self, i: int) -> Place:
        """Return a function that places arrays in the memory of copy i, from its beginning. What was there before is lost."""
        free = self._bytes[i * self._size : (i + 1) * self._size]

        def place(array: Any) -> Any:
            nonlocal free
            if array.nbytes > len(free):  # This copy needs more than the others.
                return array.copy()
            there = free[: array.nbytes].view(array.dtype).reshape(array.shape)
            there.reshape(-1).view(np.uint8)[:] = array.reshape(-1).view(np.uint8)
            free = free[lines(array.nbytes) :]
            return there

        return place


def lines(count: int) -> int:
    """Return the bytes of the whole lines that hold `count` bytes."""
    return -(-count // LINE) * LINE
