"""Work that takes too long for the loop, as the making of a JPEG: done on a thread, one after the other, and told on the loop in this order."""

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
"""Pieces that are under way: who brings one more waits for the oldest, as if he did it himself. So nothing is lost, and little is kept."""


class InOrder(Generic[T]):
    """A thread, from its first piece of work on. Loop thread, but for the work itself.

    Args:
        name: of the thread.
        stats: counts what failed.
    """

    def __init__(self, name: str, stats: AdapterStats) -> None:
        self._name, self._stats = name, stats
        self._loop = asyncio.get_running_loop()
        self._pool: ThreadPoolExecutor | None = None
        self._under_way: deque[tuple[Future[T], Callable[[T | None], None]]] = deque()

    def put(self, work: Callable[[], T], done: Callable[[T | None], None]) -> None:
        """Do a piece of work there; `done` gets what it gave, on the loop, or None where it failed."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, self._name)
        while len(self._under_way) >= MOST:
            self.hurry()
        future = self._pool.submit(work)
        self._under_way.append((future, done))
        future.add_done_callback(self._wake)

    def _wake(self, _: Future[T]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        while self._under_way and self._under_way[0][0].done():
            self.hurry()

    def hurry(self) -> bool:
        """Wait for the oldest piece that is under way, and tell what it gave; whether there was one."""
        if not self._under_way:
            return False
        future, done = self._under_way.popleft()
        result: T | None = None
        try:
            result = future.result()
        except (Exception, CancelledError) as error:  # noqa: BLE001  # a fault of ours must not end the adapter
            self._stats.errors += 1
            log.warning("%s: not done: %s", self._name, error)
        done(result)
        return True

    async def close(self) -> None:
        """End the thread; what is under way is not told any more."""
        under_way, self._under_way = self._under_way, deque()
        pool, self._pool = self._pool, None
        for future, _ in under_way:
            if not future.cancel():
                await asyncio.wait([asyncio.wrap_future(future)])
        if pool is not None:
            pool.shutdown()
