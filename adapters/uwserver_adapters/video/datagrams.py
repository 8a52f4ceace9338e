"""Pictures as datagrams, sent on a thread of their own: a large picture is a thousand packets for each receiver, too many for the loop.

RTSP clients that take datagrams share two UDP ports of ours, one for RTP and one for reports.
"""

from __future__ import annotations

import asyncio
import selectors
import socket
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

from uwserver.adapter import AdapterStats, CannotListen, Worker, bound_socket, cannot_listen
from uwserver_adapters.video.stream import Picture

WAITING: Final = 2
"""Pictures that may be on their way to one address, including the one that is being sent."""
PATIENCE_S: Final = 0.1
"""Wall time for which a picture waits until the system accepts its packets. Then the rest of it is dropped."""

Address = tuple[str, int]
_TRIES: Final = 16


class DatagramSocket(Protocol):
    """A non-blocking socket for datagrams."""

    def sendto(self, data: bytes, address: Address, /) -> int:
        """Send a datagram."""

    def fileno(self) -> int:
        """Return its file descriptor."""


class Sender:
    """The thread that sends datagrams to all addresses of an adapter. Runs on the loop thread, except for the sending.

    Args:
        stats: counts pictures that the system did not accept completely.
    """

    def __init__(self, stats: AdapterStats) -> None:
        self._stats = stats
        self._time = asyncio.get_running_loop().time
        self._worker = Worker("video datagrams", stats)
        self._sockets: list[socket.socket] = []
        self._is_over = False

    def own(self, out: socket.socket) -> socket.socket:
        """Close this socket at the end."""
        self._sockets.append(out)
        return out

    def route(self, media: DatagramSocket, to: Address) -> Route:
        """Return a route for the pictures of one receiver, sent by this socket."""
        return Route(self, media, to)

    def hand_over(self, route: Route, parts: Sequence[tuple[DatagramSocket, Address, Sequence[bytes]]]) -> bool:
        """Send packets by their sockets. Returns False when too much waits for the thread."""
        return self._worker.send(lambda: self._send(route, parts))

    def _send(self, route: Route, parts: Sequence[tuple[DatagramSocket, Address, Sequence[bytes]]]) -> None:
        """Send packets. Runs on the sending thread."""
        end = self._time() + PATIENCE_S
        try:
            for out, to, packets in parts:
                for packet in packets:
                    if self._is_over or route.is_over:
                        return
                    if not _is_sent(out, packet, to, lambda: end - self._time()):
                        self._stats.dropped += 1
                        return
        finally:
            route.done += 1

    async def close(self) -> None:
        """End the thread and close its sockets. Pictures that wait are dropped."""
        self._is_over = True
        await self._worker.run(self._close_sockets)
        await self._worker.close(lambda: None)

    def _close_sockets(self) -> None:
        """Close the sockets. Runs on the sending thread, which no longer uses them."""
        for out in self._sockets:
            out.close()


class Route:
    """The way to one receiver. Runs on the loop thread, except for `done`.

    Attributes:
        done: pictures that were sent, complete or not; the sending thread counts them.
        is_over: nothing more is sent there, not even the rest of a picture.
    """

    def __init__(self, sender: Sender, media: DatagramSocket, to: Address) -> None:
        self.done = 0
        self.is_over = False
        self._handed = 0
        self._sender = sender
        self._media = media
        self._to = to

    def send(self, packets: Sequence[bytes], *more: tuple[DatagramSocket, Address, Sequence[bytes]]) -> bool:
        """Send the packets of a picture, then others by sockets of their own. Returns False while earlier ones are still on their way."""
        if self._handed - self.done >= WAITING:
            return False
        self._handed += 1
        if not self._sender.hand_over(self, ((self._media, self._to, packets), *more)):
            self._handed -= 1
            return False
        return True


class Target:
    """Sends a stream to an address of the table, whether or not somebody listens there.

    Args:
        route: the route to the address. Reports are not sent, because the port after it may belong to another stream.
        stats: the adapter's statistics.
    """

    def __init__(self, route: Route, stats: AdapterStats) -> None:
        self._route = route
        self._stats = stats

    def take(self, picture: Picture) -> None:
        """Send a picture, or drop it while earlier ones are still on their way."""
        if self._route.send(picture.packets):
            self._stats.samples_sent += 1
            self._stats.bytes_sent += picture.size
        else:
            self._stats.dropped += 1


def _is_sent(out: DatagramSocket, packet: bytes, to: Address, rest_s: Callable[[], float]) -> bool:
    while True:
        try:
            out.sendto(packet, to)
        except BlockingIOError:
            if not _is_free(out, rest_s()):
                return False
        except OSError:  # there is no way to the address now
            return False
        else:
            return True


def _is_free(out: Any, rest_s: float) -> bool:
    """Wait until the system accepts more, at most `rest_s`. Returns whether it does."""
    if rest_s <= 0.0:
        return False
    with selectors.DefaultSelector() as selector:
        selector.register(out, selectors.EVENT_WRITE)
        return bool(selector.select(rest_s))


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
