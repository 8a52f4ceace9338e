"""A TCP port that goes on to serve whom it has, whoever knocks: it accepts a few at a time, and pauses when the process has no descriptors."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
from collections.abc import AsyncIterator, Callable
from typing import Any

from uwserver.adapter.listening import ANOTHER, cannot_listen
from uwserver.adapter.peers import Peers, host_of
from uwserver.adapter.refusals import Refusals
from uwserver.adapter.tls import handshake_refusal

BACKLOG = 256
"""Connections that wait in the kernel to be accepted."""
AT_ONCE = 16
"""Connections accepted before the loop does something else."""
PAUSE_S = 0.5
"""Wall time for which nobody is accepted when there are no descriptors left."""
HANDSHAKE_S = 10.0
"""Wall time in which a peer must have ended its TLS handshake, unless the adapter says otherwise."""
NO_DESCRIPTORS = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))


def note_no_descriptors(error: OSError, refusals: Refusals) -> None:
    """Tell that nobody can be accepted now."""
    text = f"no connection can be accepted ({error.strerror}), those that knock wait: raise `ulimit -n`, or close files and clients"
    refusals.note("descriptors", text)


class _Arrival:
    """A peer from its acceptance until its protocol has it: while TLS shakes hands it is a stranger like others."""

    is_half_open = False

    def __init__(self, listener: Listener, stream: socket.socket) -> None:
        self._listener = listener
        self._stream = stream
        self._has_begun = False
        self._task = asyncio.get_running_loop().create_task(self._shake_hands())
        self._task.add_done_callback(self._ended)

    def close(self) -> None:
        """It is not let in."""
        self._task.cancel()

    abort = close

    async def _shake_hands(self) -> None:
        self._has_begun = True
        tls = self._listener.tls
        timeout = None if tls is None else self._listener.handshake_s
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                self._protocol, self._stream, ssl=tls, ssl_handshake_timeout=timeout
            )
        except ssl.SSLError as error:
            self._refuse(str(error.reason or "unknown"))
        except ConnectionAbortedError:
            self._refuse("TIMEOUT")
        except OSError:
            pass  # it went away; port scanners and health checks do

    def _protocol(self) -> asyncio.Protocol:
        if self._listener.tls is None:
            self._listener.peers.leave(self)  # what is made now enters itself
        return self._listener.make()

    def _refuse(self, reason: str) -> None:
        self._listener.peers.refusals.note(*handshake_refusal(reason))

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not self._has_begun:
            self._stream.close()
        self._listener.peers.leave(self)
        if not task.cancelled() and (error := task.exception()) is not None:
            raise error  # a fault of ours, for the loop's log


class Listener:
    """Accepts on the sockets of one port.

    Args:
        sockets: listening, non-blocking.
        make: a protocol for each peer.
        peers: those that have come.
        tls: what TLS needs; None for a plain port.
        handshake_s: wall time in which a peer must have ended its TLS handshake.

    Attributes:
        sockets, make, peers, tls, handshake_s: as given.
    """

    def __init__(
        self,
        sockets: list[socket.socket],
        make: Callable[[], asyncio.Protocol],
        peers: Peers[Any],
        tls: ssl.SSLContext | None,
        handshake_s: float,
    ) -> None:
        self.sockets = sockets
        self.make = make
        self.peers = peers
        self.tls = tls
        self.handshake_s = handshake_s
        self._loop = asyncio.get_running_loop()
        self._resuming: dict[socket.socket, asyncio.TimerHandle] = {}
        self._is_closed = False
        for listener in sockets:
            self._resume(listener)

    @property
    def port(self) -> int:
        """The port that it has really got."""
        return int(self.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Accept nobody any more. May be called again."""
        if not self._is_closed:
            self._is_closed = True
            for listener in self.sockets:
                self._loop.remove_reader(listener)
                listener.close()
            for timer in self._resuming.values():
                timer.cancel()

    def _resume(self, listener: socket.socket) -> None:
        self._resuming.pop(listener, None)
        self._loop.add_reader(listener, self._accept, listener)

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(AT_ONCE):
            try:
                stream, address = listener.accept()
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                if error.errno in NO_DESCRIPTORS:
                    note_no_descriptors(error, self.peers.refusals)
                    self._loop.remove_reader(listener)
                    self._resuming[listener] = self._loop.call_later(PAUSE_S, self._resume, listener)
                    return
                continue  # it went away before it was accepted
            stream.setblocking(False)
            self.peers.enter(_Arrival(self, stream), host_of(address))


@contextlib.asynccontextmanager
async def serve_tcp(
    make: Callable[[], asyncio.Protocol],
    peers: Peers[Any],
    bind: str,
    port: int,
    *,
    key: str = "port",
    rival: str = ANOTHER,
    tls: ssl.SSLContext | None = None,
    handshake_s: float = HANDSHAKE_S,
) -> AsyncIterator[Listener]:
    """A TCP server while the context is open; then all peers are closed, those that do not go are cut off.

    Args:
        make: a protocol for each that connects, usually a `Connection`.
        peers: those that have connected.
        bind, port: the address; port 0 takes a free one.
        key: of the adapter's table that gives the port.
        rival: who most likely holds the port when it is in use.
        tls, handshake_s: see `Listener`.

    Raises:
        CannotListen: the address cannot be had.
    """
    try:
        listener = Listener(await _bound(bind, port), make, peers, tls, handshake_s)
    except OSError as error:
        raise cannot_listen(error, bind, port, key=key, rival=rival) from error
    try:
        yield listener
    finally:
        listener.close()
        await peers.close()


async def _bound(bind: str, port: int) -> list[socket.socket]:
    """A socket for each address that a name stands for, all at the same port."""
    try:  # an address: no thread is needed to look it up
        found = socket.getaddrinfo(
            bind or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE | socket.AI_NUMERICHOST
        )
    except socket.gaierror:
        found = await asyncio.get_running_loop().getaddrinfo(bind, port, type=socket.SOCK_STREAM)
    sockets: list[socket.socket] = []
    try:
        for family, address in dict.fromkeys((family, address) for family, _, _, _, address in found):
            listener = socket.socket(family, socket.SOCK_STREAM)
            sockets.append(listener)
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # Whom it accepts inherits this. asyncio sets it only for sockets whose protocol number is given; without it a reply behind a
            # sample waits for the peer's delayed acknowledgement, 40 ms.
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            listener.bind((address[0], port, *address[2:]))
            listener.listen(BACKLOG)
            port = int(listener.getsockname()[1])
    except OSError:
        for listener in sockets:
            listener.close()
        raise
    return sockets
