"""A server in a process of its own, and peers on plain sockets: no client library stands between a test and the wire."""

from __future__ import annotations

import contextlib
import json
import re
import selectors
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nursery import python

PATIENCE_S = 120.0


@contextlib.contextmanager
def serving(scenario: str | Path, *options: str, program: str = "") -> Iterator[tuple[tuple[str, int], int]]:
    """A server; gives its address and the number of its process, which is that of the server itself where `program` is `sys.executable`, and no
    fork."""
    command = [program or python(), "-m", "uwserver", "run", str(scenario), "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            found = next((f for line in process.stdout if (f := re.search(r"tcp: ([\d.]+):(\d+)", line))), None)
            assert found is not None, "the server ended"
            yield (found[1], int(found[2])), process.pid
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


class Peer:
    """Sends a request and waits for its reply."""

    def __init__(self, address: tuple[str, int], receive_buffer: int = 0) -> None:
        self.socket = socket.socket()
        self.socket.settimeout(PATIENCE_S)
        if receive_buffer:  # else the system's own buffers hold what a slow peer leaves for half a minute
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.connect(address)
        self._lines = self.socket.makefile("rb")
        self._id = 0

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """The whole reply; what comes meanwhile is passed over."""
        self._id += 1
        self.socket.sendall(json.dumps({"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}).encode() + b"\n")  # fmt: skip
        for line in self._lines:
            message: dict[str, Any] = json.loads(line)
            if message.get("id") == self._id:
                return message
        raise AssertionError(f"the server left after {method}")

    def call(self, service: str, **args: Any) -> dict[str, Any]:
        """The same for a service."""
        return self.ask("call", service=service, args=args)

    def begin(self, service: str, **args: Any) -> None:
        """Of one that takes long nobody waits for the reply."""
        message = {"jsonrpc": "2.0", "id": f"begun {service}", "method": "call", "params": {"service": service, "args": args}}  # fmt: skip
        self.socket.sendall(json.dumps(message).encode() + b"\n")

    def close(self) -> None:
        """Leave."""
        self._lines.close()
        self.socket.close()


class Audience:
    """Subscribers to everything, of which every second one never reads; a thread reads for the others.

    Attributes:
        heard: bytes that they have read.

    Args:
        address: of the server.
        count: how many.
        pause_s: after each of their small reads, for slow ones.
    """

    def __init__(self, address: tuple[str, int], count: int, pause_s: float = 0.0) -> None:
        self.heard = 0
        self._peers: list[Peer] = []
        self._selector = selectors.DefaultSelector()
        for n in range(count):
            # One after the other: who is connected and has said nothing is a stranger, of whom there may be few.
            peer = Peer(address, receive_buffer=4096)
            self._peers.append(peer)
            reply = peer.ask("subscribe", pattern="**")
            assert "result" in reply, reply
            if n % 2 == 0:
                self._selector.register(peer.socket, selectors.EVENT_READ)
        self._is_over, self._pause_s = False, pause_s
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        while not self._is_over:
            for key, _ in self._selector.select(0.1):
                data = key.fileobj.recv(1 << 12 if self._pause_s else 1 << 16)  # type: ignore[union-attr]  # a socket
                self.heard += len(data)
                if not data:
                    self._selector.unregister(key.fileobj)
            if self._pause_s:
                time.sleep(self._pause_s)

    def leave(self) -> None:
        """All of them."""
        self._is_over = True
        self._thread.join()
        self._selector.close()
        for peer in self._peers:
            peer.close()
