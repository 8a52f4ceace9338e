"""A ground station for measurements. It has only as much of MAVLink as it needs, and shares no code with the adapter."""

from __future__ import annotations

import contextlib
import socket
import struct

_EXTRA = {0: 50, 21: 159, 66: 148}
"""CRC_EXTRA of each message that is sent: HEARTBEAT, PARAM_REQUEST_LIST, REQUEST_DATA_STREAM."""
_STREAMS = ((1, 2), (2, 2), (3, 2), (6, 3), (10, 20), (11, 10), (12, 3))
"""Group and rate (Hz) of the streams that QGroundControl requests from a submarine."""
_HEAD, _CHUNK = 10, 4096


class MavlinkPeer:
    """One ground station on UDP.

    Args:
        port: of the server, on loopback.
        system: its system number.
    """

    PARAM_VALUE = 22

    def __init__(self, port: int, system: int) -> None:
        self._system = system
        self._seq = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._socket.fileno()

    def beat(self) -> None:
        """Send a heartbeat."""
        self._send(0, struct.pack("<IBBBBB", 0, 6, 8, 0, 4, 3))

    def ask_for_streams(self) -> None:
        """Request telemetry."""
        for group, rate in _STREAMS:
            self._send(66, struct.pack("<HBBBB", rate, 1, 1, group, 1))

    def ask_for_parameters(self) -> None:
        """Request all parameters."""
        self._send(21, bytes((1, 1)))

    def read(self, timeout_s: float = 0.0) -> list[tuple[int, bytes]]:
        """Return numbers and payloads of the messages that have arrived. Waits at most `timeout_s` for the first one."""
        found: list[tuple[int, bytes]] = []
        if timeout_s:
            self._socket.settimeout(timeout_s)
            with contextlib.suppress(OSError):
                found += _messages(self._socket.recv(_CHUNK))
            self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            while True:
                found += _messages(self._socket.recv(_CHUNK))
        return found

    @staticmethod
    def count_and_index(payload: bytes) -> tuple[int, int]:
        """Return the count and the index in a PARAM_VALUE."""
        count, index = struct.unpack_from("<HH", payload.ljust(25, b"\0"), 4)
        return int(count), int(index)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, id: int, payload: bytes) -> None:
        body = bytes((len(payload), 0, 0, self._seq, self._system, 190)) + id.to_bytes(3, "little") + payload
        self._seq = (self._seq + 1) & 0xFF
        with contextlib.suppress(OSError):
            self._socket.send(b"\xfd" + body + _crc(body + bytes((_EXTRA[id],))).to_bytes(2, "little"))


def _messages(data: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while len(data) >= at + _HEAD and data[at] == 0xFD:
        size = data[at + 1]
        found.append((int.from_bytes(data[at + 7 : at + _HEAD], "little"), data[at + _HEAD : at + _HEAD + size]))
        at += _HEAD + size + 2
    return found


def _crc(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        low = (byte ^ crc) & 0xFF
        low = (low ^ low << 4) & 0xFF
        crc = crc >> 8 ^ low << 8 ^ low << 3 ^ low >> 4
    return crc
