"""Threads that share the loops of kernels (`uwserver.physics.kernel.sharing`): how many there are, and when they begin and end."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Sequence

from uwserver.physics.kernel.arrays import IntArray, shared_numbers
from uwserver.physics.kernel.places import FUTEX, SIZE, SPIN, THREADS
from uwserver.physics.kernel.plain import IS_PLAIN

MOST_THREADS = 16

_SPIN = 8000
"""Turns, some 200 us: as long as a world of many bodies takes from one shared loop to the next where nothing paces it. Who sleeps meanwhile is awake
again after 8 us at best and after a millisecond now and then, and half of what sharing gains is lost."""


def _memory() -> IntArray:
    """Numbers of a team."""
    memory = shared_numbers(SIZE)
    memory[THREADS] = 1
    return memory


ALONE = _memory()
"""The team of who shares with nobody."""


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_sleep() -> bool:
    """Whether threads of a team can wait here: they sleep in compiled code, by a system call."""
    return FUTEX != 0


def why_alone() -> str:
    """Why a second thread is of no use here; empty where it may be of some."""
    if IS_PLAIN:
        return "kernels are plain (UWSERVER_KERNELS)"
    if not can_sleep():
        return "threads wait in compiled code on Linux alone (x86-64 and ARM)"
    return "" if cores() > 1 else "this process may use one core"


class Team:
    """Threads of one world. They sleep while nobody shares a loop, and end with the team, with `end`, or with the interpreter.

    A process that is forked has none of them: its team is one thread.

    Attributes:
        size: threads, that of the caller included.
        numbers: what kernels get; it must outlive the tables in which its address stands.
    """

    def __init__(self, size: int) -> None:
        """Of 1 to MOST_THREADS threads; they begin with `begin`."""
        self.size = size
        self.numbers = _memory()
        self.numbers[SPIN] = _SPIN
        self._threads: list[threading.Thread] = []
        self._ended = weakref.finalize(self, _end, self.numbers, self._threads)
        _teams.add(self)

    def begin(self) -> None:
        """Have the threads, asleep until a loop is shared."""
        from uwserver.physics.kernel import sharing

        sharing.load(self.numbers)
        for k in range(len(self._threads) + 1, self.size if self._ended.alive else 1):
            name = f"uwserver-kernels-{k}"
            self._threads.append(threading.Thread(target=sharing.serve, args=(self.numbers, k), name=name, daemon=True))
            self._threads[-1].start()

    @property
    def shares(self) -> bool:
        """Whether loops are shared now."""
        return bool(self.numbers[THREADS] > 1)

    @shares.setter
    def shares(self, shares: bool) -> None:
        self.numbers[THREADS] = len(self._threads) + 1 if shares and self._ended.alive else 1

    def end(self) -> None:
        """Let the threads end, and wait for it; from then on there is one."""
        self._ended()

    def lose(self) -> None:
        """In a forked process: there are no others."""
        self._ended.detach()
        self.numbers[THREADS] = 1


def _end(numbers: IntArray, threads: Sequence[threading.Thread]) -> None:
    numbers[THREADS] = 1
    if threads:
        from uwserver.physics.kernel import sharing

        sharing.stop(numbers)
        for thread in threads:
            thread.join()


_teams: weakref.WeakSet[Team] = weakref.WeakSet()


def _lose_all() -> None:
    for team in _teams:
        team.lose()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_lose_all)
