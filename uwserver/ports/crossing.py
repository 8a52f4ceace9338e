"""What crosses between the simulation thread and the outside in a tick: requests on their way in, what the tick gives, what comes later."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from uwserver.ports.told import Told
from uwserver.ports.values import Call, Command, Event, Fault, Field, Json, OnReply, Port, Progress, Reply, Sample

Answers = list[tuple[OnReply, Reply | Progress]]
"""Who is to be told what."""


class Posted(Struct):
    """A checked command or call that waits for the start of the next tick; `on_reply` gets the answer.

    `fields` are those against which a command was checked: an actuator that has others by then checks it anew.
    """

    item: Command | Call
    on_reply: OnReply | None
    fields: tuple[Field, ...] = ()


class TickOutput(Struct):
    """What a tick gives to the outside, or some that follow each other.

    Attributes:
        tick, t_ns: where the world stands behind it.
        ticks: how many.
        made: delivered samples.
        told: others, before them, which nobody has looked at yet.
        ports: as they are behind it, those of its samples; None where nobody said.
        jumps: how often the time had been set behind it.
    """

    tick: int
    t_ns: int
    made: list[Sample]
    replies: Answers = []
    events: list[Event] = []
    ports: Mapping[str, Port] | None = None
    jumps: int = 0
    told: Told | None = None
    ticks: int = 0

    @property
    def samples(self) -> list[Sample]:
        """All delivered samples. Those of `told` are made, and stay."""
        if self.told is not None:
            self.made[:0], self.told = self.told, None
        return self.made

    def goes_on_in(self, later: TickOutput) -> bool:
        """Take in what a later tick gives, where that and this are rows of samples alone which follow each other. Returns whether it was."""
        if self.told is None or later.told is None or self.ports is not later.ports or self.jumps != later.jumps:
            return False
        if self.made or self.replies or self.events or later.made or later.replies or later.events:
            return False
        together = self.told.followed_by(later.told)
        if together is None:
            return False
        self.told, self.tick, self.t_ns, self.ticks = together, later.tick, later.t_ns, self.ticks + later.ticks
        return True

    def drop_samples(self) -> int:
        """Nobody will look at them. Returns how many there were."""
        count = len(self.made) + len(self.told or ())
        self.made, self.told = [], None
        return count


def has_same_fields(path: str, one: Mapping[str, Port], other: Mapping[str, Port]) -> bool:
    """Whether a port is there in both, and what was read of it in one can be understood in the other: another body may have come under a name."""
    first, second = one.get(path), other.get(path)
    return first is second is not None or (first is not None and second is not None and first.fields == second.fields)


class Later:
    """What a long-running service gives instead of a result: progress, then one reply. Who posted the call adds where its answers go to.

    Attributes:
        on_reply: receives them; None for a caller in the same process, who does not wait.
    """

    def __init__(self, answers: Answers) -> None:
        """answers: of the world, which passes them on at the end of the tick."""
        self.on_reply: OnReply | None = None
        self._answers = answers

    def progress(self, fraction: float, t_ns: int) -> None:
        """Tell how far it has come."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Progress(fraction, t_ns)))

    def finish(self, tick: int, t_ns: int, result: Json = None, fault: Fault | None = None) -> None:
        """Tell how it ended; nothing may follow."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Reply(tick, t_ns, result, fault)))
