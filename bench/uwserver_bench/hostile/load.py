"""The attackers, in a process of their own: ``python -m uwserver_bench.hostile.load``. Its tasks are as of `uwserver_bench.load`."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
from collections.abc import Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.hostile.floods import FLOODS, HELLO, Flood
from uwserver_bench.processes import carry_out

_CHUNK = 1 << 18
_GREETINGS = 5
"""Number of tries: datagrams may be lost on a busy machine."""
_NICENESS = 10
"""The attackers have less priority than the server, because their own use of the processors is not what is measured."""
_clock = SystemTime()


class Attacker:
    """A connection that sends the same bytes repeatedly, and drops what it receives. If it is closed, it is opened again.

    Attributes:
        sent: number of bytes that the server has taken.
        opened: number of connections that were made.
        reason: why the last failed connection failed; "" if none did.
        socket: None until the next attempt.
    """

    def __init__(self, flood: Flood, address: tuple[str, int], number: int) -> None:
        self._flood = flood
        self._address = address
        self._number = number
        self.sent = 0
        self.opened = 0
        self.reason = ""
        self._next_ns = 0
        self._rest = b""
        self.socket: socket.socket | None = None

    def open(self) -> None:
        """Begin to connect, unless it is connected. A stream may still be connecting when this returns."""
        if self.socket is not None:
            return
        flood = self._flood
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if flood.is_udp else socket.SOCK_STREAM)
        try:
            if flood.is_udp:
                made.connect(self._address)
                if flood.first == HELLO:
                    _greet(made)
                made.setblocking(False)
            else:
                made.setblocking(False)
                made.connect_ex(self._address)
                self._rest = flood.first.replace(b"%d", b"%d" % self._number)
        except OSError as error:
            self.reason = str(error)
            made.close()
            return
        self.opened += 1
        self.socket = made

    def work(self) -> None:
        """Send as much as the server takes, and receive what is there."""
        if self.socket is None:
            return
        try:
            self._work(self.socket)
        except OSError as error:  # the server closed it
            self.reason = str(error)
            self.close()

    def _work(self, opened: socket.socket) -> None:
        with contextlib.suppress(BlockingIOError):
            while opened.recv(_CHUNK):
                pass
        if not self._rest:
            now = _clock.now_ns()
            if now < self._next_ns:
                return
            self._next_ns = now + int(self._flood.pause_s * 1e9)
            self._rest = self._flood.data
        with contextlib.suppress(BlockingIOError):
            for _ in range(self._flood.burst - 1):
                self.sent += opened.send(self._flood.data)
            sent = opened.send(self._rest)
            self.sent += sent
            self._rest = self._rest[sent:]

    def close(self) -> None:
        """Close the connection."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None


def _greet(opened: socket.socket) -> None:
    """Begin a session by UDP. Raises OSError if the server does not answer."""
    opened.settimeout(1.0)
    hello: dict[str, Any] = {"id": 1, "method": "hello", "params": {"version": 1}}
    for _ in range(_GREETINGS):
        opened.send(json.dumps(hello).encode())
        with contextlib.suppress(TimeoutError):
            answer = json.loads(opened.recv(_CHUNK))
            if "result" in answer:
                return
            if "cookie" in answer:
                hello["params"]["cookie"] = answer["cookie"]
    raise TimeoutError("nobody answered a hello by UDP")


def attack(task: Mapping[str, Any]) -> dict[str, object]:
    """Flood `address` for `seconds` with the row `flood`. Returns the sent bytes, the opened connections, and why one failed."""
    flood = FLOODS[task["flood"]]
    host, _, port = str(task["address"]).removeprefix("udpin:").rpartition(":")
    attackers = [Attacker(flood, (host, int(port)), number) for number in range(flood.connections)]
    for each in attackers:
        each.open()
    end = _clock.now_ns() + int(task["seconds"] * 1e9)
    try:
        while _clock.now_ns() < end:
            _round(attackers)
    finally:
        for each in attackers:
            each.close()
    return {
        "bytes": sum(each.sent for each in attackers),
        "opened": sum(each.opened for each in attackers),
        "reason": next((each.reason for each in attackers if each.reason), ""),
    }


def _round(attackers: list[Attacker]) -> None:
    with selectors.DefaultSelector() as selector:
        for each in attackers:
            each.open()
            if each.socket is not None:
                selector.register(each.socket, selectors.EVENT_READ | selectors.EVENT_WRITE, each)
        for key, _ in selector.select(0.05):
            key.data.work()


if __name__ == "__main__":
    os.nice(_NICENESS)
    carry_out({"attack": attack}, "attacker")
