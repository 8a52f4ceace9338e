"""Links that carry bytes between a client and a server: over TCP, blocking and for asyncio.

The bytes are those of docs/reference/protocol.md on every network.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Awaitable, Callable
from typing import Protocol

_CHUNK = 1 << 16


class Link(Protocol):
    """One connection, used from one thread. Timeouts are in wall s: None waits for ever, 0 does not wait."""

    def send(self, data: bytes, timeout: float | None) -> None:
        """Send whole framed requests. Raises OSError."""
        ...

    def receive(self, timeout: float | None) -> bytes | None:
        """Return the next bytes, None if none came in time, or b"" if the server has ended the connection. Raises OSError."""
        ...

    def close(self) -> None:
        """End the connection. May be called again."""
        ...


Dial = Callable[[float], Link]
"""Makes a connection within a wall time in s. Raises OSError if nobody answers."""


class TcpLink:
    """A connected TCP socket."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected

    def send(self, data: bytes, timeout: float | None) -> None:
        """Send all of `data`. Raises OSError."""
        self._socket.settimeout(timeout)
        self._socket.sendall(data)

    def receive(self, timeout: float | None) -> bytes | None:
        """Return the next chunk; see `Link.receive`."""
        try:
            self._socket.settimeout(timeout)
            return self._socket.recv(_CHUNK)
        except (BlockingIOError, socket.timeout, ssl.SSLWantReadError):
            return None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def dial_tcp(host: str, port: int, tls: ssl.SSLContext | None, timeout: float) -> Link:
    """Connect, with TLS if there is a context. Raises OSError."""
    connected = socket.create_connection((host, port), timeout=timeout)
    connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if tls is None:
        return TcpLink(connected)
    try:
        return TcpLink(tls.wrap_socket(connected, server_hostname=host))
    except BaseException:
        connected.close()
        raise


def tls_context(ca: str | None = None, cert: str | None = None, key: str | None = None) -> ssl.SSLContext:
    """Return a TLS context.

    Args:
        ca: file of certificates to trust; default: those of the system.
        cert: file of a certificate to show to the server.
        key: file of its key.

    Raises:
        OSError: a file is missing or has no certificate in it.
    """
    context = ssl.create_default_context(cafile=ca)
    if cert is not None:
        context.load_cert_chain(cert, key)
    return context


class AsyncLink(Protocol):
    """One connection, used in one loop: `uwclient.link.Link` for asyncio."""

    def write(self, data: bytes) -> None:
        """Begin to send whole framed requests."""
        ...

    async def drain(self) -> None:
        """Wait while too much is unsent. Raises OSError."""
        ...

    async def read(self) -> bytes:
        """Return the next bytes, or b"" if the server has ended the connection. Raises OSError."""
        ...

    def close(self) -> None:
        """Begin to end the connection."""
        ...

    async def wait_closed(self) -> None:
        """Wait until the connection has ended."""
        ...


AsyncDial = Callable[[float], Awaitable[AsyncLink]]
"""Makes a connection within a wall time in s. Raises OSError or asyncio.TimeoutError if nobody answers."""


class StreamLink:
    """A TCP connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    def write(self, data: bytes) -> None:
        """Begin to send."""
        self._writer.write(data)

    async def drain(self) -> None:
        """Wait while too much is unsent. Raises OSError."""
        await self._writer.drain()

    async def read(self) -> bytes:
        """Return the next chunk; see `AsyncLink.read`."""
        return await self._reader.read(_CHUNK)

    def close(self) -> None:
        """Close the socket once everything is sent."""
        self._writer.close()

    async def wait_closed(self) -> None:
        """Wait until the socket is closed."""
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()


async def dial_stream(host: str, port: int, tls: ssl.SSLContext | None, timeout: float) -> AsyncLink:
    """Connect, with TLS if there is a context. Raises OSError or asyncio.TimeoutError."""
    return StreamLink(*await asyncio.wait_for(asyncio.open_connection(host, port, ssl=tls), timeout))
