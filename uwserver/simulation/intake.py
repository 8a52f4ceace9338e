"""Hands requests from outside to the world at the start of a tick: in real time as many as there is time for."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from uwserver.ports import Call, Command
from uwserver.ports.crossing import Posted
from uwserver.simulation.clock import Time
from uwserver.simulation.mailbox import FairQueue
from uwserver.units import NANOSECONDS
from uwserver.world.world import World

T = TypeVar("T")

REQUESTS_NS = NANOSECONDS // 1000
"""Wall time per tick for commands and calls, in real time. The rest is carried out in the next ticks. The last request of a tick may exceed
it."""

BEGIN = "begin"
"""Source of the call by which a run begins from a saved state."""


class Observer(Protocol):
    """Follows a run on the simulation thread; must be quick. A recorder is one."""

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        """Take a command or call that is carried out at the start of `tick`, with the others of its batch; also one that the world then
        refuses."""

    def ticked(self, world: World) -> None:
        """Take a finished tick; the world stands between two ticks."""

    def next_tick(self, tick: int) -> int:
        """Return the tick until which it need not get the ticks after this one in which no request is carried out."""


class Intake:
    """Takes the posted requests, and shows them to an observer. Simulation thread.

    Attributes:
        observer: follows the run.
        batch: numbers the groups of requests that are carried out together.
    """

    def __init__(self, world: World, posted: FairQueue[Posted], time: Time, stop: threading.Event) -> None:
        """Begin without an observer.

        Args:
            world: carries out the requests.
            posted: the waiting requests.
            time: measures the budget.
            stop: when it is set, only the present request is finished: thousands of requests that rebuild the world would take minutes.
        """
        self.observer: Observer | None = None
        self.batch = 0
        self._world = world
        self._posted = posted
        self._time = time
        self._stop = stop

    def submit(self, posted: Posted) -> None:
        """Post a request to the world itself, before the waiting ones."""
        self._observe(posted, self._world.tick)
        self._world.post(posted)

    def ticked(self) -> None:
        """Show the observer that a tick is done."""
        if self.observer is not None:
            self.observer.ticked(self._world)

    def for_tick(self, is_paced: bool) -> Iterable[Posted]:
        """Return the requests for a tick, as `requests`. In real time, readings under computation that would be late are dropped first, as
        the tick must not wait for them."""
        world = self._world
        if is_paced and not world.sensing.pending_jobs.is_idle:
            tick = world.tick + 1
            for call in world.sensing.pending_jobs.late(tick, world.ticks.time_of(tick)):
                self.submit(Posted(call, None))
        return self.requests(is_paced)

    def requests(self, is_paced: bool) -> Iterable[Posted]:
        """Return the requests that the world carries out now. Each one is taken when the one before is done.

        Args:
            is_paced: whether the wall clock sets the pace. Then a budget holds, and a request that rebuilds the world (such as reset,
                restore, load and spawn) is the last one. Otherwise all waiting requests are taken, as their order and tick must not depend
                on the clock.
        """
        return self._requests(is_paced) if len(self._posted) else ()

    def _requests(self, is_paced: bool) -> Iterator[Posted]:
        world = self._world
        tick, jumps, services = world.tick, world.jumps, world.services
        for posted in self.within(REQUESTS_NS if is_paced else None, self._posted):
            self._observe(posted, tick)
            yield posted
            if self._stop.is_set():
                return
            if is_paced and (world.jumps != jumps or world.services is not services):
                return

    def within(self, budget_ns: int | None, queue: FairQueue[T]) -> Iterator[T]:
        """Yield waiting items, until the budget (ns of wall time, None for no limit) is used up."""
        end = None if budget_ns is None else self._time.now_ns() + budget_ns
        for _ in range(len(queue)):  # what comes meanwhile waits for the next tick
            item = queue.take()
            if item is None:
                return
            yield item
            if end is not None and self._time.now_ns() >= end:
                return

    def _observe(self, posted: Posted, tick: int) -> None:
        if self.observer is not None:
            self.observer.requested(posted.item, tick, self.batch)
