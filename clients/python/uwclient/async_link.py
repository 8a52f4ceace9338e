"""The link that carries bytes between an `AsyncClient` and a server, and its implementation over TCP."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import Awaitable, Callable
from typing import Protocol

_CHUNK = 1 << 16


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
