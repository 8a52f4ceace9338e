"""Clients over zenoh instead of TCP.

The asyncio client has the blocking link on a thread of its own, so that zenoh cannot hold up the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from uwclient.aio import AsyncClient
from uwclient.link import AsyncLink
from uwclient.session import Settings
from uwclient.sync import Client
from uwclient.zenoh_link import ZenohLink, dial_zenoh
from uwclient.zenoh_place import ZenohPlace

T = TypeVar("T")
LOOPBACK = ("tcp/127.0.0.1:7447",)
"""Default endpoint of a server on this machine."""


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


def connect_zenoh(
    server: str = "uwserver",
    connect: Sequence[str] = LOOPBACK,
    *,
    prefix: str = "uw",
    mode: str = "peer",
    config: Mapping[str, object] | None = None,
    name: str | None = None,
    encoding: str = "json",
    timeout: float = 5.0,
    reconnect: bool = True,
) -> Client:
    """Connect over zenoh. Everything else is as with `Client.connect`. Needs the eclipse-zenoh package.

    Args:
        server: name of the server in the keys.
        connect: endpoints of servers or routers; with none, (), the server is found by multicast.
        prefix: first levels of the keys, as in the server's adapter.
        mode: mode of the zenoh session, "peer" or "client".
        config: zenoh settings by path, such as {"transport/link/tls/root_ca_certificate": "ca.pem"}.
        name: name of this client, which it needs to take part in a lockstep barrier.
        encoding: "json", or "msgpack" (needs the msgpack package); preferably that of the server's adapter.
        timeout: wall s, for connecting and for every operation without a timeout of its own.
        reconnect: whether to renew a lost connection.

    Raises:
        ConnectionLost: there is no such server in the network; the text names those that are there.
        UwError: eclipse-zenoh is missing (`missing_package`), or a setting is wrong (`bad_argument`).
    """
    place = ZenohPlace(server, tuple(connect), prefix, mode, dict(config or {}), encoding)
    settings = Settings("", 0, name, None, encoding, timeout, reconnect, via=place.address)
    return Client.over(partial(dial_zenoh, place), settings)


async def connect_zenoh_async(
    server: str = "uwserver",
    connect: Sequence[str] = LOOPBACK,
    *,
    prefix: str = "uw",
    mode: str = "peer",
    config: Mapping[str, object] | None = None,
    name: str | None = None,
    encoding: str = "json",
    timeout: float = 5.0,
    reconnect: bool = True,
) -> AsyncClient:
    """Connect an `AsyncClient` over zenoh. Arguments and errors are those of `connect_zenoh`."""
    place = ZenohPlace(server, tuple(connect), prefix, mode, dict(config or {}), encoding)
    settings = Settings("", 0, name, None, encoding, timeout, reconnect, via=place.address)
    return await AsyncClient.over(partial(dial_zenoh_async, place), settings)
