"""Arrays that grow: rows that belong together are taken, and given back, as one range."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

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
