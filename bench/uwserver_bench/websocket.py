"""A WebSocket for load processes. It has only as much of the protocol as they need, so that it costs little beside what they measure."""

from __future__ import annotations

import base64
import socket
import struct
from collections.abc import Iterator

BINARY = 0x82
"""First byte of a binary message."""
_TEXT, _MASKED = 0x81, 0x80
_MEDIUM, _LONG = 126, 127
"""Lengths that say that the length follows, in 2 and in 8 bytes."""
_KEY = base64.b64encode(bytes(16)).decode()


class WebSocket:
    """The client's end of a WebSocket.

    Args:
        stream: connected.
        host: host of the server, with its port.
        path: what is asked for.

    Attributes:
        received: number of bytes that were read.

    Raises:
        ValueError: the server refused the handshake.
    """

    def __init__(self, stream: socket.socket, host: str, path: str = "/") -> None:
        self._stream, self._rest, self.received = stream, b"", 0
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.sendall(
            f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {_KEY}\r\n\r\n".encode()
        )
        head = b""
        while b"\r\n\r\n" not in head:
            head += stream.recv(1)
        if b" 101 " not in head:
            raise ValueError(f"the server refused a client: {head.decode(errors='replace')}")

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._stream.fileno()

    def send(self, text: str) -> None:
        """Send a short text, masked with zeros."""
        body = text.encode()
        self._stream.sendall(struct.pack("BB", _TEXT, _MASKED | len(body)) + bytes(4) + body)

    def read(self) -> Iterator[tuple[int, bytes]]:
        """Receive once, and yield the first byte and the content of each complete message.

        Raises:
            ConnectionError: the server closed the connection.
        """
        found = self._stream.recv(1 << 18)
        if not found:
            raise ConnectionError("the server closed a connection")
        self.received += len(found)
        data, at = self._rest + found, 0
        while len(data) - at >= 2:
            size, head = data[at + 1], 2
            if size == _MEDIUM:
                size, head = int.from_bytes(data[at + 2 : at + 4], "big"), 4
            elif size == _LONG:
                size, head = int.from_bytes(data[at + 2 : at + 10], "big"), 10
            if len(data) - at < head + size:
                break
            yield data[at], data[at + head : at + head + size]
            at += head + size
        self._rest = data[at:]
