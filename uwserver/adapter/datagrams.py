"""Datagrams worked off in turns: nothing holds their senders back, so what comes at once must not be carried out at once."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterator

from uwserver.adapter import connection
from uwserver.adapter.limits import TurnTimes

log = logging.getLogger(__name__)

WAITING = 128 << 10
"""Bytes of one sender that may wait for their turn."""
WAITING_OF_ALL = 4 << 20
"""Bytes of all senders of a socket."""
OVERHEAD = 256
"""Bytes as which a datagram counts besides its own."""

Work = Callable[[], Iterator[None]]
"""Takes a datagram, a piece at a time."""


class DatagramTurns:
    """What has come by one socket. It is taken at once, until `TURN_S` have been used up; then there is a rest, as for a `Connection`, and
    senders are served in turn, each in its own order. What cannot wait is dropped.

    Args:
        turns: of the adapter's peers, which have their turns one after the other.
        turn_s, rest_s: wall time of a turn, and before the next; default: those of a `Connection`.
    """

    def __init__(self, turns: TurnTimes, turn_s: float | None = None, rest_s: float | None = None) -> None:
        self._turns = turns
        self._turn_s = connection.TURN_S if turn_s is None else turn_s
        self._rest_s = connection.REST_S if rest_s is None else rest_s
        self._loop = asyncio.get_running_loop()
        self._queues: OrderedDict[Hashable, deque[tuple[int, Work]]] = OrderedDict()
        self._waiting: dict[Hashable, int] = {}
        self._size = 0
        self._current: Iterator[None] | None = None
        self._began = 0.0
        self._spent = 0.0
        self._next: asyncio.TimerHandle | None = None

    def put(self, sender: Hashable, size: int, work: Work) -> bool:
        """Take a datagram, now or later.

        Args:
            sender: whose it is.
            size: bytes that wait with it.
            work: begun at its turn.

        Returns False where it was dropped: too much waits already.
        """
        size += OVERHEAD
        waiting = self._waiting.get(sender, 0)
        if (waiting and waiting + size > WAITING) or self._size + size > WAITING_OF_ALL:
            return False
        self._queues.setdefault(sender, deque()).append((size, work))
        self._waiting[sender] = waiting + size
        self._size += size
        if self._next is None:
            self._work()
        return True

    def close(self) -> None:
        """What waits is thrown away."""
        if self._next is not None:
            self._next.cancel()
        self._queues.clear()
        self._waiting.clear()
        self._size, self._current = 0, None

    def _work(self) -> None:
        now = self._loop.time
        start = now()
        if start - self._began >= self._turn_s + self._rest_s:
            self._began, self._spent = start, 0.0
        while self._current is not None or self._queues:
            if self._spent >= self._turn_s:
                self._next = self._loop.call_at(self._turns.after(start, self._turn_s, self._rest_s), self._again)
                return
            try:
                self._step()
            except Exception:  # a fault of ours must not end the adapter
                log.exception("a datagram is dropped by a fault of the adapter")
                self._current = None
            end = now()
            self._spent += end - start
            start = end

    def _again(self) -> None:
        self._next = None
        self._began, self._spent = self._loop.time(), 0.0
        self._work()

    def _step(self) -> None:
        if self._current is None:
            sender, queue = next(iter(self._queues.items()))
            size, work = queue.popleft()
            self._size -= size
            self._waiting[sender] -= size
            if queue:
                self._queues.move_to_end(sender)
            else:
                del self._queues[sender], self._waiting[sender]
            self._current = work()
        if next(self._current, self) is self:
            self._current = None
