"""One more way: a server in a process of its own, driven over a socket, with a recorder and eight subscribers to everything."""

from __future__ import annotations

import contextlib
import json
import re
import selectors
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

from stories import Story
from traces import STATE_EVERY, Trace
from ways import ODD

PATIENCE_S = 120.0
SUBSCRIBERS = 8
"""Every second one never reads what it asked for."""


@contextlib.contextmanager
def serving(scenario: str, record: Path) -> Iterator[tuple[str, int]]:
    """A paused server; gives its address."""
    options = ["--port", "0", "--paused", "--mode", "freerun", "--record", str(record)]
    command = [sys.executable, "-m", "uwserver", "run", scenario, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            found = next((f for line in process.stdout if (f := re.search(r"tcp: ([\d.]+):(\d+)", line))), None)
            assert found is not None, "the server ended"
            yield found[1], int(found[2])
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


class Peer:
    """Sends a request and waits for its reply."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.socket = socket.create_connection(address, PATIENCE_S)
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
    """Subscribers to everything; a thread reads for those that read.

    Attributes:
        heard: bytes that they have read.
    """

    def __init__(self, address: tuple[str, int], count: int = SUBSCRIBERS) -> None:
        self.heard = 0
        self._peers = [Peer(address) for _ in range(count)]
        self._selector = selectors.DefaultSelector()
        for n, peer in enumerate(self._peers):
            reply = peer.ask("subscribe", pattern="**")
            assert "result" in reply, reply
            if n % 2 == 0:
                self._selector.register(peer.socket, selectors.EVENT_READ)
        self._is_over = False
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        while not self._is_over:
            for key, _ in self._selector.select(0.1):
                data = key.fileobj.recv(1 << 16)  # type: ignore[union-attr]  # a socket
                self.heard += len(data)
                if not data:
                    self._selector.unregister(key.fileobj)

    def leave(self) -> None:
        """All of them."""
        self._is_over = True
        self._thread.join()
        self._selector.close()
        for peer in self._peers:
            peer.close()


def served(story: Story, path: Path) -> Trace:
    """Its states; its samples are in its recording."""
    trace = Trace()
    with serving(story.scenario, path) as address:
        audience, peer = Audience(address), Peer(address)
        try:
            _drive(story, peer, trace)
            assert audience.heard > 100 * story.steps
        finally:
            audience.leave()
            peer.close()
    return trace


def _drive(story: Story, peer: Peer, trace: Trace) -> None:
    step, sizes = 0, cycle(ODD)
    while step < story.steps:
        for _, act in story.numbered(step):
            if act.is_command:
                peer.ask("command", port=act.path, value=act.given)
            elif act.path.endswith("/goto"):
                peer.begin(act.path, **act.given)
                peer.call("world/faults")  # so that it was carried out before the next step
            else:
                peer.call(act.path, **act.given)
        end = min(story.next_after(step), (step // STATE_EVERY + 1) * STATE_EVERY)
        while step < end:
            n = min(next(sizes), end - step)
            reply = peer.ask("step", n=n)
            assert "result" in reply, reply
            step += n
        if step % STATE_EVERY == 0 or step == story.steps:
            state = peer.call("world/state_hash")["result"]["value"]
            trace.states[str(step)] = (state["tick"], state["hash"])
