"""Requests to step or run to a tick, while they are carried out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from uwserver.ports import OnReply, Progress, Refused, Reply
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Time
from uwserver.simulation.mailbox import Steering
from uwserver.units import NANOSECONDS
from uwserver.world.world import World

_PROGRESS_NS = NANOSECONDS // 10


@dataclass(eq=False)
class Goal:
    """A long-running request to reach a tick.

    Attributes:
        tick, start: the tick to reach, and where it began.
        on_reply: gets the progress and the answer.
        pause_there: whether the world is paused, and stays so afterwards.
        paced: whether ticks keep the pace of the clock, or are made as fast as possible.
    """

    tick: int
    start: int
    on_reply: OnReply
    pause_there: bool
    paced: bool


class Goals:
    """The goals of a simulation, the nearest first. Simulation thread."""

    def __init__(self, world: World, bus: Bus, time: Time, pause: Callable[[], None]) -> None:
        """Begin without goals.

        Args:
            world, bus, time: those of the simulation.
            pause: called when a goal is reached after which the world stays paused.
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
        """Whether the nearest goal is to be reached as fast as possible."""
        return bool(self._goals) and not self._goals[0].paced

    def request(
        self, make: Callable[[], Goal], on_reply: OnReply, steering: Steering, source: str
    ) -> Callable[[], bool]:
        """Begin a goal between two ticks. Any thread.

        Args:
            make: makes the goal there, or raises Refused.
            on_reply: gets its answers.
            steering: calls `make` between two ticks.
            source: the client.

        Returns its cancel function. May raise as `FairQueue.put`.
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
            # A goal that has not begun yet will have begun by then, as steering keeps the order of a client.
            steering.add(end, source, always=True)
            return True

        steering.add(start, source, on_reply)
        return cancel

    def check(self) -> None:
        """Answer the goals that are reached, and report progress of the others ten times a second."""
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
        """End all goals with this refusal."""
        for goal in self._goals[:]:
            self._finish(goal, refused)

    def _finish(self, goal: Goal, refused: Refused | None) -> None:
        self._goals.remove(goal)
        fault = None if refused is None else refused.fault
        self._bus.reply(goal.on_reply, Reply(self._world.tick, self._world.t_ns, fault=fault))
