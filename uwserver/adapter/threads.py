"""Two crossings between the loop and the threads of a library (zenoh, a ROS 2 executor), both bounded."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

from uwserver.adapter.connection import REST_S, TURN_S
from uwserver.adapter.contract import AdapterStats

log = logging.getLogger(__name__)

T = TypeVar("T")

WAITING = 4096
"""Pieces of work that may wait for the thread."""


class Worker:
    """A thread for what may wait in a library: what a stalled peer holds up, opening and closing. Loop thread, but for the work itself.

    Args:
        name: of the thread.
        stats: counts what was dropped and what failed.
    """

    def __init__(self, name: str, stats: AdapterStats) -> None:
        self._name = name
        self._stats = stats
        self._pool = ThreadPoolExecutor(1, name)
        self._waiting = 0
        self._lock = threading.Lock()

    def send(self, work: Callable[[], object]) -> bool:
        """Do it there, in order; False when too much waits already, then it is not done, and counted."""
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
        except Exception as error:  # noqa: BLE001  # the library may be closing, or the asker gone
            self._stats.errors += 1
            log.debug("%s: not done: %s", self._name, error)
        finally:
            with self._lock:
                self._waiting -= 1

    async def run(self, work: Callable[[], T]) -> T:
        """Do it there and wait for it. If the waiting is cancelled the work still ends first, so that nothing of it is left behind."""
        future = asyncio.get_running_loop().run_in_executor(self._pool, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            await asyncio.wait([future])
            raise

    async def close(self, last: Callable[[], object]) -> None:
        """End it; `last` (closing the library's session) runs beside what is stuck, and frees it."""
        closing = ThreadPoolExecutor(1, f"{self._name}, closing")
        future = asyncio.get_running_loop().run_in_executor(closing, last)
        try:
            await asyncio.shield(future)
        finally:
            closing.shutdown(wait=False)
            self._pool.shutdown(wait=False, cancel_futures=True)


class Inbox(Generic[T]):
    """What a library's threads hand to the loop: they only append, and wake it once.

    Args:
        take: takes an item, on the loop.
        capacity: items that may wait.
        refuse: told of an item too many, on its thread.
        size: of an item, bytes.
        most_bytes: of items that may wait, all together; a single one may be larger.
    """

    def __init__(
        self, take: Callable[[T], None], capacity: int, refuse: Callable[[T], None],
        size: Callable[[T], int] = lambda _: 0, most_bytes: int = 0,
    ) -> None:  # fmt: skip
        self._take = take
        self._refuse = refuse
        self._capacity = capacity
        self._size, self._most_bytes = size, most_bytes
        self._put_bytes = self._taken_bytes = (
            0  # what waits is their difference: each has one thread at a time that changes it
        )
        self._loop = asyncio.get_running_loop()
        self._items: deque[T] = deque()
        self._lock = threading.Lock()
        self._is_awake = False

    def put(self, item: T) -> None:
        """Hand over. Any thread."""
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
            except RuntimeError:  # the loop is closed
                self._items.clear()

    def _drain(self) -> None:
        """Take what is there, for one turn of the loop."""
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
            if self._is_awake:  # after a rest, as for peers on sockets: however many flood, the simulation has the interpreter for most of the time
                self._loop.call_later(REST_S, self._drain)
