"""UDP: to one place, or for all who come."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterator
from typing import Protocol, cast

from uwserver.adapter import DatagramTurns, cannot_listen
from uwserver_adapters.mavlink.links.endpoint import PORT_KEY, READY, RIVAL, WAITING, Address, Link, shown
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.wire.channel import Channel

SILENT_S = 30.0
"""Wall time after which a peer that says nothing is forgotten."""
PEERS = 32
"""Peers of a socket; others are refused until one is forgotten."""


class _Datagrams(Protocol):
    """asyncio's datagram transport, with the method that its stubs lack."""

    def get_write_buffer_size(self) -> int: ...
    def is_closing(self) -> bool: ...
    def sendto(self, data: bytes, addr: Address | None = None) -> None: ...
    def abort(self) -> None: ...


class _Socket(Link, asyncio.DatagramProtocol):
    """What both kinds share: how datagrams are written."""

    def __init__(self, kind: str, address: Address, router: Router) -> None:
        super().__init__(shown(kind, address), router)
        self._given = address
        self._transport: _Datagrams | None = None
        self._turns: DatagramTurns | None = None

    def _take(self, sender: Hashable, data: bytes, work: Callable[[], Iterator[None]]) -> None:
        """Take a datagram at its sender's turn."""
        if self._turns is None:
            self._turns = DatagramTurns(self._router.turns)
        if not self._turns.put(sender, len(data), work):
            self._router.count("flood")

    def connection_lost(self, exc: Exception | None) -> None:
        """What waits is not looked at any more."""
        if self._turns is not None:
            self._turns.close()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there, yet or any more: they may come, and silence tells who is gone."""

    def _is_ready(self) -> bool:
        return self._transport is not None and self._transport.get_write_buffer_size() < READY

    def _write(self, data: bytes, addr: Address | None = None) -> bool:
        if self._transport is None or self._transport.is_closing() or self._transport.get_write_buffer_size() > WAITING:
            return False
        self._transport.sendto(data, addr)
        return True


class UdpOut(_Socket):
    """Sends to one place, whether somebody listens or not, and hears its answers."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__("udpout", address, router)
        self._channel: Channel | None = None

    async def open(self) -> None:
        """Resolve the host; it is tried again when that fails."""
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=self._given)
        except OSError as error:
            self._stats.last_error = f"link {self.address}: {error}; it is tried again"
            return
        self._transport = cast(_Datagrams, transport)
        self._channel = self._router.open(self.address, self._write, self._is_ready)

    async def attend(self) -> None:
        """Open it, if it could not be; a peer that is silent is not there any more."""
        if self._transport is None:
            await self.open()
        channel = self._channel
        if channel is not None and channel.has_peer and _is_silent(channel):
            channel.has_peer = False
            self._router.count_peers()

    async def close(self) -> None:
        """Close the socket."""
        if self._channel is not None:
            self._router.close(self._channel)
        if self._transport is not None:
            self._transport.abort()

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Take a datagram."""
        channel = self._channel
        if channel is not None:
            self._take(channel, data, lambda: self._router.frames(channel, data))


class UdpIn(_Socket):
    """Waits for peers; each address is a channel of its own."""

    def __init__(self, address: Address, router: Router) -> None:
        super().__init__("udpin", address, router)
        self._channels: dict[Address, Channel] = {}

    async def open(self) -> None:
        """Bind."""
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: self, local_addr=self._given
            )
        except OSError as error:
            raise cannot_listen(error, *self._given, "udp", key=PORT_KEY, rival=RIVAL) from error
        self._transport = cast(_Datagrams, transport)
        self.address = shown("udpin", transport.get_extra_info("sockname")[:2])

    async def attend(self) -> None:
        """Forget who is silent."""
        for peer, channel in list(self._channels.items()):
            if _is_silent(channel):
                self._router.close(channel)
                del self._channels[peer]

    async def close(self) -> None:
        """Close the socket."""
        for channel in self._channels.values():
            self._router.close(channel)
        self._channels.clear()
        if self._transport is not None:
            self._transport.abort()

    def datagram_received(self, data: bytes, addr: tuple[object, ...]) -> None:
        """Take a datagram of an old or a new peer. What a flood brings does not even wait."""
        peer = cast(Address, addr[:2])
        channel = self._channels.get(peer)
        if channel is not None and channel.meter.is_flooded(asyncio.get_running_loop().time()):
            self._router.count("flood")
            return
        # Those of whom nothing is known have one turn together: their addresses may be forged.
        self._take(channel, data, lambda: self._frames(peer, cast(Address, addr), data))

    def _frames(self, peer: Address, full: Address, data: bytes) -> Iterator[None]:
        channel = self._channels.get(peer)
        if channel is None:
            if len(self._channels) >= PEERS:
                self._stats.dropped += 1
                self._stats.last_error = f"link {self.address}: more than {PEERS} peers"
                return
            channel = self._router.open(shown("udp", peer), lambda sent: self._write(sent, full), self._is_ready)
            self._channels[peer] = channel
        yield from self._router.frames(channel, data)
        if (
            not channel.has_peer
        ):  # what it said was no MAVLink: it hears nothing, so that nobody is flooded by a forged address
            self._router.close(channel)
            self._channels.pop(peer, None)


def _is_silent(channel: Channel) -> bool:
    return asyncio.get_running_loop().time() - channel.heard_at > SILENT_S
