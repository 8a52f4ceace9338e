"""UDP links: one that sends to a given address, and one that listens for peers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterator
from typing import Any, cast

from uwserver.adapter import DatagramTurns, cannot_listen
from uwserver_adapters.mavlink.links.endpoint import PORT_KEY, READY, RIVAL, WAITING, Address, Link, shown
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.wire.channel import Channel

SILENT_S = 30.0
"""Wall time after which a silent peer is forgotten."""
PEERS = 32
"""Peers of a socket. Others are refused until one is forgotten."""


class _Socket(Link, asyncio.DatagramProtocol):
    """What both kinds share: a socket whose peers have a channel each."""

    def __init__(self, kind: str, address: Address, router: Router) -> None:
        super().__init__(shown(kind, address), router)
        self._given = address
        self._channels: dict[Address, Channel] = {}
        self._turns = DatagramTurns(router.turns)
        self._transport: Any = None  # asyncio's stubs do not know the buffer size of a datagram transport

    async def close(self) -> None:
        """Close the channels and the socket."""
        for channel in self._channels.values():
            self._router.close(channel)
        self._channels.clear()
        if self._transport is not None:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Drop the datagrams that still wait for their turn."""
        self._turns.close()

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens at a peer's address. The peer may still come; if it has gone, its silence shows that."""

    def _take(self, sender: Hashable, data: bytes, work: Callable[[], Iterator[None]]) -> None:
        """Take a datagram at its sender's turn."""
        if not self._turns.put(sender, len(data), work):
            self._router.counters["flood"] += 1

    def _is_ready(self) -> bool:
        return self._transport is not None and self._transport.get_write_buffer_size() < READY

    def _write(self, data: bytes, addr: Address | None = None) -> bool:
        if self._transport is None or self._transport.is_closing() or self._transport.get_write_buffer_size() > WAITING:
            return False
        self._transport.sendto(data, addr)
        return True


class UdpOut(_Socket):
    """Sends to one address, whether or not somebody listens there, and takes the answers."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__("udpout", address, router)

    async def attend(self) -> None:
        """Open the socket if that has not succeeded yet. A silent peer no longer counts as there."""
        if self._transport is None:
            await self._connect()
        for channel in self._channels.values():
            if channel.has_peer and _is_silent(channel):
                channel.has_peer = False
                self._router.count_peers()

    async def _connect(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=self._given)
        except OSError as error:
            self._stats.last_error = f"link {self.address}: {error}; it is tried again"
        else:
            self._channels[self._given] = self._router.open(self.address, self._write, self._is_ready)

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Take a datagram."""
        channel = self._channels.get(self._given)
        if channel is not None:
            self._take(channel, data, lambda: self._router.frames(channel, data))


class UdpIn(_Socket):
    """Listens for peers. Each address is a channel of its own."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__("udpin", address, router)

    async def open(self) -> None:
        """Bind the socket."""
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=self._given)
        except OSError as error:
            raise cannot_listen(error, *self._given, "udp", key=PORT_KEY, rival=RIVAL) from error
        self.address = shown("udpin", self._transport.get_extra_info("sockname")[:2])

    async def attend(self) -> None:
        """Forget silent peers."""
        for peer, channel in list(self._channels.items()):
            if _is_silent(channel):
                self._router.close(channel)
                del self._channels[peer]

    def datagram_received(self, data: bytes, addr: tuple[object, ...]) -> None:
        """Take a datagram of a known or a new peer. A datagram of a peer that floods is dropped at once."""
        peer = cast(Address, addr[:2])
        channel = self._channels.get(peer)
        if channel is not None and channel.meter.is_flooded(asyncio.get_running_loop().time()):
            self._router.counters["flood"] += 1
            return
        # All unknown peers share one turn, because their addresses may be forged.
        self._take(channel, data, lambda: self._frames(peer, cast(Address, addr), data))

    def _frames(self, peer: Address, full: Address, data: bytes) -> Iterator[None]:
        channel = self._channels.get(peer)
        if channel is None:
            if len(self._channels) >= PEERS:
                self._stats.dropped += 1
                self._stats.last_error = f"link {self.address}: more than {PEERS} peers; others are refused"
                return
            channel = self._router.open(shown("udp", peer), lambda sent: self._write(sent, full), self._is_ready)
            self._channels[peer] = channel
        yield from self._router.frames(channel, data)
        # A peer that did not speak MAVLink gets no telemetry, so that a forged address floods nobody.
        if not channel.has_peer:
            self._router.close(channel)
            self._channels.pop(peer, None)


def _is_silent(channel: Channel) -> bool:
    return asyncio.get_running_loop().time() - channel.heard_at > SILENT_S
