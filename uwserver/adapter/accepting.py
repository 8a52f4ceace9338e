"""A TCP port that keeps serving its peers however many more connect: it accepts a few at a time, and pauses when the process has no
descriptors left."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

from uwserver.adapter.access import handshake_refusal
from uwserver.adapter.base import Refusals
from uwserver.adapter.listening import ANOTHER, cannot_listen
from uwserver.adapter.peers import Peers, host_of

BACKLOG = 256
"""Connections that may wait in the kernel to be accepted."""
AT_ONCE = 16
"""Connections that are accepted before the loop does something else."""
PAUSE_S = 0.5
"""Wall time for which no connection is accepted when there are no descriptors left."""
HANDSHAKE_S = 10.0
"""Wall time in which a peer must complete its TLS handshake, unless the adapter sets another limit."""
NO_DESCRIPTORS = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))


def note_no_descriptors(error: OSError, refusals: Refusals) -> None:
    """Report that no connection can be accepted now."""
    text = f"no connection can be accepted ({error.strerror}), new ones wait: raise `ulimit -n`, or close files and clients"
    refusals.note("descriptors", text)


class _Arrival:
    """A connection between its acceptance and the start of its protocol, which takes as long as the TLS handshake."""

    def __init__(self, listener: TcpListener, stream: socket.socket) -> None:
        self._listener = listener
        self._stream = stream
        self._has_begun = False
        self._task = asyncio.get_running_loop().create_task(self._shake_hands())
        self._task.add_done_callback(self._ended)

    def abort(self) -> None:
        """Refuse the peer."""
        self._task.cancel()

    async def _shake_hands(self) -> None:
        self._has_begun = True
        tls = self._listener.tls
        timeout = None if tls is None else self._listener.handshake_s
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                self._protocol, self._stream, ssl=tls, ssl_handshake_timeout=timeout
            )
        except OSError as error:
            # Other errors mean that the peer went away, as port scanners and health checks do.
            if isinstance(error, ssl.SSLError | ConnectionAbortedError):
                reason = str(error.reason or "unknown") if isinstance(error, ssl.SSLError) else "TIMEOUT"
                self._listener.peers.refusals.note(*handshake_refusal(reason))

    def _protocol(self) -> asyncio.Protocol:
        if self._listener.tls is None:
            # The protocol that is made now enters the peers itself.
            self._listener.peers.leave(self)
        return self._listener.make()

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not self._has_begun:
            self._stream.close()
        self._listener.peers.leave(self)
        if not task.cancelled() and (error := task.exception()) is not None:
            # A fault of uwserver, which the loop logs.
            raise error


@dataclass(eq=False)
class TcpListener:
    """Accepts connections on the sockets of one port.

    Attributes:
        sockets: listening and non-blocking.
        make: makes a protocol for each peer.
        peers: the peers of the adapter.
        tls: the context of TLS; None for a plain port.
        handshake_s: wall time in which a peer must complete its TLS handshake.
    """

    sockets: list[socket.socket]
    make: Callable[[], asyncio.Protocol]
    peers: Peers[Any]
    tls: ssl.SSLContext | None
    handshake_s: float

    def __post_init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._resuming: dict[socket.socket, asyncio.TimerHandle] = {}
        self._is_closed = False
        for listener in self.sockets:
            self._resume(listener)

    @property
    def port(self) -> int:
        """The port on which it listens, also if a free one was asked for."""
        return int(self.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Stop accepting. May be called again."""
        if self._is_closed:
            return
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
                # The peer went away before it was accepted.
                continue
            stream.setblocking(False)
            self.peers.arrive(_Arrival(self, stream), host_of(address))


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
) -> AsyncIterator[TcpListener]:
    """Serve TCP while the context is open, and then close all peers.

    Args:
        make: makes a protocol for each peer, usually a `Connection`.
        peers: the peers of the adapter.
        bind, port: the address; port 0 takes a free one.
        key: key of the adapter's table that sets the port.
        rival: the program that most likely has the port when it is in use.
        tls, handshake_s: see `TcpListener`.

    Raises:
        CannotListen: the address is not available.
    """
    try:
        listener = TcpListener(await _bound(bind, port), make, peers, tls, handshake_s)
    except OSError as error:
        raise cannot_listen(error, bind, port, key=key, rival=rival) from error
    try:
        yield listener
    finally:
        listener.close()
        await peers.close()


async def _bound(bind: str, port: int) -> list[socket.socket]:
    """Return a listening socket for each address of a name, all at the same port."""
    try:
        # An address needs no lookup, for which the loop would start a thread.
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
            # Accepted sockets inherit this option. asyncio sets it only for sockets whose protocol number is given. Without it, a reply that
            # follows a sample waits 40 ms for the peer's delayed acknowledgement.
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
