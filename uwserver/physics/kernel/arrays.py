"""What arrays are called, in plain code and in compiled code."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
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


def joined(rows: Iterable[Records], dtype: np.dtype[np.void]) -> Records:
    """All rows as one new array of their dtype, which is empty for none.

    As plain bytes: numpy compares records field by field before it joins them, which for a world of vehicles takes longer than a tick.
    """
    data = b"".join([row.tobytes() for row in rows])
    made: Records = np.empty(len(data) // dtype.itemsize, dtype)
    made.view(np.uint8)[:] = np.frombuffer(data, np.uint8)
    return made


_LEAST = 16


class Pool:
    """Rows of one dtype. Who uses some keeps the number of the first: `rows` is another array after each growth.

    Attributes:
        rows: all there are, also those that nobody has; zeros where nobody ever had one.
        raw: the same as bytes, for copies that cost next to nothing; another one after each growth, too.
    """

    def __init__(self, dtype: Any, room: int = _LEAST) -> None:
        self.rows: Any = np.zeros(room, dtype)
        self.raw: memoryview = self.rows.view(np.uint8).data
        self._used = 0
        self._free: defaultdict[int, list[int]] = defaultdict(list)

    def take(self, count: int) -> int:
        """The first of so many rows, all zero. Which ones is decided by what was taken and given back before, and by nothing else."""
        if count and self._free[count]:
            first = self._free[count].pop()
            self.rows[first : first + count] = np.zeros(count, self.rows.dtype)
            return first
        first, self._used = self._used, self._used + count
        if self._used > len(self.rows):
            grown = np.zeros(max(self._used, 2 * len(self.rows)), self.rows.dtype)
            grown[:first] = self.rows[:first]
            self.rows, self.raw = grown, grown.view(np.uint8).data
        return first

    def move(self, place: Callable[[Any], Any]) -> None:
        """Lie elsewhere: `place` gives a copy of an array in other memory."""
        self.rows = place(self.rows)
        self.raw = self.rows.view(np.uint8).data

    def give_back(self, first: int, count: int) -> None:
        """Rows that were taken together and are no longer used."""
        if count:
            self._free[count].append(first)
