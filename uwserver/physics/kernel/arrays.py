"""Names of array types, and memory for arrays: rows joined end to end, numbers shared by threads, and pools of rows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Records = npt.NDArray[np.void]
"""Rows of one of the structured dtypes of `layout`."""

Array = Any
"""An array in compiled code. numba finds its type from the call."""

_LINE = 64
"""Bytes of a cache line, which cores exchange as a whole."""
_LEAST = 16


def shared_numbers(size: int) -> IntArray:
    """Return zeros for several threads, which begin at a cache line."""
    raw = np.zeros(size + _LINE // 8, np.int64)
    first = -(raw.ctypes.data // 8) % (_LINE // 8)
    numbers: IntArray = raw[first : first + size]
    return numbers


def joined(rows: Iterable[Records], dtype: np.dtype[np.void]) -> Records:
    """Return all rows as one new array of this dtype, empty if there are none.

    The rows are copied as bytes: numpy would compare the records field by field first, which takes longer than a tick for a world of vehicles.
    """
    data = b"".join([row.tobytes() for row in rows])
    made: Records = np.empty(len(data) // dtype.itemsize, dtype)
    made.view(np.uint8)[:] = np.frombuffer(data, np.uint8)
    return made


class Pool:
    """Rows of one dtype that grow when needed. Rows that belong together are taken, and given back, as one range. A user keeps the number of the
    first: `rows` is another array after each growth.

    Attributes:
        rows: all rows, also those that are not in use; rows that were never used are zero.
        raw: the same as bytes, for quick copies; also replaced at each growth.
    """

    def __init__(self, dtype: Any, room: int = _LEAST) -> None:
        self.rows: Any = np.zeros(room, dtype)
        self.raw: memoryview = self.rows.view(np.uint8).data
        self._used = 0
        self._free: defaultdict[int, list[int]] = defaultdict(list)

    def take(self, count: int) -> int:
        """Return the number of the first of `count` free rows, all zero. Which rows these are depends only on earlier calls of `take` and
        `give_back`."""
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
        """Move the rows to other memory; `place` returns a copy of an array there."""
        self.rows = place(self.rows)
        self.raw = self.rows.view(np.uint8).data

    def give_back(self, first: int, count: int) -> None:
        """Free rows that were taken together."""
        if count:
            self._free[count].append(first)
