"""Who has Python's interpreter, of two threads of a server that need it: the one that steps the world as fast as it can, and the loop of its sockets.

Left to the interpreter's lock, a thread that finds it taken falls asleep. It is awake again after tens of microseconds, on a core whose caches others
have used meanwhile: measured, each sleep costs a world of ten vehicles 0.1 ms and more, and a client makes ten of them in a simulated second.
So the two hand the interpreter to each other in compiled code (`giving_way`), and seldom sleep. Nothing depends on it: whoever waits too long takes
the lock as ever.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from time import perf_counter_ns

import numpy as np

from uwserver.physics.kernel.arrays import IntArray, shared_numbers
from uwserver.physics.kernel.places import ASKED, CALLED, LATE, RUNS, WAITED, WATCHED, WAY_SIZE
from uwserver.physics.kernel.straight import straight

MOST_CREDIT_NS = 5_000_000
"""Wall time that the loop may be given in one go, if the world had as much before. Where peers flood it, it is given no more than half of all: beyond
that the interpreter's lock decides, as between any two threads of Python."""
_TURN_NS = 25
"""Of a turn of `giving_way`, about."""
NOBODY = shared_numbers(WAY_SIZE)
"""The right of way of who has no loop beside him: nobody ever asks. Never changed."""
_READABLE = 1 << 32
"""POLLIN as it stands in a ``struct pollfd``, above the descriptor."""


class Wake(threading.Event):
    """What wakes the thread that steps the world, if it waits; and if it makes ticks in compiled code, ends them."""

    def __init__(self, numbers: IntArray) -> None:
        """Of a right of way, whose numbers these are."""
        super().__init__()
        self._numbers = numbers

    def set(self) -> None:
        """Any thread."""
        super().set()
        self._numbers[CALLED] += 1  # of two at once one counts: that is enough


class RightOfWay:
    """Of one server.

    Attributes:
        numbers: what kernels get.
        wake: of the thread that steps the world.
    """

    def __init__(self, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        """Its kernels are then ready; `now_ns`: monotonic wall time."""
        from uwserver.physics.kernel import giving_way

        self.numbers = shared_numbers(WAY_SIZE)
        self.wake = Wake(self.numbers)
        giving_way.load(self.numbers)
        self._await_event, self._send = straight(giving_way.await_event), straight(giving_way.send_aside)
        self._give_way, self._answer = straight(giving_way.give_way), straight(giving_way.answer)
        self.numbers[ASKED] = 1  # the loop has the interpreter
        self._seen = self.numbers.data  # quicker to look at than the array
        self._runs = False
        self._now_ns, self._credit_ns, self._since_ns = now_ns, MOST_CREDIT_NS, now_ns()

    # -- the thread that steps the world ----------------------------------------------------------------------------------------

    def give(self) -> None:
        """Between two ticks that nothing paces: let the loop do what it has to do, if anything. Where it keeps the interpreter for long, or has had
        it for longer than the world, the next ticks do not wait for it."""
        self._begin()
        asked = self._seen[ASKED]
        if not asked & 1 or asked == self._seen[LATE]:
            return
        now_ns = self._earn()
        if self._credit_ns > 0:
            late = self._give_way(self.numbers)
            if late:
                self.numbers[LATE] = late
            self._since_ns = self._now_ns()
            self._credit_ns -= self._since_ns - now_ns

    def lend(self) -> IntArray:
        """Before ticks in compiled code, which do not need the interpreter: by what they get here, the loop has it meanwhile. `get_back` follows."""
        self._begin()
        if self._credit_ns <= 0:
            self._earn()
        return self.numbers if self._credit_ns > 0 else NOBODY

    def get_back(self) -> None:
        """These ticks are over. Time for which the world stood, as the loop still had the interpreter, counts as given."""
        if self._seen[WAITED]:
            waited_ns = self._seen[WAITED] * _TURN_NS
            self.numbers[WAITED] = 0
            self._earn()
            self._credit_ns -= 2 * waited_ns  # of which the world had none

    def _begin(self) -> None:
        if not self._runs:
            self._runs = True
            self.numbers[RUNS] = 1

    def _earn(self) -> int:
        """The world had the time since it was looked at last. Returns the time now, ns."""
        now_ns = self._now_ns()
        self._credit_ns = min(MOST_CREDIT_NS, self._credit_ns + now_ns - self._since_ns)
        self._since_ns = now_ns
        return now_ns

    def rest(self) -> None:
        """No such tick follows for now: the loop has nobody to wait for."""
        if self._runs:
            self._runs = False
            self.numbers[RUNS] = 0

    # -- any thread ---------------------------------------------------------------------------------------------------------------

    def answer(self) -> bool:
        """There is something for the loop. Returns whether it waits for that awake, as for a moment after it has called: to wake it from its sleep
        costs 20 us."""
        return bool(self._answer(self.numbers))

    # -- the loop -----------------------------------------------------------------------------------------------------------------

    def sleep(self, descriptor: int, seconds: float | None) -> None:
        """Wait, without the interpreter, until something can be read of a descriptor, or so long; None: without an end."""
        self.numbers[WATCHED] = descriptor | _READABLE
        self._await_event(self.numbers, -1 if seconds is None else math.ceil(seconds * 1e3))

    def send(self, descriptor: int, data: bytes) -> int:
        """Give a socket what it takes of these bytes at once, meanwhile without the interpreter. Returns how many that were; 0 where it cannot."""
        return max(0, int(self._send(self.numbers, descriptor, np.frombuffer(data, np.uint8))))
