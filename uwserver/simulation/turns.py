"""What clients want done, one thing at a time: nobody's many requests keep another's one waiting."""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from uwserver.ports import Refused

T = TypeVar("T")

MAX_WAITING = 1024
"""Requests of one client that may wait."""
MAX_WAITING_OF_ALL = 4096
"""Of all clients together; beyond it a client is refused that has `FREE_PLACES` waiting, so that others cannot shut out one that asks little."""
FREE_PLACES = 16
MAX_BYTES = 2 << 20
"""Bytes in those of one client that may wait, unless it is the only one."""
MAX_BYTES_OF_ALL = 8 << 20
"""Of all clients together; one of each is always taken. What waits in many objects costs others time, too: each full collection looks at all."""


class Turns(Generic[T]):
    """A queue for each client, from which they are served in turn; what one client asked is done in its order. Thread-safe."""

    def __init__(self) -> None:
        self._queues: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()
        """The next to be served stands first; nobody is in it without a request. Each with its bytes."""
        self._count = 0
        self._bytes: Counter[str] = Counter()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def put(self, client: str, item: T, *, size: int = 0, always: bool = False, first: bool = False) -> None:
        """Add to the queue of a client.

        Args:
            client, item: who wants what.
            size: bytes that it keeps.
            always: never refused; for what who asks bounds, as one cancel for each call.
            first: it is this client's turn next; its own order stays.

        Raises:
            Refused: `overload`; too many wait already. The text says which limit.
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

    def _check_bytes(self, client: str, size: int) -> None:
        whose = "this client", self._bytes[client], MAX_BYTES
        if self._bytes[client] + size <= MAX_BYTES:
            whose = "all clients", self._bytes.total(), MAX_BYTES_OF_ALL
        who, there, most = whose
        if there + size > most:
            text = f"requests of {who} with {there} bytes wait for their tick already, of {most} that may"
            raise Refused("overload", f"{text}: wait for their replies")

    def overtake(self, client: str, item: T, withdraws: Callable[[T], bool]) -> list[T]:
        """Add a stop: before all that this client asked, whose turn is next. What must not be done after it leaves the queue.

        Args:
            client, item: who stops what.
            withdraws: whether an older request of this client leaves.

        Returns those, the oldest first: whoever calls this answers them.

        Raises:
            Refused: `overload`; the client has used up the places that are kept for this, too. Nothing has changed.
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
            return withdrawn

    def take(self) -> T | None:
        """The oldest request of the client whose turn it is; None when nobody waits."""
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
