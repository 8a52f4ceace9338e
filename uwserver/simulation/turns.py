"""What clients want done, one thing at a time: nobody's many requests keep another's one waiting."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from uwserver.ports import Refused

T = TypeVar("T")

MAX_WAITING = 1024
"""Requests of one client that may wait."""
MAX_WAITING_OF_ALL = 4096
"""Of all clients together; beyond it a client is refused that has `FREE_PLACES` waiting, so that others cannot shut out one that asks little."""
FREE_PLACES = 16


class Turns(Generic[T]):
    """A queue for each client, from which they are served in turn; what one client asked is done in its order. Thread-safe."""

    def __init__(self) -> None:
        self._queues: OrderedDict[str, deque[T]] = OrderedDict()
        """The next to be served stands first; nobody is in it without a request."""
        self._count = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def put(self, client: str, item: T, *, always: bool = False, first: bool = False) -> None:
        """Add to the queue of a client.

        Args:
            client, item: who wants what.
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
            if queue is None:
                queue = self._queues[client] = deque()
            queue.append(item)
            self._count += 1
            if first:
                self._queues.move_to_end(client, last=False)

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
            kept = deque(each for each in older if not withdraws(each))
            if len(kept) >= MAX_WAITING + FREE_PLACES:
                raise Refused("overload", f"{len(kept)} requests of this client wait for their tick already")
            withdrawn = [each for each in older if withdraws(each)]
            kept.appendleft(item)
            self._queues[client] = kept
            self._queues.move_to_end(client, last=False)
            self._count += 1 - len(withdrawn)
            return withdrawn

    def take(self) -> T | None:
        """The oldest request of the client whose turn it is; None when nobody waits."""
        with self._lock:
            if not self._queues:
                return None
            client, queue = next(iter(self._queues.items()))
            item = queue.popleft()
            self._count -= 1
            if queue:
                self._queues.move_to_end(client)
            else:
                del self._queues[client]
            return item
