"""Our two ports of UDP, for RTP and for its reports, to all clients of RTSP that take datagrams."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Final, NamedTuple

from uwserver.adapter import CannotListen, bound_socket, cannot_listen
from uwserver_adapters.video.datagrams import Address, Route, Sender

_TRIES: Final = 16


class MediaPorts:
    """Opened once, closed once.

    Args:
        bind: address of the server.
        sender: of the pictures.
    """

    def __init__(self, bind: str, sender: Sender) -> None:
        self._bind = bind
        self._sender = sender
        self._pair: tuple[_Bound, _Bound] | None = None
        self._heard: dict[Address, Callable[[], None]] = {}

    async def open(self) -> None:
        """Take an even port and the next one, as receivers expect it.

        Raises:
            CannotListen: there is none.
        """
        for _ in range(_TRIES):
            first = await self._bound(0)
            number = first.number
            other = number + 1 if number % 2 == 0 else number - 1
            try:
                second = await self._bound(other)
            except CannotListen:
                first.transport.abort()
                continue
            self._keep((first, second) if number % 2 == 0 else (second, first))
            return
        self._keep((await self._bound(0), await self._bound(0)))

    async def _bound(self, port: int) -> _Bound:
        out = bound_socket(self._bind, port, "udp")
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _Ear(self._heard), sock=out
            )
        except OSError as error:
            out.close()
            raise cannot_listen(error, self._bind, port, "udp", key="udp") from error
        return _Bound(transport, out)

    def _keep(self, pair: tuple[_Bound, _Bound]) -> None:
        """The loop hears with its sockets, which it closes; the sender has ends of its own."""
        self._pair = pair
        self._media, self._reports = (self._sender.own(each.socket.dup()) for each in pair)

    @property
    def numbers(self) -> tuple[int, int]:
        """Our ports."""
        assert self._pair is not None
        first, second = self._pair
        return first.number, second.number

    def enter(self, reports_of: Address, heard: Callable[[], None]) -> None:
        """Call `heard` for each report that comes from there."""
        self._heard[reports_of] = heard

    def leave(self, reports_of: Address) -> None:
        """No more."""
        self._heard.pop(reports_of, None)

    def route(self, to: Address) -> Route:
        """To a client's port."""
        return self._sender.route(self._media, to)

    def send(self, packets: list[bytes], report: bytes, route: Route, reports_to: Address) -> bool:
        """Packets, and a report (b"" for none) to the client's other port; False when pictures before are still under way."""
        return route.send(packets, (self._reports, reports_to, [report] if report else []))

    def close(self) -> None:
        """Hear nothing more; the ports are free when the sender has closed too."""
        for bound in self._pair or ():
            bound.transport.abort()
        self._heard.clear()


class _Bound(NamedTuple):
    """One of the ports: heard by the loop."""

    transport: asyncio.DatagramTransport
    socket: socket.socket

    @property
    def number(self) -> int:
        """Of the port."""
        return int(self.transport.get_extra_info("sockname")[1])


class _Ear(asyncio.DatagramProtocol):
    """Reports of receivers, and what else comes."""

    def __init__(self, heard: dict[Address, Callable[[], None]]) -> None:
        self._heard = heard

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Who reports is there; what it says is of no use here."""
        heard = self._heard.get((addr[0], addr[1]))
        if heard is not None and 192 <= (data[1] if len(data) >= 8 else 0) <= 223:
            heard()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there any more: silence tells it."""
