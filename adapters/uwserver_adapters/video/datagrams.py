"""Pictures as datagrams, sent on a thread of their own: a large one is a thousand packets for each who takes it, too many for the loop."""

from __future__ import annotations

import asyncio
import selectors
import socket
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from uwserver.adapter import AdapterStats, Worker

WAITING: Final = 2
"""Pictures that may be under way to one address, the one that is being sent among them."""
PATIENCE_S: Final = 0.1
"""Wall time that a picture waits for the system to take its packets; then the rest of it is left out."""

Address = tuple[str, int]


class Out(Protocol):
    """A socket for datagrams that does not block."""

    def sendto(self, data: bytes, address: Address, /) -> int:
        """Send one."""

    def fileno(self) -> int:
        """Its descriptor."""


class Sender:
    """The thread, for all addresses of an adapter. Loop thread, but for the sending.

    Args:
        stats: counts pictures of which the system did not take all.
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

    def route(self, media: Out, to: Address) -> Route:
        """Where the pictures of one go who takes them, by this socket."""
        return Route(self, media, to)

    def hand_over(self, route: Route, parts: Sequence[tuple[Out, Address, Sequence[bytes]]]) -> bool:
        """Send packets by their sockets; False when too much waits for the thread."""
        return self._worker.send(lambda: self._send(route, parts))

    def _send(self, route: Route, parts: Sequence[tuple[Out, Address, Sequence[bytes]]]) -> None:
        """On the thread."""
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
        """End it, and close its sockets; what waits is not sent any more."""
        self._is_over = True
        await self._worker.run(self._close_sockets)
        await self._worker.close(lambda: None)

    def _close_sockets(self) -> None:
        """On the thread, which uses them no more."""
        for out in self._sockets:
            out.close()


class Route:
    """To one who takes pictures. Loop thread, but for `done`.

    Attributes:
        done: pictures that were sent, wholly or not; of the thread.
        is_over: nothing more goes there, not even of a picture that is being sent.
    """

    def __init__(self, sender: Sender, media: Out, to: Address) -> None:
        self.done = 0
        self.is_over = False
        self._handed = 0
        self._sender = sender
        self._media = media
        self._to = to

    def send(self, packets: Sequence[bytes], *more: tuple[Out, Address, Sequence[bytes]]) -> bool:
        """Packets of a picture, then others by sockets of their own; False when the ones before are still under way."""
        if self._handed - self.done >= WAITING:
            return False
        self._handed += 1
        if not self._sender.hand_over(self, ((self._media, self._to, packets), *more)):
            self._handed -= 1
            return False
        return True


def _is_sent(out: Out, packet: bytes, to: Address, rest_s: Callable[[], float]) -> bool:
    while True:
        try:
            out.sendto(packet, to)
        except BlockingIOError:
            if not _is_free(out, rest_s()):
                return False
        except OSError:  # no way there, for now
            return False
        else:
            return True


def _is_free(out: Any, rest_s: float) -> bool:
    """Whether the system takes more, which is waited for."""
    if rest_s <= 0.0:
        return False
    with selectors.DefaultSelector() as selector:
        selector.register(out, selectors.EVENT_WRITE)
        return bool(selector.select(rest_s))
