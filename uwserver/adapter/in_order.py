"""Does work that takes too long for the loop, such as the encoding of a JPEG, on a thread, and delivers the results on the loop in order."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from uwserver.adapter.contract import AdapterStats

log = logging.getLogger(__name__)

T = TypeVar("T")

MOST = 4
"""Pieces of work that may be unfinished. The caller who brings one more waits for the oldest, so nothing is lost and little is kept."""


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
