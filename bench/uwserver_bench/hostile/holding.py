"""Measures how long work keeps the other threads of its process waiting. A tick loses this time, whatever else the machine does."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from uwserver.server.life_cycle import SWITCH_INTERVAL_S


class Cost(NamedTuple):
    """Cost of one piece of work.

    Attributes:
        held_ns: longest processor time of its thread between two turns of a thread that always waits for the interpreter.
        spent_ns: whole processor time of its thread.
    """

    held_ns: int
    spent_ns: int


class Rival:
    """A thread that always waits for the interpreter, like the simulation in a late tick. It measures the processor time of the thread that made it,
    so that other processes have no effect. As in a server, Python code is interrupted, and compiled code is not."""

    def __init__(self) -> None:
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._most = 0
        self._is_over = False
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="rival", daemon=True)
        self._before = sys.getswitchinterval()

    def __enter__(self) -> Rival:
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        gc.collect()  # as in the server: objects of this process must not count as cost of a message
        gc.freeze()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()
        sys.setswitchinterval(self._before)
        gc.unfreeze()

    def _run(self) -> None:
        last = time.clock_gettime_ns(self._clock)
        while not self._is_over:
            now = time.clock_gettime_ns(self._clock)
            self._most = max(self._most, now - last)
            last = now
            self._turns += 1
            time.sleep(0)

    def _let_in(self) -> None:
        turns = self._turns
        while self._turns < turns + 2:
            time.sleep(0)

    def cost(self, work: Callable[[], object]) -> Cost:
        """Do some work, and return its cost."""
        self._let_in()
        self._most = 0
        start = time.thread_time_ns()
        try:
            work()
        finally:
            spent = time.thread_time_ns() - start
            self._let_in()
        return Cost(min(self._most, spent), spent)
