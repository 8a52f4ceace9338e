"""Servers and plain sessions on a zenoh network of the test's own. Loopback and explicit endpoints only."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import uwclient
from nursery import python

zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")

PATIENCE_S = 120.0
ROV = 'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n[server]\nmetrics = false\n'
TCP = '[adapters.tcp]\nkind = "sockets"\nport = 0\n'
BUS = '[adapters.bus]\nkind = "zenoh"\nscouting = false\n'
LISTEN = 'listen = ["tcp/127.0.0.1:0"]\n'
STILL = "[world.clock]\npaused = true\n"


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Server:
    """`uwserver run` in a process of its own."""

    def __init__(self, scenario: Path) -> None:
        command = [python(), "-m", "uwserver", "run", str(scenario)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addresses: dict[str, str] = {}
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.match(r"  (\w+): (\S+)$", line):
                self.addresses[found[1]] = found[2]
            if line.startswith("Ctrl-C"):
                return
        raise AssertionError(f"the server ended: {self.process.communicate(timeout=PATIENCE_S)}")

    @property
    def endpoint(self) -> str:
        return self.addresses["bus"]

    def client(self, server: str = "uwserver", **options: Any) -> uwclient.Client:
        return uwclient.connect_zenoh(server, [self.endpoint], timeout=PATIENCE_S, **options)

    def tcp_client(self, **options: Any) -> uwclient.Client:
        host, port = self.addresses["tcp"].split(":")
        return uwclient.connect(host, int(port), timeout=PATIENCE_S, **options)

    def end(self) -> str:
        """What it said since it began to serve."""
        self.process.terminate()
        output, errors = self.process.communicate(timeout=PATIENCE_S)
        assert self.process.returncode == 0, errors
        assert "Traceback" not in errors
        return str(output + errors)


@contextlib.contextmanager
def serving(folder: Path, text: str) -> Iterator[Server]:
    scenario = folder / f"{len(list(folder.iterdir()))}.toml"
    scenario.write_text(text)
    server = Server(scenario)
    try:
        yield server
    finally:
        if server.process.poll() is None:
            server.process.kill()
        server.process.communicate(timeout=PATIENCE_S)


@contextlib.contextmanager
def session(connect: str | None = None, listen: str | None = None, mode: str = "peer") -> Iterator[Any]:
    config = zenoh.Config()
    for path, value in {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "connect/endpoints": [connect] if connect else [],
        "listen/endpoints": [listen] if listen else [],
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
    }.items():
        config.insert_json5(path, json.dumps(value))
    opened = zenoh.open(config)
    try:
        yield opened
    finally:
        opened.close()


@contextlib.contextmanager
def malformed_key(endpoint: str) -> Iterator[None]:
    """Be a peer that has declared the key ``x\\0**``, which is no key expression. No library sends one, so a byte is changed on the way.

    The text ``/**`` behind the declared prefix ``x`` goes out in a frame of its own.
    """
    host, _, port = endpoint.removeprefix("tcp/").partition(":")
    with socket.socket() as listener, socket.create_connection((host, int(port))) as server:
        listener.bind(("127.0.0.1", 0))
        listener.listen()

        def forward(source: socket.socket, target: socket.socket) -> None:
            with contextlib.suppress(OSError):
                while data := source.recv(1 << 16):
                    target.sendall(data.replace(b"\x03/**", b"\x03\0**"))

        def relay() -> None:
            peer, _ = listener.accept()
            with peer:
                back = threading.Thread(target=forward, args=(server, peer), daemon=True)
                back.start()
                forward(peer, server)
                with contextlib.suppress(OSError):  # its other side may have ended it already
                    server.shutdown(socket.SHUT_RDWR)
                back.join()

        relaying = threading.Thread(target=relay, daemon=True)
        relaying.start()
        own = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        with contextlib.suppress(zenoh.ZError), session(own, mode="client") as peer:  # it cannot close in order
            peer.declare_subscriber("x/**", lambda _: None)
            yield
        relaying.join(PATIENCE_S)


def until(condition: Callable[[], Any], what: str) -> Any:
    end = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < end, f"not within {PATIENCE_S:g} s: {what}"
        time.sleep(0.02)
    return value


def tokens(opened: Any, pattern: str) -> set[str]:
    return {str(reply.ok.key_expr) for reply in opened.liveliness().get(pattern, timeout=5) if reply.ok is not None}


def ask(opened: Any, selector: str, payload: bytes | None = None, **options: Any) -> list[tuple[str, Any]]:
    """("ok" or "err", decoded payload) of each reply."""
    answers = []
    for reply in opened.get(selector, payload=payload, timeout=PATIENCE_S, **options):
        kind, answer = ("ok", reply.ok) if reply.ok is not None else ("err", reply.err)
        answers.append((kind, json.loads(answer.payload.to_bytes())))
    return answers


def ended(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    """A server that cannot start."""
    scenario = folder / "ended.toml"
    scenario.write_text(text)
    command = [python(), "-m", "uwserver", "run", str(scenario)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
