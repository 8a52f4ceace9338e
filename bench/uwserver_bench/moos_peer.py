"""A MOOS client for measurements. It has only as much of the protocol as it needs, and shares no code with the adapters."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable, Iterator

from uwserver.simulation.clock import SystemTime

CONNECT_S = 10.0
_HELLO = b"ELKS CAN'T DANCE 2/8/10".ljust(32, b"\0")
_PACKET, _LENGTH, _NUMBERS = struct.Struct("<iiB"), struct.Struct("<i"), struct.Struct("<ddd")
_HEAD = 10
_CHUNK = 1 << 18
_clock = SystemTime()


class MoosPeer:
    """One client.

    Args:
        address: ``host:port`` of a MOOSDB.
        name: its name there.

    Raises:
        ConnectionError: the database refused the connection.
    """

    def __init__(self, address: str, name: str) -> None:
        host, _, port = address.rpartition(":")
        self._name = name.encode()
        self._socket = socket.create_connection((host, int(port)), CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = bytearray()
        self._socket.sendall(_HELLO + _packet([_message(b"iS", b"asynchronous", 0.0, self._name)]))
        answer = self._socket.recv(_CHUNK)
        if answer[_PACKET.size + 8 : _PACKET.size + 9] != b"W":
            raise ConnectionError(f"{name} was not welcomed: {answer!r}")

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._socket.fileno()

    def hear(self, pattern: str) -> None:
        """Register for all variables that match a pattern."""
        text = f"AppPattern=*,VarPattern={pattern},Interval=0".encode()
        self._socket.sendall(_packet([_message(b"*S", self._name, -1.0, text, self._name)]))

    def write(self, pairs: Iterable[tuple[str, float]]) -> None:
        """Write doubles in one packet."""
        self._socket.sendall(_packet([_message(b"ND", key.encode(), value, b"", self._name) for key, value in pairs]))

    def receive(self, timeout_s: float) -> list[tuple[int, bytes, float]]:
        """Return the notifications that have arrived: monotonic time of the arrival (ns), variable, number.

        Raises:
            ConnectionError: the database closed the connection.
        """
        self._socket.settimeout(max(timeout_s, 1e-4))
        try:
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            return []
        at_ns = _clock.now_ns()
        if not data:
            raise ConnectionError("the database ended the connection")
        self._buffer += data
        found: list[tuple[int, bytes, float]] = []
        while len(self._buffer) >= 4 and len(self._buffer) >= (size := _LENGTH.unpack_from(self._buffer)[0]):
            found += ((at_ns, key, number) for key, number in _mail(bytes(self._buffer[:size])))
            del self._buffer[:size]
        return found

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _message(types: bytes, key: bytes, number: float, data: bytes, src: bytes = b"") -> bytes:
    texts = b"".join(_LENGTH.pack(len(text)) + text for text in (src, b"", b"", key))
    body = types + texts + _NUMBERS.pack(0.0, number, -1.0) + _LENGTH.pack(len(data)) + data
    return _LENGTH.pack(8 + len(body)) + _LENGTH.pack(0) + body


def _packet(messages: list[bytes]) -> bytes:
    body = b"".join(messages)
    return _PACKET.pack(_PACKET.size + len(body), len(messages), 0) + body


def _mail(data: bytes) -> Iterator[tuple[bytes, float]]:
    """Return variable and number of each notification in a packet."""
    at = _PACKET.size
    while at < len(data):
        (size,) = _LENGTH.unpack_from(data, at)
        if data[at + 8 : at + 9] == b"N":
            end, key = at + _HEAD, b""
            for _ in range(4):
                (length,) = _LENGTH.unpack_from(data, end)
                key, end = data[end + 4 : end + 4 + length], end + 4 + length
            yield key, _NUMBERS.unpack_from(data, end)[1]
        at += size
