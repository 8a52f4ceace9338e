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
"""Number of turns that a thread spins before it sleeps, some 200 us: as long as a world of many bodies takes from one shared loop to the next at
free-run. A sleeping thread wakes after 8 us at best and sometimes only after a millisecond, so half of what sharing gains would be lost."""


def _memory() -> IntArray:
    """Return the numbers of a team."""
    memory = shared_numbers(SIZE)
    memory[THREADS] = 1
    return memory


ALONE = _memory()
"""The team of a single thread."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_sleep() -> bool:
    """Return whether threads of a team can wait on this machine: they sleep in compiled code, by a system call."""
    return FUTEX != 0


def why_alone() -> str:
    """Return why a second thread is of no use here; empty if it may be of use."""
    if IS_PLAIN:
        return "kernels are plain (UWSERVER_KERNELS)"
    if not can_sleep():
        return "threads wait in compiled code on Linux alone (x86-64 and ARM)"
    return "" if cores() > 1 else "this process may use one core"


class Team:
    """The threads of one world. They sleep while no loop is shared. They end with the team, with `end`, or with the interpreter.

    A forked process has none of these threads: its team is one thread.

    Attributes:
        size: number of threads, including the caller.
        numbers: the array for kernels; it must outlive the tables that contain its address.
    """

    def __init__(self, size: int) -> None:
        """Make a team of 1 to MOST_THREADS threads; `begin` starts them."""
        self.size = size
        self.numbers = _memory()
        self.numbers[SPIN] = _SPIN
        self._threads: list[threading.Thread] = []
        self._ended = weakref.finalize(self, _end, self.numbers, self._threads)
        _teams.add(self)

    def begin(self) -> None:
        """Start the threads. They sleep until a loop is shared."""
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
        """End the threads and wait for them; from then on the caller is alone."""
        self._ended()

    def lose(self) -> None:
        """Forget the threads, in a forked process, where they do not exist."""
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
