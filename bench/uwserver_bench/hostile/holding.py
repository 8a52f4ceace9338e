"""How long work keeps the other threads of its process waiting: what a tick loses to it, whatever else the machine does meanwhile."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from uwserver.server.life_cycle import SWITCH_INTERVAL_S


class Cost(NamedTuple):
    """Of one piece of work.

    Attributes:
        held_ns: longest time of its thread on the processor between two turns of a thread that always wants the interpreter.
        spent_ns: time of its thread on the processor in all.
    """

    held_ns: int
    spent_ns: int


class Rival:
    """A thread that wants the interpreter all the time, as the simulation does in a late tick. It counts by the processor time of the thread
    that made it, so that other processes do not matter. Python is interrupted as in a server; what is compiled is not."""

    def __init__(self) -> None:
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._most = 0
        self._is_over = False
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="rival", daemon=True)
        self._before = sys.getswitchinterval()

    def __enter__(self) -> Rival:
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        gc.collect()  # as the server does: what this process is made of is none of a message's cost
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
        """Do some work, and tell what it took."""
        self._let_in()
        self._most = 0
        start = time.thread_time_ns()
        try:
            work()
        finally:
            spent = time.thread_time_ns() - start
            self._let_in()
        return Cost(min(self._most, spent), spent)
