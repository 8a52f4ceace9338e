"""TCP: for all who connect, or to one place again and again."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable
from typing import cast

from uwserver.adapter import AdapterStats
from uwserver_adapters.mavlink.links.endpoint import READY, RETRY_S, WAITING, Address, cannot_listen, shown
from uwserver_adapters.mavlink.links.hub import Hub
from uwserver_adapters.mavlink.wire.channel import Channel

CONNECT_S = 5.0
"""Wall time for a connection."""
TURN_S = 0.002
"""Wall time after which others have their turn."""


class TcpPeer(asyncio.Protocol):
    """One TCP connection."""

    def __init__(self, hub: Hub, name: str, gone: Callable[[TcpPeer], None]) -> None:
        self._hub = hub
        self._name = name
        self._gone = gone
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport
        self._channel: Channel | None = None
        self._turn: asyncio.Handle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A channel begins."""
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        name = self._name or shown("tcp", peer[:2])
        self._channel = self._hub.open(name, self._write, self._is_ready, has_peer=True)

    def connection_lost(self, error: Exception | None) -> None:
        """It is gone."""
        if self._turn is not None:
            self._turn.cancel()
        if self._channel is not None:
            self._hub.close(self._channel)
        self._gone(self)

    def data_received(self, data: bytes) -> None:
        """Take bytes in pieces of any size."""
        if self._channel is not None:
            self._channel.decoder.receive(data)
            if self._turn is None:
                self._work()

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._channel is not None and self._hub.work(self._channel):
            if self._loop.time() > end:
                self._transport.pause_reading()
                self._turn = self._loop.call_soon(self._work)
                return
        if not self._transport.is_closing():
            self._transport.resume_reading()

    def _is_ready(self) -> bool:
        return self._transport.get_write_buffer_size() < READY

    def _write(self, data: bytes) -> bool:
        if self._transport.is_closing() or self._transport.get_write_buffer_size() > WAITING:
            return False
        self._transport.write(data)
        return True

    def abort(self) -> None:
        """End it at once."""
        self._transport.abort()


class TcpIn:
    """Listens; each connection is a channel of its own."""

    def __init__(self, address: Address, hub: Hub, stats: AdapterStats) -> None:
        self.address = shown("tcpin", address)
        self._at = address
        self._hub = hub
        self._server: asyncio.Server | None = None
        self._peers: dict[TcpPeer, None] = {}

    async def open(self) -> None:
        """Listen."""

        def connected() -> TcpPeer:
            peer = TcpPeer(self._hub, "", lambda gone: self._peers.pop(gone, None))
            self._peers[peer] = None
            return peer

        try:
            self._server = await asyncio.get_running_loop().create_server(connected, *self._at)
        except OSError as error:
            raise cannot_listen(error, "tcpin", self._at) from error
        self.address = shown("tcpin", self._server.sockets[0].getsockname()[:2])

    async def attend(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Close all."""
        if self._server is not None:
            self._server.close()
        for peer in list(self._peers):
            peer.abort()


class TcpOut:
    """Connects, and connects again."""

    def __init__(self, address: Address, hub: Hub, stats: AdapterStats) -> None:
        self.address = shown("tcpout", address)
        self._to = address
        self._hub = hub
        self._stats = stats
        self._peer: TcpPeer | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Begin to connect; the peer may come later."""
        self._task = asyncio.ensure_future(self._keep())

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            gone: asyncio.Future[None] = loop.create_future()
            try:
                make = functools.partial(TcpPeer, self._hub, self.address, _resolver(gone))
                making = loop.create_connection(make, *self._to)
                _, self._peer = await asyncio.wait_for(making, CONNECT_S)
                await gone
                self._stats.last_error = f"link {self.address}: the connection ended; it is tried again"
            except (OSError, asyncio.TimeoutError) as error:
                self._stats.last_error = f"link {self.address}: {error or 'no answer'}; it is tried again"
            await asyncio.sleep(RETRY_S / 4)

    async def attend(self) -> None:
        """It attends to itself."""

    def close(self) -> None:
        """Close the connection."""
        if self._task is not None:
            self._task.cancel()
        if self._peer is not None:
            self._peer.abort()


def _resolver(gone: asyncio.Future[None]) -> Callable[[TcpPeer], None]:
    def resolve(_: TcpPeer) -> None:
        if not gone.done():
            gone.set_result(None)

    return resolve
