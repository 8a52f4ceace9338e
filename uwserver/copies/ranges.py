"""Threads of a batch: copies know nothing of each other, so that ranges of them are stepped side by side."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.team import cores
from uwserver.ports import Refused

MOST_THREADS = 16
LEAST_COPIES = 128
"""With fewer the loops of a tick take less than two threads need to find each other."""
_MOST_UNASKED = 4


def threads_for(n: int, wanted: int | None) -> int:
    """How many threads step n copies: as many as wanted, else one a core, up to four, where there are copies enough.

    Raises:
        Refused: not 1 to MOST_THREADS.
    """
    if wanted is None:
        return min(cores(), _MOST_UNASKED) if n >= LEAST_COPIES else 1
    if not 1 <= wanted <= MOST_THREADS:
        raise Refused("out_of_range", f"a batch is stepped by 1 to {MOST_THREADS} threads, not {wanted}", "threads")
    return wanted


class Ranges:
    """Has compiled loops run over ranges of copies, which release the interpreter, in so many threads, that of the caller included.

    The others begin with the first loop, and end with `close`, when this is dropped, or with the interpreter. A process that is forked begins
    its own.

    Attributes:
        count: ranges, and threads.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def run(self, which: IntArray, loop: Callable[[IntArray, int], None]) -> None:
        """Call ``loop(part, k)`` for the parts of `which`, part k being that of range k; returns when all are done.

        Raises:
            Exception: what a loop raises; of several the first.
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
            # Whatever happens here: nobody is at work with the arrays when this returns.
            wait(others)
        for other in others:
            other.result()

    def close(self) -> None:
        """End the threads; what is run from now on is run by the caller alone."""
        self.count, pool, self._pool = 1, self._pool, None
        if pool is not None and self._process == os.getpid():
            pool.shutdown()
