"""The pages of `uwserver bench web`, in a process of their own: ``python -m uwserver_bench.web.web_load``. Its tasks are as of `load`."""

from __future__ import annotations

import base64
import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS
from uwserver_bench.processes import carry_out

_PATIENCE_S = 60.0
_KEY = base64.b64encode(bytes(16)).decode()
_SMALL = 4096
"""Size of the receive buffer of a page that does not read, bytes."""
_BINARY = 0x82
_LONG = 126
_clock = SystemTime()


def watch(task: Mapping[str, Any]) -> dict[str, object]:
    """Open `pages` pages, of which `deaf` do not read, and read the others for `seconds` of wall time.

    Returns:
        Bytes and states per second of a page that reads.

    Raises:
        ValueError: a page was refused.
    """
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        streams: dict[socket.socket, bytes] = {}
        for n in range(task["pages"]):
            stream = stack.enter_context(_page(task, n < task["deaf"]))
            if n >= task["deaf"]:
                streams[stream] = b""
                selector.register(stream, selectors.EVENT_READ)
        begin, received, frames = _clock.now_ns(), 0, 0
        end = begin + int(task["seconds"] * NANOSECONDS)
        while _clock.now_ns() < end:
            for key, _ in selector.select(0.1):
                found: Any = key.fileobj
                data = found.recv(1 << 16)
                if not data:
                    raise ConnectionError("the server closed a page")
                received += len(data)
                streams[found], more = _rest(streams[found] + data)
                frames += more
        seconds = (_clock.now_ns() - begin) / NANOSECONDS
    count = max(1, len(streams))
    return {"bytes_per_s": received / seconds / count, "frames_per_s": frames / seconds / count}


def _rest(data: bytes) -> tuple[bytes, int]:
    """Return the rest behind complete messages, and how many of them were binary."""
    binary = at = 0
    while len(data) - at >= 2:
        size, head = data[at + 1], 2
        if size == _LONG:
            if len(data) - at < 4:
                break
            (size,), head = struct.unpack_from(">H", data, at + 2), 4
        elif size > _LONG:
            if len(data) - at < 10:
                break
            (size,), head = struct.unpack_from(">Q", data, at + 2), 10
        if len(data) - at < head + size:
            break
        binary += data[at] == _BINARY
        at += head + size
    return data[at:], binary


@contextlib.contextmanager
def _page(task: Mapping[str, Any], deaf: bool) -> Iterator[socket.socket]:
    stream = socket.socket()
    with stream:
        if deaf:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SMALL)
        stream.settimeout(_PATIENCE_S)
        stream.connect((task["host"], task["port"]))
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.sendall(
            f"GET /live HTTP/1.1\r\nHost: {task['host']}:{task['port']}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {_KEY}\r\n\r\n".encode()
        )
        head = b""
        while b"\r\n\r\n" not in head:
            head += stream.recv(1)
        if b" 101 " not in head:
            raise ValueError(f"a page was refused: {head.decode(errors='replace')}")
        stream.sendall(_text('{"jsonrpc":"2.0","method":"view","params":{"frames":true}}'))
        yield stream


def _text(message: str) -> bytes:
    """Return a short text message of a client, masked with zeros."""
    body = message.encode()
    return struct.pack("BB", 0x81, 0x80 | len(body)) + bytes(4) + body


_TASKS: Mapping[str, Callable[[Mapping[str, Any]], dict[str, object]]] = {"watch": watch}


if __name__ == "__main__":
    carry_out(_TASKS, "web")
