"""How many threads step a world: as many as its scenario asks for, or two if that is faster on this machine."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter_ns
from typing import Literal

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.team import MOST_THREADS, Team, can_sleep, why_alone

AUTO: Literal["auto"] = "auto"
ThreadCount = Literal["auto"] | int

LEAST_BODIES = 16
"""With fewer bodies no thread is started: the work would be done before another thread is awake."""
BLOCKS = 12
"""Number of blocks of ticks in a trial, with one thread and with all in turn."""
GAIN = 0.97
"""Sharing must take less than this fraction of the time of one thread."""


class Trial:
    """Makes ticks with one thread and with all in turn, until it is known which is faster. The results of the run are the same in both
    cases.

    The blocks are as long as the schedule of the sensors, so that all of them have the same work. Medians are compared, as other processes
    disturb some blocks.
    """

    def __init__(self, team: Team, block: int, now_ns: Callable[[], int]) -> None:
        """Begin a trial of a team, with `block` ticks in each block. `now_ns` gives monotonic wall time."""
        self._team, self._block, self._now_ns = team, block, now_ns
        self._began: int | None = None
        self._spent = self._ticks = 0
        self._spans: list[int] = []

    def begin_tick(self) -> None:
        """Begin a tick."""
        self._began = self._now_ns()

    def end_tick(self) -> bool:
        """End a tick. Returns whether the trial is over; the team then shares the work, or does not."""
        if self._began is None:  # The trial began within this tick.
            return False
        self._spent += self._now_ns() - self._began
        self._ticks += 1
        if self._ticks < self._block:
            return False
        self._spans.append(self._spent)
        self._spent = self._ticks = 0
        self._team.shares = len(self._spans) % 2 == 1
        if len(self._spans) < BLOCKS:
            return False
        # The first block of each kind is a warm-up.
        self._team.shares = median(self._spans[3::2]) < GAIN * median(self._spans[2::2])
        return True


class Threads:
    """The threads of one world.

    Attributes:
        trial: the trial that goes on; None for none.
    """

    def __init__(self, hydro: Hydrodynamics, block: int, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        """Begin with one thread, in the world of these bodies. `block` is the number of ticks after which the work of the sensors repeats."""
        self._hydro, self._block, self._now_ns = hydro, block, now_ns
        self._asked: ThreadCount = 1
        self._team: Team | None = None
        self._tried = 0
        self.trial: Trial | None = None

    @property
    def count(self) -> int:
        """How many threads step the world now."""
        return self._team.size if self._team is not None and self._team.shares else 1

    def use(self, count: ThreadCount) -> None:
        """Step with this number of threads, from 1 to MOST_THREADS, or with two if that is faster (`AUTO`). It takes effect when bodies are
        added."""
        if count != AUTO and not 1 <= count <= MOST_THREADS:
            raise ValueError(f"a world has 1 to {MOST_THREADS} threads, not {count}")
        self.end()
        self._team, self._asked = None, count

    def bodies_changed(self) -> None:
        """Start the threads that pay for this number of bodies. Called after bodies were added or removed, before their arrays are used."""
        hydro, size = self._hydro, self._size()
        if size < 2 or len(hydro) < LEAST_BODIES:
            return
        if self._team is None:
            self._team = Team(size)
            self._team.begin()
        if hydro.team is not self._team.numbers:
            hydro.set_team(self._team.numbers, size)
        if self._asked != AUTO:
            self._team.shares = True
        elif self._tried != len(hydro):
            self._tried, self.trial = len(hydro), Trial(self._team, self._block, self._now_ns)

    def end_tick(self) -> None:
        """End a tick of a trial; the last one ends the trial."""
        if self.trial is not None and self.trial.end_tick():
            self.trial = None

    def _size(self) -> int:
        if self._asked == AUTO:
            return 1 if why_alone() else 2
        return self._asked if can_sleep() else 1

    def end(self) -> None:
        """End the threads and wait for them. From then on one thread steps the world."""
        self._asked, self.trial = 1, None
        if self._team is not None:
            self._team.end()
