"""Data that crosses between the simulation thread and the outside: requests, outputs of ticks, and answers that come later.

Services that stop something overtake earlier requests, and withdraw waiting requests that would undo the stop.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from uwserver.ports.sample_batch import SampleBatch
from uwserver.ports.values import Call, Command, Event, Fault, Field, Json, OnReply, Port, Progress, Reply, Sample

Answers = list[tuple[OnReply, Reply | Progress]]
"""Receivers, each with the answer that it is to get."""
UNDONE_BY: Mapping[str, str] = {"disarm": "arm", "deactivate": "activate"}
"""Services that stop a vehicle or an actuator, and for each the service that undoes it."""
PAUSE = "world/pause"


class Posted(Struct):
    """A checked command or call that waits for the start of the next tick; `on_reply` receives the answer.

    A command was checked against `fields`. If the actuator has other fields by then, it is checked again.
    """

    item: Command | Call
    on_reply: OnReply | None
    fields: tuple[Field, ...] = ()


class TickOutput(Struct):
    """Output of one tick, or of several consecutive ticks.

    Attributes:
        tick, t_ns: number and time of the last tick.
        ticks: number of ticks.
        made: delivered samples, as objects.
        batch: delivered samples before those, still as rows.
        ports: ports of the samples, as they are after the last tick; None if not given.
        jumps: how often the time had been set, as of the last tick.
    """

    tick: int
    t_ns: int
    made: list[Sample]
    replies: Answers = []
    events: list[Event] = []
    ports: Mapping[str, Port] | None = None
    jumps: int = 0
    batch: SampleBatch | None = None
    ticks: int = 0

    @property
    def samples(self) -> list[Sample]:
        """All delivered samples. Those in `batch` are made into objects once, and kept."""
        if self.batch is not None:
            self.made[:0], self.batch = self.batch, None
        return self.made

    def goes_on_in(self, later: TickOutput) -> bool:
        """Add the output of a later tick, if both consist only of rows of samples that follow each other. Return whether it was added."""
        if self.batch is None or later.batch is None or self.ports is not later.ports or self.jumps != later.jumps:
            return False
        if self.made or self.replies or self.events or later.made or later.replies or later.events:
            return False
        together = self.batch.followed_by(later.batch)
        if together is None:
            return False
        self.batch, self.tick, self.t_ns, self.ticks = together, later.tick, later.t_ns, self.ticks + later.ticks
        return True

    def drop_samples(self) -> int:
        """Drop all samples, as nobody needs them, and return their number."""
        count = len(self.made) + len(self.batch or ())
        self.made, self.batch = [], None
        return count


def has_same_fields(path: str, one: Mapping[str, Port], other: Mapping[str, Port]) -> bool:
    """Return whether both have a port of this path with the same fields. They may differ if another body took the name."""
    first, second = one.get(path), other.get(path)
    return first is second is not None or (first is not None and second is not None and first.fields == second.fields)


class Later:
    """Returned by a long-running service instead of a result: progress reports and then one reply follow later.

    Attributes:
        on_reply: receives them; whoever posted the call sets it. None for a caller in the same process that does not wait.
    """

    def __init__(self, answers: Answers) -> None:
        """Make one for a world; `answers` is its list of answers, which it passes on at the end of the tick."""
        self.on_reply: OnReply | None = None
        self._answers = answers

    def progress(self, fraction: float, t_ns: int) -> None:
        """Report progress, 0 to 1."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Progress(fraction, t_ns)))

    def finish(self, tick: int, t_ns: int, result: Json = None, fault: Fault | None = None) -> None:
        """Send the final reply; nothing may follow it."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Reply(tick, t_ns, result, fault)))


def is_stop(service: str) -> bool:
    """Return whether a service stops a vehicle, a component or time."""
    return service == PAUSE or service.rpartition("/")[2] in UNDONE_BY


def is_withdrawn(item: Command | Call, stop: str) -> bool:
    """Return whether a waiting request must not be carried out after a stop that was requested later.

    That is the case for commands to the stopped component (for `disarm`: to any component of the vehicle) and the call that undoes the stop.

    Args:
        item: the waiting request.
        stop: path of a service that stops a vehicle or a component.
    """
    path, _, verb = stop.rpartition("/")
    if isinstance(item, Call):
        return item.service == f"{path}/{UNDONE_BY[verb]}"
    if verb == "disarm":
        return item.port.startswith(f"{path.partition('/')[0]}/")
    return item.port == path
