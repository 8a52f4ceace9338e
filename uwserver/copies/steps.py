"""The steps of all copies: where each lies, and what Python does where one stops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from uwserver.copies.copy import Copy
from uwserver.copies.ranges import Ranges
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import IntArray, Records
from uwserver.step import rows
from uwserver.world.stepping import QUIET


class Steps:
    """Of n copies.

    Attributes:
        rows: (n) of `step.rows.COPY`.
        lost: (n) row of the body that diverged, -1 for none.
        ranges: of copies, one for each thread.
    """

    def __init__(self, copies: Sequence[Copy], threads: int) -> None:
        """So many threads step them, each with work space of its own. The copies may be replaced."""
        from uwserver.step import many

        many.load()
        self.kernels: Any = many
        self._code, self._copies, self.ranges = many.code(), copies, Ranges(threads)
        self.rows: Records = np.zeros(len(copies), rows.COPY)
        self.lost: IntArray = np.full(len(copies), -1, np.int64)
        self._scratch: Records = np.zeros(threads, layout.SCRATCH)

    @property
    def ticks(self) -> IntArray:
        """(n) ticks of each since its start."""
        ticks: IntArray = self.rows["tick"].copy()
        return ticks

    def find(self, i: int) -> None:
        """Arrays of a copy may lie elsewhere, or it stands at another tick."""
        self.rows[i] = self._copies[i].row

    def why(self, i: int) -> int:
        """A copy has stopped."""
        return int(self.rows["why"][i])

    def carry(self, which: IntArray, ticks: int) -> list[int]:
        """Let copies make so many ticks, or fewer where they have something to tell. What they need of Python is done between the calls, for all that
        have stopped. Returns those that may have something to tell."""
        told: set[int] = set()
        try:
            while len(which):
                self.ranges.run(which, partial(self._step, ticks=ticks))
                ticks = 0
                stopped = which[self.rows["why"][which] != rows.DONE].tolist()
                told.update(i for i in stopped if self.why(i) not in QUIET)
                which = np.array([i for i in stopped if self._goes_on(i)], np.int64)
        except BaseException:  # Ctrl-C too: what is left of these ticks is not made, as where a world is broken off
            for i in which.tolist():
                self._copies[i].world.stepping.end(rows.DONE)
                self._copies[i].begin()
                self.find(i)
            raise
        return sorted(told)

    def _step(self, which: IntArray, me: int, ticks: int) -> None:
        """A range of copies, by the thread `me`."""
        scratch = self._scratch[me : me + 1].ctypes.data
        self.kernels.step_each(which, self.rows, self._code, ticks, rows.NOTHING_POSTED, scratch)

    def _goes_on(self, i: int) -> bool:
        """Do in Python what a step of a copy has stopped for within a tick; whether that is to go on."""
        why, stepping = self.why(i), self._copies[i].world.stepping
        if why == rows.DIVERGED:
            self.lost[i] = stepping.lost
        if why in (rows.DIVERGED, rows.END):
            return False
        try:
            stepping.answer(why)
            if why not in QUIET:
                stepping.ask_again()
        finally:
            self.find(i)
        return True
