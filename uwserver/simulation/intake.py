"""What comes from outside, handed to the world at the start of a tick: in real time as much of it as there is time for."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from uwserver.ports import Call, Command
from uwserver.ports.crossing import Posted
from uwserver.simulation.clock import Time
from uwserver.simulation.turns import Turns
from uwserver.units import NANOSECONDS
from uwserver.world.world import World

T = TypeVar("T")

REQUESTS_NS = NANOSECONDS // 1000
"""Wall time a tick for commands and calls, in real time; what does not fit is carried out in the next ticks. The last of a tick may exceed it."""

BEGIN = "begin"
"""Source of the call by which a run begins from a saved state."""


class Observer(Protocol):
    """Follows a run from inside, on the simulation thread; must be quick. A recorder is one."""

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        """A command or call, carried out at the start of `tick` with the others of its batch; also those that the world then refuses."""

    def ticked(self, world: World) -> None:
        """A tick is done; the world stands between two ticks."""

    def next_tick(self, tick: int) -> int:
        """Until which one, after this, nobody need tell it of ticks in which nothing was carried out."""


class Intake:
    """Takes what was posted, and tells an observer. Simulation thread.

    Attributes:
        observer: follows the run.
        batch: counts what was carried out together.
    """

    def __init__(self, world: World, posted: Turns[Posted], time: Time, stop: threading.Event) -> None:
        """Of a simulation.

        Args:
            world: carries out what is taken.
            posted: what waits.
            time: counts the budget.
            stop: the run ends after the request under way: thousands that rebuild the world take minutes.
        """
        self.observer: Observer | None = None
        self.batch = 0
        self._world = world
        self._posted = posted
        self._time = time
        self._stop = stop

    def submit(self, posted: Posted) -> None:
        """Post something to the world itself, before what is taken."""
        self._observe(posted, self._world.tick)
        self._world.post(posted)

    def ticked(self) -> None:
        """Tell the observer that a tick is done."""
        if self.observer is not None:
            self.observer.ticked(self._world)

    def for_tick(self, is_paced: bool) -> Iterable[Posted]:
        """The same for a tick. Where the wall clock sets the pace it must not wait for readings under computation: the late ones are dropped."""
        world = self._world
        if is_paced and not world.sensing.under_way.is_idle:
            tick = world.tick + 1
            for call in world.sensing.under_way.late(tick, world.ticks.time_of(tick)):
                self.submit(Posted(call, None))
        return self.requests(is_paced)

    def requests(self, is_paced: bool) -> Iterable[Posted]:
        """What the world carries out now, the next when the one before is done.

        Args:
            is_paced: the wall clock sets the pace: a budget holds, and what rebuilds the world (as reset, restore, load and spawn) is the last.
                Else it is all that waits: order and tick must not depend on the clock there.
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

    def within(self, budget_ns: int | None, turns: Turns[T]) -> Iterator[T]:
        """What waited, one by one: until the budget (ns of wall time, None for no end) is used up."""
        end = None if budget_ns is None else self._time.now_ns() + budget_ns
        for _ in range(len(turns)):  # what comes meanwhile has its time in the next tick
            item = turns.take()
            if item is None:
                return
            yield item
            if end is not None and self._time.now_ns() >= end:
                return

    def _observe(self, posted: Posted, tick: int) -> None:
        if self.observer is not None:
            self.observer.requested(posted.item, tick, self.batch)
