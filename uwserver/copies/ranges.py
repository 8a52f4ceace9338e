"""The threads of a batch. Copies do not affect each other, so threads can step ranges of them at the same time."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.team import cores
from uwserver.ports import Refused

MOST_THREADS = 16
LEAST_COPIES = 128
"""With fewer copies, the loops of a tick take less time than two threads need to start together."""
_MOST_UNASKED = 4


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
