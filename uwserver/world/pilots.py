"""The autopilots of a world: who hears which sample, and who is due."""

from __future__ import annotations

from collections.abc import Iterable

from uwserver.autopilot.pilot import Autopilot
from uwserver.ports import OnReply, Progress, Reply, Sample
from uwserver.world.components import Member


class Pilots:
    """All autopilots that are in a world. Without any it costs one comparison a tick.

    Attributes:
        all: by vehicle.
    """

    def __init__(self) -> None:
        self.all: dict[str, Autopilot] = {}
        self._ears: dict[str, Autopilot] = {}
        self._gone: list[Autopilot] = []

    def __bool__(self) -> bool:
        """Whether there is anything to do in a tick."""
        return bool(self.all or self._gone)

    def set_members(self, members: Iterable[Member]) -> None:
        """Let the autopilots of these bodies, and no others, fly. A call that waits for one that went is answered."""
        before = self.all
        self.all = {member.vehicle.name: member.autopilot for member in members if member.autopilot is not None}
        for pilot in before.values():
            if pilot not in self.all.values():
                pilot.preempt("the vehicle was taken out of the world")
                self._gone.append(pilot)
        self._ears = {path: pilot for pilot in self.all.values() for path in pilot.craft.estimator.sources}

    def hear(self, samples: Iterable[Sample], t_ns: int) -> None:
        """Samples were delivered."""
        for sample in samples:
            pilot = self._ears.get(sample.port)
            if pilot is not None:
                pilot.take(sample, t_ns)

    def step(self, tick: int, t_ns: int) -> list[tuple[OnReply, Reply | Progress]]:
        """Let those fly that are due; returns `answers`."""
        for pilot in self.all.values():
            if tick % pilot.divisor == 0:
                pilot.step(t_ns)
        return self.answers()

    def answers(self) -> list[tuple[OnReply, Reply | Progress]]:
        """What waiting callers are to be told since the last time."""
        answers = [answer for pilot in (*self.all.values(), *self._gone) for answer in pilot.answers()]
        self._gone.clear()
        return answers

    def end(self, why: str) -> list[tuple[OnReply, Reply | Progress]]:
        """Everybody who still waits gets an answer."""
        for pilot in self.all.values():
            pilot.preempt(why)
        return self.answers()
