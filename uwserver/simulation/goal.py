"""Steps and runs that are under way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from uwserver.ports import OnReply, Progress, Refused, Reply
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Time
from uwserver.simulation.steering import Steering
from uwserver.units import NANOSECONDS
from uwserver.world.world import World

_PROGRESS_NS = NANOSECONDS // 10


@dataclass(eq=False)
class Goal:
    """A long-running request to reach a tick.

    Attributes:
        tick, start: that, and where it began.
        on_reply: gets progress, and the answer.
        pause_there: it is a part of a pause, which goes on behind it.
        paced: at the pace of the clock; else as fast as can be.
    """

    tick: int
    start: int
    on_reply: OnReply
    pause_there: bool
    paced: bool


class Goals:
    """Those of a simulation, the nearest first. Simulation thread."""

    def __init__(self, world: World, bus: Bus, time: Time, pause: Callable[[], None]) -> None:
        """Of a world.

        Args:
            world, bus, time: of the simulation.
            pause: called where one is reached behind which a pause goes on.
        """
        self._world, self._bus, self._time, self._pause = world, bus, time, pause
        self._goals: list[Goal] = []
        self._next_progress = 0

    def __len__(self) -> int:
        return len(self._goals)

    def __iter__(self) -> Iterator[Goal]:
        return iter(self._goals)

    @property
    def hurries(self) -> bool:
        """Whether the nearest one is to be reached as fast as can be."""
        return bool(self._goals) and not self._goals[0].paced

    def request(
        self, make: Callable[[], Goal], on_reply: OnReply, steering: Steering, source: str
    ) -> Callable[[], bool]:
        """Begin one between two ticks. Any thread.

        Args:
            make: makes it there, or raises Refused.
            on_reply: gets its answers.
            steering: carries that out.
            source: who asks.

        Returns its cancel function. May raise as `Turns.put`.
        """
        begun: list[Goal] = []

        def start() -> None:
            try:
                goal = make()
            except Refused as refused:
                self._bus.reply(on_reply, Reply(self._world.tick, self._world.t_ns, fault=refused.fault))
                return
            begun.append(goal)
            self._goals.append(goal)
            self._goals.sort(key=lambda each: each.tick)
            self.check()

        def end() -> None:
            if begun and begun[0] in self._goals:
                self._finish(begun[0], Refused("preempted", "cancelled by the caller"))

        def cancel() -> bool:
            if begun and begun[0] not in self._goals:
                return False
            # One that has not begun yet has when this is carried out: steering keeps its order.
            steering.add(end, source, always=True)
            return True

        steering.add(start, source, on_reply)
        return cancel

    def check(self) -> None:
        """Answer those that are reached, and tell the others now and then how far they have come."""
        tick, now = self._world.tick, self._time.now_ns()
        for goal in self._goals[:]:
            if tick >= goal.tick:
                if goal.pause_there:
                    self._pause()
                self._finish(goal, None)
            elif now >= self._next_progress:
                fraction = (tick - goal.start) / (goal.tick - goal.start)
                self._bus.reply(goal.on_reply, Progress(fraction, self._world.t_ns))
        if now >= self._next_progress:
            self._next_progress = now + _PROGRESS_NS

    def give_up(self, refused: Refused) -> None:
        """None of them is reached any more."""
        for goal in self._goals[:]:
            self._finish(goal, refused)

    def _finish(self, goal: Goal, refused: Refused | None) -> None:
        self._goals.remove(goal)
        fault = None if refused is None else refused.fault
        self._bus.reply(goal.on_reply, Reply(self._world.tick, self._world.t_ns, fault=fault))
