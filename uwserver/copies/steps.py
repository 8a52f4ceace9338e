"""The steps of all copies: the addresses of their arrays, the Python work at their stops, and the threads.

Copies do not affect each other, so threads can step ranges of them at the same time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Any

import numpy as np

from uwserver.copies.copy import Copy
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import IntArray, Records
from uwserver.physics.kernel.team import cores
from uwserver.ports import Refused
from uwserver.step import rows
from uwserver.world.stepping.stepping import QUIET

MOST_THREADS = 16
LEAST_COPIES = 128
"""With fewer copies, the loops of a tick take less time than two threads need to start together."""
_MOST_UNASKED = 4


class Steps:
    """Steps n copies.

    Attributes:
        rows: (n) of `step.rows.COPY`.
        lost: (n) row of the body that diverged, -1 for none.
        ranges: the threads.
    """

    def __init__(self, copies: Sequence[Copy], threads: int) -> None:
        """Take the copies, which may be replaced later. Each thread has a work space of its own."""
        from uwserver.step import many

        many.load()
        self.kernels: Any = many
        self._code, self._copies, self.ranges = many.code(), copies, Ranges(threads)
        self.rows: Records = np.zeros(len(copies), rows.COPY)
        self.lost: IntArray = np.full(len(copies), -1, np.int64)
        self._scratch: Records = np.zeros(threads, layout.SCRATCH)

    @property
    def ticks(self) -> IntArray:
        """(n) ticks of each copy since its start."""
        return np.array(self.rows["tick"], np.int64)

    def find(self, i: int) -> None:
        """Find the arrays and the tick of a copy again."""
        self.rows[i] = self._copies[i].row

    def why(self, i: int) -> int:
        """Return the reason for which a copy has stopped."""
        return int(self.rows["why"][i])

    def carry(self, which: IntArray, ticks: int) -> list[int]:
        """Let copies make `ticks` ticks, or fewer if they have events. Between the calls, the Python work of all stopped copies is done.
        Returns the copies that may have events."""
        told: set[int] = set()
        try:
            while len(which):
                self.ranges.run(which, partial(self._step, ticks=ticks))
                ticks = 0
                stopped = which[self.rows["why"][which] != rows.DONE].tolist()
                told.update(i for i in stopped if self.why(i) not in QUIET)
                which = np.array([i for i in stopped if self._goes_on(i)], np.int64)
        except BaseException:
            # Also after Ctrl-C: the rest of these ticks is not made, as in a single world that is interrupted.
            for i in which.tolist():
                self._copies[i].world.stepping.end(rows.DONE)
                self._copies[i].begin()
                self.find(i)
            raise
        return sorted(told)

    def _step(self, which: IntArray, me: int, ticks: int) -> None:
        """Step a range of copies in thread `me`."""
        scratch = self._scratch[me : me + 1].ctypes.data
        self.kernels.step_each(which, self.rows, self._code, ticks, rows.NOTHING_POSTED, scratch)

    def _goes_on(self, i: int) -> bool:
        """Do the Python work for which a step of a copy has stopped within a tick. Returns whether the step is to go on."""
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


# -- threads ----------------------------------------------------------------------------------------------------------------------------


def threads_for(n: int, wanted: int | None) -> int:
    """Return the number of threads for n copies: the wanted number, else one for each core, up to four, if there are enough copies.

    Raises:
        Refused: not 1 to MOST_THREADS.
    """
    if wanted is None:
        return min(cores(), _MOST_UNASKED) if n >= LEAST_COPIES else 1
    if not 1 <= wanted <= MOST_THREADS:
        raise Refused("out_of_range", f"a batch is stepped by 1 to {MOST_THREADS} threads, not {wanted}", "threads")
    return wanted


class Ranges:
    """Runs compiled loops, which release the interpreter lock, over ranges of copies, in `count` threads, that of the caller included.

    The other threads start with the first loop. They end with `close`, when this object is dropped, or with the interpreter. A forked
    process starts its own.

    Attributes:
        count: number of ranges, and of threads.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def run(self, which: IntArray, loop: Callable[[IntArray, int], None]) -> None:
        """Call ``loop(part, k)`` for the parts of `which`, where part k is that of range k. Returns when all are done.

        Raises:
            Exception: the error of a loop; of several errors the first.
        """
        if self.count == 1 or len(which) < 2:
            loop(which, 0)
            return
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(self.count - 1, "uwserver-copies"), os.getpid()
        size = -(-len(which) // self.count)
        firsts = range(size, len(which), size)
        others = [self._pool.submit(loop, which[f : f + size], k) for k, f in enumerate(firsts, start=1)]
        try:
            loop(which[:size], 0)
        finally:
            # After an error, too, no thread may work on the arrays when this method returns.
            wait(others)
        for other in others:
            other.result()

    def close(self) -> None:
        """End the threads. From now on the caller runs all loops alone."""
        self.count, pool, self._pool = 1, self._pool, None
        if pool is not None and self._process == os.getpid():
            pool.shutdown()
