"""What the asyncio loop posts for the simulation thread, and how that thread is woken."""

from __future__ import annotations

import threading

import msgspec
import numpy as np

from uwserver.ports import Buffer, Call, Command, Field, OnReply
from uwserver.ports.crossing import Posted
from uwserver.ports.stops import is_withdrawn
from uwserver.simulation.turns import Turns

_OF_OBJECTS = 4
"""Bytes that the objects of a decoded value take for each of its text."""


class Wake(threading.Event):
    """Wakes the simulation thread where it waits, and ends the step that it makes in compiled code.

    Attributes:
        posted: (1) 1 while the event is set, for `step.tick.step`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.posted = np.zeros(1, np.int64)

    def set(self) -> None:
        """Wake the simulation thread. Any thread."""
        self.posted[0] = 1
        super().set()

    def clear(self) -> None:
        """Begin to wait for the next `set`. Simulation thread."""
        super().clear()
        self.posted[0] = 0


class Mailbox:
    """What the loop posts for the simulation.

    Attributes:
        posted: what waits, by client.
        wake: set with each post.
    """

    def __init__(self) -> None:
        self.posted: Turns[Posted] = Turns()
        self.wake = Wake()

    def post(
        self,
        item: Command | Call,
        on_reply: OnReply | None,
        client: str = "",
        *,
        always: bool = False,
        first: bool = False,
        fields: tuple[Field, ...] = (),
    ) -> None:
        """Queue for the next tick, or the next in which there is time for it.

        Args:
            item, on_reply: what is asked, and who gets the answer.
            client: whose turn it takes; default: that of its source.
            always, first: as for `Turns.put`.
            fields: as of `Posted`.

        Raises:
            Refused: `overload` when too many wait already.
        """
        client = client or client_of(item.source)
        self.posted.put(client, Posted(item, on_reply, fields), size=_bytes_of(item), always=always, first=first)
        self.wake.set()

    def stop(self, call: Call, on_reply: OnReply | None, client: str = "") -> list[Posted]:
        """Queue the call of a service that stops a vehicle or a component, before all that its client asked.

        Returns what it withdraws: never carried out, for the caller to answer. May raise as `Turns.overtake`.
        """
        withdrawn = self.posted.overtake(
            client or client_of(call.source),
            Posted(call, on_reply),
            lambda older: is_withdrawn(older.item, call.service),
        )
        self.wake.set()
        return withdrawn


def _bytes_of(item: Command | Call) -> int:
    """What a request keeps while it waits, about; numbers and short texts are nothing."""
    if isinstance(item, Command):
        return sum(
            len(value.data) if isinstance(value, Buffer) else len(value) for value in item.value if value is not None
        )
    size = 0
    for value in item.args.values():
        if isinstance(value, str):
            size += len(value)
        elif isinstance(value, list | dict):
            size += _OF_OBJECTS * len(msgspec.json.encode(value))
    return size


def client_of(source: str) -> str:
    """Who stands behind a source: what is before the first space. A name that a client gives itself later stands behind it."""
    return source.partition(" ")[0]
