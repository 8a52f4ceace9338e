"""Steps and runs that are under way."""

from __future__ import annotations

from dataclasses import dataclass

from uwserver.ports import OnReply


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
