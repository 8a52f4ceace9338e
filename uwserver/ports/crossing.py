"""What crosses between the simulation thread and the outside in a tick: requests on their way in, and what the tick gives."""

from __future__ import annotations

from dataclasses import dataclass, field

from msgspec import Struct

from uwserver.ports.values import Call, Command, Event, OnReply, Progress, Reply, Sample


class Posted(Struct):
    """A checked command or call that waits for the start of the next tick; `on_reply` gets the answer."""

    item: Command | Call
    on_reply: OnReply | None


@dataclass(slots=True)
class TickOutput:
    """What one tick gives to the outside."""

    tick: int
    t_ns: int
    samples: list[Sample]
    replies: list[tuple[OnReply, Reply | Progress]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
