"""Requests of the asyncio loop to the simulation thread, and the event that wakes that thread. Apart from `Bus`, the threads share nothing
else.

Each client has a queue of its own, and the queues are served in turn: many requests of one client do not delay those of another.
Actions on the clock wait for the time between two ticks, and a pause comes before all other requests of its client.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import msgspec
import numpy as np

from uwserver.ports import Buffer, Call, Command, Field, OnReply, Refused
from uwserver.ports.crossing import Posted, is_withdrawn

T = TypeVar("T")

MAX_WAITING = 1024
"""Most waiting requests of one client."""
MAX_WAITING_OF_ALL = 4096
"""Most waiting requests of all clients together. Beyond it, a client is refused if it has `FREE_PLACES` waiting already, so that others
cannot shut out a client with few requests."""
FREE_PLACES = 16
MAX_BYTES = 2 << 20
"""Most bytes in the waiting requests of one client, if there is more than one request."""
MAX_BYTES_OF_ALL = 8 << 20
"""Most bytes in the waiting requests of all clients together; one request of each is always taken. Many waiting objects delay other work
too, as each full garbage collection visits them."""
_OF_OBJECTS = 4
"""Bytes of Python objects for each byte of a value's JSON text."""


class FairQueue(Generic[T]):
    """A queue for each client. The clients are served in turn, and the requests of one client in their order. Thread-safe."""

    def __init__(self, wake: threading.Event) -> None:
        """Begin with empty queues; `wake` is set with each request."""
        self._wake = wake
        # Requests with their bytes. The client that is served next comes first; a client without requests has no queue.
        self._queues: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()
        self._count = 0
        self._bytes: Counter[str] = Counter()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def put(self, client: str, item: T, *, size: int = 0, always: bool = False, first: bool = False) -> None:
        """Add a request to the queue of a client.

        Args:
            client, item: the client and its request.
            size: bytes that the request takes.
            always: never refuse it; for requests whose number the caller limits, such as one cancel for each call.
            first: serve this client next; the order of its own requests stays.

        Raises:
            Refused: `overload`; too many requests wait already. The text says which limit is reached.
        """
        with self._lock:
            queue = self._queues.get(client)
            waiting = 0 if queue is None else len(queue)
            if waiting >= MAX_WAITING and not always:
                text = f"{MAX_WAITING} requests of this client wait for their tick already"
                raise Refused("overload", f"{text}: send fewer, or wait for their replies")
            if self._count >= MAX_WAITING_OF_ALL and waiting >= FREE_PLACES and not always:
                text = f"{MAX_WAITING_OF_ALL} requests of all clients wait for their tick already, {waiting} of them of this one"
                raise Refused("overload", f"{text}: send fewer, or wait for their replies")
            if waiting and size and not always:
                self._check_bytes(client, size)
            if queue is None:
                queue = self._queues[client] = deque()
            queue.append((item, size))
            self._count += 1
            self._bytes[client] += size
            if first:
                self._queues.move_to_end(client, last=False)
        self._wake.set()

    def _check_bytes(self, client: str, size: int) -> None:
        whose = "this client", self._bytes[client], MAX_BYTES
        if self._bytes[client] + size <= MAX_BYTES:
            whose = "all clients", self._bytes.total(), MAX_BYTES_OF_ALL
        who, there, most = whose
        if there + size > most:
            text = f"requests of {who} with {there} bytes wait for their tick already; at most {most} bytes may wait"
            raise Refused("overload", f"{text}: wait for their replies")

    def overtake(self, client: str, item: T, withdraws: Callable[[T], bool]) -> list[T]:
        """Add a stop before all requests of this client, which is served next. Requests that must not be done after it are withdrawn.

        Args:
            client, item: the client and its request.
            withdraws: returns whether an older request of this client is withdrawn.

        Returns the withdrawn requests, the oldest first; the caller answers them.

        Raises:
            Refused: `overload`; the client has used up the extra places for stops, too. Nothing has changed.
        """
        with self._lock:
            older = self._queues.get(client, deque())
            kept = deque(each for each in older if not withdraws(each[0]))
            if len(kept) >= MAX_WAITING + FREE_PLACES:
                raise Refused("overload", f"{len(kept)} requests of this client wait for their tick already")
            withdrawn = [each for each, _ in older if withdraws(each)]
            kept.appendleft((item, 0))
            self._queues[client] = kept
            self._queues.move_to_end(client, last=False)
            self._count += 1 - len(withdrawn)
            self._bytes[client] = sum(size for _, size in kept)
        self._wake.set()
        return withdrawn

    def take(self) -> T | None:
        """Return the oldest request of the client that is served next; None if there is none."""
        with self._lock:
            if not self._queues:
                return None
            client, queue = next(iter(self._queues.items()))
            item, size = queue.popleft()
            self._count -= 1
            self._bytes[client] -= size
            if queue:
                self._queues.move_to_end(client)
            else:
                del self._queues[client], self._bytes[client]
            return item


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


class Steered(NamedTuple):
    """An action that waits. `on_reply` belongs to a request that a pause withdraws; it is None if the action must be carried out."""

    action: Callable[[], None]
    on_reply: OnReply | None = None


class Steering(FairQueue[Steered]):
    """Actions that wait for the simulation thread, which takes them. Thread-safe."""

    def add(
        self, action: Callable[[], None], source: str = "", on_reply: OnReply | None = None, *, always: bool = False
    ) -> None:
        """Queue an action.

        Args:
            action: to be carried out.
            source: the client.
            on_reply: is told of a request that a later pause withdraws.
            always: as for `FairQueue.put`, whose `Refused` may be raised.
        """
        self.put(client_of(source), Steered(action, on_reply), always=always)

    def stop(self, action: Callable[[], None], source: str, on_reply: OnReply) -> list[OnReply]:
        """Queue a pause before all requests of its client. May raise as `FairQueue.overtake`.

        Returns the reply functions of the requests that are withdrawn; the caller has to answer them.
        """
        older = self.overtake(client_of(source), Steered(action, on_reply), lambda each: each.on_reply is not None)
        return [each.on_reply for each in older if each.on_reply is not None]
