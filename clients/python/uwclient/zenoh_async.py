"""The zenoh link for asyncio: the blocking link on a thread of its own, so that zenoh cannot hold up the loop."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from uwclient.async_link import AsyncLink
from uwclient.zenoh_link import ZenohLink, dial_zenoh
from uwclient.zenoh_place import ZenohPlace

T = TypeVar("T")


async def dial_zenoh_async(place: ZenohPlace, timeout: float) -> AsyncLink:
    """Open a session and wait until the server is seen, as `dial_zenoh` does. If this is cancelled, nothing is left behind."""
    link = ZenohAsyncLink()
    await link.dial(place, timeout)
    return link


class ZenohAsyncLink:
    """A `ZenohLink` on the only thread of a pool. The threads of zenoh only wake the loop, once for all that waits."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._pool = ThreadPoolExecutor(1, "uwclient zenoh")
        self._link: ZenohLink | None = None
        self._news = asyncio.Event()
        self._woken = False
        self._sent: Future[None] = Future()
        self._sent.set_result(None)
        self._closed = self._sent

    async def dial(self, place: ZenohPlace, timeout: float) -> None:
        """Connect; see `dial_zenoh_async`."""
        dialled = self._pool.submit(dial_zenoh, place, timeout, self._arrived)
        try:
            self._link = await asyncio.shield(asyncio.wrap_future(dialled))
        except asyncio.CancelledError:
            # The call cannot be stopped, but it ends soon after its timeout. What it has opened is closed there.
            self._pool.submit(_close, dialled)
            raise
        finally:
            if self._link is None:
                self._pool.shutdown(wait=False)

    def _arrived(self) -> None:
        """Wake the loop because something waits in the link. May be called on any thread."""
        if not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._news.set)

    def write(self, data: bytes) -> None:
        """Begin the requests in `data`."""
        if self._link is not None:
            self._sent = self._pool.submit(self._link.send, data, None)

    async def drain(self) -> None:
        """Wait until zenoh has taken what was written last. Raises OSError."""
        await asyncio.shield(asyncio.wrap_future(self._sent))

    async def read(self) -> bytes:
        """Return the next frames; see `AsyncLink.read`."""
        while self._link is not None:
            if not self._link.waits:
                await self._news.wait()
            self._news.clear()
            self._woken = False  # before the link is read, so that later arrivals wake the loop again
            data = await self._run(self._link.receive, 0.0)
            if data is not None:
                return data
        return b""

    async def _run(self, work: Callable[[float], T], argument: float) -> T:
        return await asyncio.wrap_future(self._pool.submit(work, argument))

    def close(self) -> None:
        """Begin to close the session on another thread, which frees calls that are stuck in it."""
        link, self._link = self._link, None
        if link is not None:
            closing = ThreadPoolExecutor(1, "uwclient zenoh")
            self._closed = closing.submit(link.close)
            closing.shutdown(wait=False)
            self._pool.shutdown(wait=False)

    async def wait_closed(self) -> None:
        """Wait until the session is closed."""
        await asyncio.shield(asyncio.wrap_future(self._closed))


def _close(dialled: Future[ZenohLink]) -> None:
    if dialled.exception() is None:
        dialled.result().close()
