"""The link that carries bytes between a `Client` and a server. The bytes are those of docs/reference/protocol.md on every network."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Callable
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
