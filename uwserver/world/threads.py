"""How many threads step a world: as many as its scenario asks for, or two where that is faster here."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter_ns
from typing import Literal

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.team import MOST_THREADS, Team, can_sleep, why_alone

AUTO: Literal["auto"] = "auto"
Wanted = Literal["auto"] | int

LEAST_BODIES = 16
"""With fewer no thread begins: what could be shared is done before another thread is awake."""
BLOCKS = 12
"""Of ticks that a trial lasts, each with one thread or with all, in turn."""
GAIN = 0.97
"""Sharing must take less than this part of the time of one thread."""


class Trial:
    """Ticks with one thread and with all, in turn, until it is known which is faster. The numbers of a run are the same in both.

    Blocks are as long as the schedule of the sensors, so that all hold the same work; medians, as other processes disturb some.
    """

    def __init__(self, team: Team, block: int, now_ns: Callable[[], int]) -> None:
        """A trial of a team, in blocks of so many ticks; `now_ns`: monotonic wall time."""
        self._team, self._block, self._now_ns = team, block, now_ns
        self._began: int | None = None
        self._spent = self._ticks = 0
        self._spans: list[int] = []

    def begin_tick(self) -> None:
        """A tick begins."""
        self._began = self._now_ns()

    def end_tick(self) -> bool:
        """It ends. Returns whether the trial is over; the team then shares, or does not."""
        if self._began is None:  # it was settled within this tick
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
        # The first block of each warms up.
        self._team.shares = median(self._spans[3::2]) < GAIN * median(self._spans[2::2])
        return True


class Threads:
    """The threads of one world.

    Attributes:
        trial: while it is measured whether they pay.
    """

    def __init__(self, hydro: Hydrodynamics, block: int, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        """Of the world of these bodies; `block`: ticks after which sensors have done all that they do."""
        self._hydro, self._block, self._now_ns = hydro, block, now_ns
        self._wanted: Wanted = 1
        self._team: Team | None = None
        self._tried = 0
        self.trial: Trial | None = None

    @property
    def count(self) -> int:
        """How many step the world now."""
        return self._team.size if self._team is not None and self._team.shares else 1

    def want(self, wanted: Wanted) -> None:
        """Step with so many threads, from 1 to MOST_THREADS, or (`AUTO`) with two where that is faster. Bodies come later."""
        if wanted != AUTO and not 1 <= wanted <= MOST_THREADS:
            raise ValueError(f"a world has 1 to {MOST_THREADS} threads, not {wanted}")
        self.end()
        self._team, self._wanted = None, wanted

    def settle(self) -> None:
        """Bodies came or went: begin with what pays for so many, before anything finds the bodies' arrays."""
        hydro, size = self._hydro, self._size()
        if size < 2 or len(hydro) < LEAST_BODIES:
            return
        if self._team is None:
            self._team = Team(size)
            self._team.begin()
        if hydro.team is not self._team.numbers:
            hydro.set_team(self._team.numbers, size)
        if self._wanted != AUTO:
            self._team.shares = True
        elif self._tried != len(hydro):
            self._tried, self.trial = len(hydro), Trial(self._team, self._block, self._now_ns)

    def end_tick(self) -> None:
        """A tick of a trial ends, and with the last one the trial."""
        if self.trial is not None and self.trial.end_tick():
            self.trial = None

    def _size(self) -> int:
        if self._wanted == AUTO:
            return 1 if why_alone() else 2
        return self._wanted if can_sleep() else 1

    def end(self) -> None:
        """Let the threads end, and wait for it; the world is stepped by one from then on."""
        self._wanted, self.trial = 1, None
        if self._team is not None:
            self._team.end()
