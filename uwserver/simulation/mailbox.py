"""Requests of the asyncio loop to the simulation thread, and the event that wakes that thread. Apart from `Bus`, the threads share nothing
else."""

from __future__ import annotations

import threading

import msgspec
import numpy as np

from uwserver.ports import Buffer, Call, Command, Field, OnReply
from uwserver.ports.crossing import Posted, is_withdrawn
from uwserver.simulation.fair_queue import FairQueue

_OF_OBJECTS = 4
"""Bytes of Python objects for each byte of a value's JSON text."""


class Wake(threading.Event):
    """Wakes the simulation thread, and ends the step that it makes in compiled code.

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
    """Requests of the loop to the simulation, which empties the mailbox at the start of a tick.

    Attributes:
        posted: waiting requests, by client.
        wake: is set by each request.
    """

    def __init__(self) -> None:
        self.wake = Wake()
        self.posted: FairQueue[Posted] = FairQueue(self.wake)

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
        """Queue a request for the next tick, or for a later one if there is too little time in the next.

        Args:
            item, on_reply: the request, and the function that gets the reply.
            client: whose queue it joins; default: the client of its source.
            always, first: as for `FairQueue.put`.
            fields: as in `Posted`.

        Raises:
            Refused: `overload`; too many requests wait already.
        """
        client = client or client_of(item.source)
        self.posted.put(client, Posted(item, on_reply, fields), size=_bytes_of(item), always=always, first=first)

    def stop(self, call: Call, on_reply: OnReply | None, client: str = "") -> list[Posted]:
        """Queue the call of a service that stops a vehicle or a component, before all requests of its client.

        Returns the requests that it withdraws. They are never carried out; the caller answers them. May raise as `FairQueue.overtake`.
        """
        return self.posted.overtake(
            client or client_of(call.source),
            Posted(call, on_reply),
            lambda older: is_withdrawn(older.item, call.service),
        )


def _bytes_of(item: Command | Call) -> int:
    """Return about how many bytes a waiting request takes; numbers and short texts are not counted."""
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
    """Return the client of a source: the text before the first space. A name that a client gives itself stands behind the space."""
    return source.partition(" ")[0]
