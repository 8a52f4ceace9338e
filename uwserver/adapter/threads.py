"""Work on threads: calls of a library that may block, what its threads hand to the loop, and work that takes too long for the loop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from uwserver.adapter.connection import REST_S, TURN_S
from uwserver.adapter.contract import AdapterStats

log = logging.getLogger(__name__)

T = TypeVar("T")

WAITING = 4096
"""Pieces of work that may wait for a `Worker`."""
MOST = 4
"""Pieces of work that may be unfinished. The caller who brings one more waits for the oldest, so nothing is lost and little is kept."""


class Worker:
    """A thread for calls of a library that may block, for example because a peer is stalled. Everything but the work belongs to the loop thread.

    Args:
        name: name of the thread.
        stats: counters of the adapter, of which `dropped` and `errors` count dropped and failed work.
    """

    def __init__(self, name: str, stats: AdapterStats) -> None:
        self._name = name
        self._stats = stats
        self._pool = ThreadPoolExecutor(1, name)
        self._waiting = 0
        self._lock = threading.Lock()

    def send(self, work: Callable[[], object]) -> bool:
        """Do a piece of work on the thread, in order; return False, and drop it, if too much waits already."""
        if self._waiting >= WAITING:
            self._stats.dropped += 1
            return False
        with self._lock:
            self._waiting += 1
        self._pool.submit(self._do, work)
        return True

    def _do(self, work: Callable[[], object]) -> None:
        try:
            work()
        except Exception as error:  # noqa: BLE001  # the library may be closing, or the peer may have left
            self._stats.errors += 1
            log.debug("%s: not done: %s", self._name, error)
        finally:
            with self._lock:
                self._waiting -= 1

    async def run(self, work: Callable[[], T]) -> T:
        """Do a piece of work on the thread and wait for its result. If this is cancelled, the work still ends first, and leaves nothing behind."""
        future = asyncio.get_running_loop().run_in_executor(self._pool, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            await asyncio.wait([future])
            raise

    async def close(self, last: Callable[[], object]) -> None:
        """End the thread. `last`, which closes the library's session, runs on another thread, and frees work that is stuck."""
        closing = ThreadPoolExecutor(1, f"{self._name}, closing")
        future = asyncio.get_running_loop().run_in_executor(closing, last)
        try:
            await asyncio.shield(future)
        finally:
            closing.shutdown(wait=False)
            self._pool.shutdown(wait=False, cancel_futures=True)


class Inbox(Generic[T]):
    """Items that a library's threads hand to the loop. A thread only appends an item, and wakes the loop once for all that wait.

    Args:
        take: called with an item on the loop.
        capacity: number of items that may wait.
        refuse: called with an item too many, on the library's thread.
        size: returns the size of an item in bytes.
        most_bytes: total size of the items that may wait; a single item may be larger.
    """

    def __init__(
        self, take: Callable[[T], None], capacity: int, refuse: Callable[[T], None],
        size: Callable[[T], int] = lambda _: 0, most_bytes: int = 0,
    ) -> None:  # fmt: skip
        self._take = take
        self._refuse = refuse
        self._capacity = capacity
        self._size, self._most_bytes = size, most_bytes
        # What waits is their difference. Each is changed by one thread at a time.
        self._put_bytes = self._taken_bytes = 0
        self._loop = asyncio.get_running_loop()
        self._items: deque[T] = deque()
        self._lock = threading.Lock()
        self._is_awake = False

    def put(self, item: T) -> None:
        """Hand over an item. May be called on any thread."""
        size = self._size(item)
        with self._lock:
            waiting = self._put_bytes - self._taken_bytes
            if len(self._items) >= self._capacity or (waiting and waiting + size > self._most_bytes):
                self._refuse(item)
                return
            self._put_bytes += size
            self._items.append(item)
            wake = not self._is_awake
            self._is_awake = True
        if wake:
            try:
                self._loop.call_soon_threadsafe(self._drain)
            except RuntimeError:
                # The loop is closed.
                self._items.clear()

    def _drain(self) -> None:
        """Take items for one turn of the loop."""
        end = self._loop.time() + TURN_S
        try:
            while self._items:
                item = self._items.popleft()
                self._taken_bytes += self._size(item)
                self._take(item)
                if self._loop.time() >= end:
                    return
        finally:
            with self._lock:
                self._is_awake = bool(self._items)
            # After a rest, as for peers on sockets, so that the simulation has the interpreter most of the time, however much comes.
            if self._is_awake:
                self._loop.call_later(REST_S, self._drain)


class InOrder(Generic[T]):
    """A thread that is started for the first piece of work. Everything but the work itself belongs to the loop thread.

    Args:
        name: name of the thread.
        stats: counters of the adapter, of which `errors` counts failures.
    """

    def __init__(self, name: str, stats: AdapterStats) -> None:
        self._name, self._stats = name, stats
        self._loop = asyncio.get_running_loop()
        self._pool: ThreadPoolExecutor | None = None
        self._under_way: deque[tuple[Future[T], Callable[[T | None], None]]] = deque()

    def put(self, work: Callable[[], T], done: Callable[[T | None], None]) -> None:
        """Do a piece of work on the thread. `done` gets its result on the loop, or None if it failed."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, self._name)
        while len(self._under_way) >= MOST:
            self.hurry()
        future = self._pool.submit(work)
        self._under_way.append((future, done))
        future.add_done_callback(self._wake)

    def _wake(self, _: Future[T]) -> None:
        # RuntimeError: the loop is closed.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        while self._under_way and self._under_way[0][0].done():
            self.hurry()

    def hurry(self) -> bool:
        """Wait for the oldest unfinished piece of work and deliver its result; return whether there was one."""
        if not self._under_way:
            return False
        future, done = self._under_way.popleft()
        result: T | None = None
        try:
            result = future.result()
        except (Exception, CancelledError) as error:  # noqa: BLE001  # a fault in the work must not end the adapter
            self._stats.errors += 1
            log.warning("%s: not done: %s", self._name, error)
        done(result)
        return True

    async def close(self) -> None:
        """End the thread. Results of unfinished work are not delivered any more."""
        under_way, self._under_way = self._under_way, deque()
        pool, self._pool = self._pool, None
        for future, _ in under_way:
            if not future.cancel():
                await asyncio.wait([asyncio.wrap_future(future)])
        if pool is not None:
            pool.shutdown()
