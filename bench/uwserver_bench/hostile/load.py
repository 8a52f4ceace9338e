"""Plays the attackers, in a process of its own: ``python -m uwserver_bench.hostile.load``, told as `uwserver_bench.load`."""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import sys
from collections.abc import Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.hostile.floods import FLOODS, HELLO, Flood

_CHUNK = 1 << 18
_CONNECT_S = 5.0
_clock = SystemTime()


class Attacker:
    """One connection that sends the same again and again, and throws away what it hears."""

    def __init__(self, flood: Flood, address: tuple[str, int], number: int) -> None:
        self._flood = flood
        self._address = address
        self._number = number
        self.sent = 0
        self.opened = 0
        self._next_ns = 0
        self._rest = b""
        self.socket = self._open()

    def _open(self) -> socket.socket:
        flood = self._flood
        self.opened += 1
        if flood.is_udp:
            opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            opened.connect(self._address)
            if flood.first == HELLO:
                _greet(opened)
        else:
            opened = socket.create_connection(self._address, _CONNECT_S)
            self._rest = flood.first.replace(b"%d", b"%d" % self._number)
        opened.setblocking(False)
        return opened

    def work(self) -> None:
        """Send what is taken, and hear what is there."""
        with contextlib.suppress(BlockingIOError):
            while self.socket.recv(_CHUNK):
                pass
        if not self._rest:
            now = _clock.now_ns()
            if now < self._next_ns:
                return
            self._next_ns = now + int(self._flood.pause_s * 1e9)
            self._rest = self._flood.data
        with contextlib.suppress(BlockingIOError):
            sent = self.socket.send(self._rest)
            self.sent += sent
            self._rest = self._rest[sent:]

    def again(self) -> None:
        """The server ended it: come again."""
        self.socket.close()
        self.socket = self._open()


def _greet(opened: socket.socket) -> None:
    opened.settimeout(1.0)
    hello = {"id": 1, "method": "hello", "params": {"version": 1}}
    opened.send(json.dumps(hello).encode())
    cookie = json.loads(opened.recv(_CHUNK))["cookie"]
    opened.send(json.dumps({**hello, "params": {"version": 1, "cookie": cookie}}).encode())
    opened.recv(_CHUNK)


def attack(task: Mapping[str, Any]) -> dict[str, object]:
    """Flood `address` for `seconds` with the row `flood`; returns bytes that were sent, and connections that were opened."""
    flood = FLOODS[task["flood"]]
    host, _, port = str(task["address"]).removeprefix("udpin:").rpartition(":")
    address = (host, int(port))
    attackers = [Attacker(flood, address, number) for number in range(flood.connections)]
    end = _clock.now_ns() + int(task["seconds"] * 1e9)
    try:
        while _clock.now_ns() < end:
            with selectors.DefaultSelector() as selector:
                for each in attackers:
                    selector.register(each.socket, selectors.EVENT_READ | selectors.EVENT_WRITE, each)
                for key, _ in selector.select(0.05):
                    try:
                        key.data.work()
                    except OSError:
                        with contextlib.suppress(OSError):
                            key.data.again()
    finally:
        for each in attackers:
            each.socket.close()
    return {"bytes": sum(each.sent for each in attackers), "opened": sum(each.opened for each in attackers)}


def main() -> None:
    """Carry out tasks until stdin ends."""
    for task in sys.stdin:
        try:
            result = attack(json.loads(task))
        except (OSError, ValueError) as error:
            result = {"failed": f"attacker: {error}"}
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
