"""Links by streams of bytes: a TCP listener, a TCP connection that is made again and again, and a serial line or pseudo-terminal."""

from __future__ import annotations

import asyncio
import contextlib
import math

from uwserver.adapter import Connection, Peers, SerialPort, serve_tcp, within
from uwserver.ports import Fault
from uwserver_adapters.mavlink.links.endpoint import PORT_KEY, READY, RETRY_S, RIVAL, WAITING, Address, Link, shown
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.wire.channel import Channel

CONNECT_S = 5.0
"""Wall time that a connection attempt may take."""
PEERS = 64
"""Connections at a time that have sent a valid frame. Connections that only listen stay until others need their place."""


class TcpPeer(Connection):
    """One TCP connection.

    Args:
        router: the router of the vehicle.
        peers: the connections of the link.
        name: name of the channel. Default: the peer's address; such a peer counts as a stranger until it has sent a valid frame.

    Attributes:
        gone: done when the connection has ended.
    """

    def __init__(self, router: Router, peers: Peers[TcpPeer], name: str = "") -> None:
        super().__init__(peers, None if name else math.inf)
        self.gone: asyncio.Future[None] = self.loop.create_future()
        self._router = router
        self._name = name
        self._channel: Channel | None = None

    def opened(self) -> None:
        """Open a channel for the connection."""
        name = self._name or shown("tcp", self.transport.get_extra_info("peername")[:2])
        self._channel = self._router.open(name, self._send, lambda: self.waiting < READY, has_peer=True)
        self._rate = self._channel.meter

    def closed(self) -> None:
        """Close the channel."""
        if self._channel is not None:
            self._router.close(self._channel)
        self.gone.set_result(None)

    def receive(self, data: bytes) -> None:
        """Store received bytes."""
        if self._channel is not None:
            self._channel.decoder.receive(data)

    def step(self) -> bool:
        """Take the next frame. Returns False when there is none, or the peer was not admitted."""
        channel = self._channel
        if channel is None or not self._router.work(channel):
            return False
        return not channel.is_heard or self.admit()

    def refused(self, fault: Fault) -> bytes:
        """Return nothing: MAVLink has no message that refuses a connection."""
        return b""

    def _send(self, data: bytes) -> bool:
        if self.is_closing or self.waiting > WAITING:
            return False
        self.write(data)
        return True


class TcpIn(Link):
    """Listens. Each connection is a channel of its own."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__(shown("tcpin", address), router)
        self._at = address
        self._peers: Peers[TcpPeer] = Peers(PEERS, router.refusals)
        self._open = contextlib.AsyncExitStack()

    async def open(self) -> None:
        """Listen."""
        serving = serve_tcp(
            lambda: TcpPeer(self._router, self._peers), self._peers, *self._at, key=PORT_KEY, rival=RIVAL
        )
        server = await self._open.enter_async_context(serving)
        self.address = shown("tcpin", server.sockets[0].getsockname()[:2])

    async def close(self) -> None:
        """Close all connections and the listener."""
        await self._open.aclose()


class TcpOut(Link):
    """Connects to one address, and again when the connection has ended."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__(shown("tcpout", address), router)
        self._to = address
        self._peers: Peers[TcpPeer] = Peers(1, router.refusals)
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Begin to connect. The peer may come later."""
        self._task = asyncio.ensure_future(self._keep())

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                making = loop.create_connection(lambda: TcpPeer(self._router, self._peers, self.address), *self._to)
                _, peer = await within(CONNECT_S, making, "no answer")
                await peer.gone
                self._stats.last_error = f"link {self.address}: the connection ended; it is tried again"
            except OSError as error:
                self._stats.last_error = f"link {self.address}: {error}; it is tried again"
            await asyncio.sleep(RETRY_S / 4)

    async def close(self) -> None:
        """Close the connection."""
        if self._task is not None:
            self._task.cancel()
        for peer in self._peers:
            peer.abort()


class SerialLink(Link):
    """A device that may come and go. Opening it is tried again and again.

    Args:
        path: path of the device.
        router: the router of the vehicle.
    """

    def __init__(self, path: str, router: Router) -> None:
        super().__init__(f"serial:{path}", router)
        self._channel: Channel | None = None
        self._port = SerialPort(path, router.context, opened=self._opened, received=self._received, closed=self._closed)

    async def attend(self) -> None:
        """Open the device if it is not open."""
        self._port.attend()

    async def close(self) -> None:
        """Close the device."""
        self._port.close()

    def _opened(self) -> None:
        self._channel = self._router.open(self.address, self._port.write, lambda: self._port.waiting < READY // 4)

    def _received(self, data: bytes) -> None:
        if self._channel is not None:
            self._router.receive(self._channel, data)

    def _closed(self) -> None:
        if self._channel is not None:
            self._router.close(self._channel)
            self._channel = None
