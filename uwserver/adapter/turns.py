"""Work in turns on the loop: datagrams, stored input, and work that is done in pieces. After each turn there is a rest.

The rests are for the simulation, which cannot have the interpreter while the loop works. `Connection` handles the input of TCP peers in the same way.
"""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterator

from uwserver.adapter import connection
from uwserver.adapter.connection import TURN_S
from uwserver.adapter.peers import TurnTimes

log = logging.getLogger(__name__)

REST_S = 0.004
"""Wall time between two turns of `BackgroundWork` and `InputTurns`."""
WAITING = 128 << 10
"""Bytes of one sender that may wait for their turn."""
WAITING_OF_ALL = 4 << 20
"""Bytes of all senders of a socket that may wait."""
OVERHEAD = 256
"""Bytes that are added to the size of each datagram, for the memory that it takes besides its own bytes."""

Work = Callable[[], Iterator[None]]
"""Handles a datagram, one piece with each step of the iterator."""


class DatagramTurns:
    """The datagrams of one socket.

    Nothing slows their senders down, so datagrams that come together must not all be handled at once. A datagram is handled at once until a turn
    of `TURN_S` is used up. Then there is a rest, as for a `Connection`, after which the senders take turns; the datagrams of each sender keep
    their order. A datagram is dropped if too much waits.

    Args:
        turns: the turns of the adapter's peers, which come one after the other.
        turn_s, rest_s: wall time of a turn, and of the rest before the next; default: those of a `Connection`.
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
        """Handle a datagram now or later.

        Args:
            sender: the sender.
            size: bytes of the datagram.
            work: handles it; begun at its turn.

        Returns:
            False if the datagram was dropped, because too much waits already.
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
        """Throw away what waits."""
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
            except Exception:
                # A fault in the handling of one datagram must not end the adapter.
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
        # `self` marks the end of the iterator, which yields only None.
        if next(self._current, self) is self:
            self._current = None


class BackgroundWork:
    """Does pieces of work, such as a long answer or the clean-up after a client that is gone, one after the other on the running loop."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[Iterator[None]] = deque()
        self._turn: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, steps: Iterator[None]) -> None:
        """Take on a piece of work, after those that wait already. Each step of the iterator should be short."""
        self._waiting.append(steps)
        if self._turn is None:
            self._turn = self._loop.call_later(0.0, self._work)

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._waiting:
            try:
                next(self._waiting[0])
            except StopIteration:
                self._waiting.popleft()
            except Exception:
                # A fault of an adapter must not keep the other pieces waiting.
                log.exception("what an adapter does in pieces ends by a fault of it")
                self._waiting.popleft()
            if self._waiting and self._loop.time() >= end:
                self._turn = self._loop.call_later(REST_S, self._work)
                return

    def close(self) -> None:
        """Drop the work that is left."""
        if self._turn is not None:
            self._turn.cancel()
        self._waiting.clear()


class InputTurns:
    """Handles the stored input of one peer in turns of `TURN_S`, for a peer that is no `Connection`. In a rest nothing more is read.

    Args:
        step: handles the next stored message; returns False if there is none.
        pause, resume: stop and go on reading from the peer.
    """

    def __init__(self, step: Callable[[], bool], pause: Callable[[], None], resume: Callable[[], None]) -> None:
        self._step, self._pause, self._resume = step, pause, resume
        self._loop = asyncio.get_running_loop()
        self._next: asyncio.TimerHandle | None = None

    def begin(self) -> None:
        """Handle what is stored, now or after the rest."""
        if self._next is None:
            self._work()

    def _work(self) -> None:
        self._next = None
        end = self._loop.time() + TURN_S
        while self._step():
            if self._loop.time() >= end:
                self.rest(REST_S)
                return
        if self._next is None:
            self._resume()

    def rest(self, seconds: float) -> None:
        """Rest for some wall time. A step that cannot go on now calls this and returns False."""
        self._pause()
        self._next = self._loop.call_later(seconds, self._work)

    def stop(self) -> None:
        """Handle nothing more until `begin`."""
        if self._next is not None:
            self._next.cancel()
            self._next = None
