"""Our two UDP ports, for RTP and for reports, shared by all RTSP clients that take datagrams."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Final, NamedTuple

from uwserver.adapter import CannotListen, bound_socket, cannot_listen
from uwserver_adapters.video.datagrams import Address, Route, Sender

_TRIES: Final = 16


class MediaPorts:
    """A pair of ports, opened once and closed once.

    Args:
        bind: address of the server.
        sender: sends the pictures.

    Attributes:
        numbers: numbers of our ports.
    """

    def __init__(self, bind: str, sender: Sender) -> None:
        self.numbers = (0, 0)
        self._bind = bind
        self._sender = sender
        self._bound: tuple[_Bound, ...] = ()
        self._heard: dict[Address, Callable[[], None]] = {}

    async def open(self) -> None:
        """Take an even port and the next one, as receivers expect, or any two if that does not succeed.

        Raises:
            CannotListen: no port is free.
        """
        for _ in range(_TRIES):
            first = await self._bind_port(0)
            number = first.number
            other = number + 1 if number % 2 == 0 else number - 1
            try:
                second = await self._bind_port(other)
            except CannotListen:
                first.transport.abort()
                continue
            self._keep((first, second) if number % 2 == 0 else (second, first))
            return
        self._keep((await self._bind_port(0), await self._bind_port(0)))

    async def _bind_port(self, port: int) -> _Bound:
        out = bound_socket(self._bind, port, "udp")
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _Reports(self._heard), sock=out
            )
        except OSError as error:
            out.close()
            raise cannot_listen(error, self._bind, port, "udp", key="udp") from error
        return _Bound(transport, out)

    def _keep(self, pair: tuple[_Bound, _Bound]) -> None:
        """Keep the ports. The loop closes the sockets by which it receives, so the sender gets duplicates of its own."""
        self._bound, self.numbers = pair, (pair[0].number, pair[1].number)
        self._media, self._reports = (self._sender.own(each.socket.dup()) for each in pair)

    def enter(self, reports_of: Address, heard: Callable[[], None]) -> None:
        """Call `heard` for each report from an address."""
        self._heard[reports_of] = heard

    def leave(self, reports_of: Address) -> None:
        """Stop calling for reports from an address."""
        self._heard.pop(reports_of, None)

    def route(self, to: Address) -> Route:
        """Return a route to a client's port."""
        return self._sender.route(self._media, to)

    def send(self, packets: list[bytes], report: bytes, route: Route, reports_to: Address) -> bool:
        """Send packets, and a report (b"" for none) to the client's other port. Returns False while earlier pictures are still on their way."""
        return route.send(packets, (self._reports, reports_to, [report] if report else []))

    def close(self) -> None:
        """Receive nothing more. The ports are free when the sender has been closed too."""
        for bound in self._bound:
            bound.transport.abort()
        self._heard.clear()


class _Bound(NamedTuple):
    """One of the ports, received by the loop."""

    transport: asyncio.DatagramTransport
    socket: socket.socket

    @property
    def number(self) -> int:
        """Number of the port."""
        return int(self.transport.get_extra_info("sockname")[1])


class _Reports(asyncio.DatagramProtocol):
    """Receives reports, and ignores everything else."""

    def __init__(self, heard: dict[Address, Callable[[], None]]) -> None:
        self._heard = heard

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Note that the sender of a report is there. The content of the report is not used."""
        heard = self._heard.get((addr[0], addr[1]))
        if heard is not None and 192 <= (data[1] if len(data) >= 8 else 0) <= 223:
            heard()

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens any more. The client's silence shows that."""
