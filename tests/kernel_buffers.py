"""Sockets that hold little, so that a peer who does not read is noticed after kilobytes; the kernel would take megabytes for it first."""

from __future__ import annotations

import socket
from collections.abc import Callable

import pytest

SMALL = 8192
"""Bytes that are asked for; Linux takes twice as many, with what it keeps beside them."""


def keep_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on whoever is accepted on TCP has a small buffer of what waits to be sent: it is that of the socket that listens."""
    listen: Callable[..., None] = socket.socket.listen

    def listen_small(stream: socket.socket, *backlog: int) -> None:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SMALL)
        listen(stream, *backlog)

    monkeypatch.setattr(socket.socket, "listen", listen_small)


def shorten_suite(monkeypatch: pytest.MonkeyPatch) -> None:
    """The conformance suite finds the same with fewer samples for who does not read, as buffers are small, and with a flood of few more requests
    than the 1024 that any adapter of ours keeps of one peer."""
    keep_small(monkeypatch)
    monkeypatch.setattr("uwserver.testing.adapters._TICKS_TO_SLOW_PEER", 12_000)
    monkeypatch.setattr("uwserver.testing.adapters._TICKS_ONCE_SLOW", 100)
    monkeypatch.setattr("uwserver.testing.call_checks.FLOOD", 1200)
    monkeypatch.setattr("uwserver.testing.call_checks._QUIET_S", 0.2)
    for limit in ("START_S", "CANCEL_S", "SETTLE_S"):
        monkeypatch.setattr(f"uwserver.testing.adapter_kit.{limit}", 30.0)  # a busy machine may take its time


def slow_reader(host: str, port: int) -> socket.socket:
    """A connection whose own side takes little, too."""
    stream = socket.socket()
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
    stream.connect((host, port))
    return stream
