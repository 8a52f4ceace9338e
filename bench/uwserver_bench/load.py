"""The clients of a benchmark, in a process of their own: ``python -m uwserver_bench.load``.

Each line on stdin is a task (JSON), and each line on stdout a result. The clients use plain sockets and one selector,
because all of them together must cost little compared with the server that they measure.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import carry_out
from uwserver_bench.report import quantile

SUBSCRIBE = b'{"jsonrpc":"2.0","id":0,"method":"subscribe","params":{"pattern":"**"}}\n'
COMMAND_RATE_HZ = 50.0
SILENT_BUFFER_BYTES = 4096
"""A small buffer, so that a client that never reads is full soon."""

_CONNECT_S = 10.0
_clock = SystemTime()


@dataclass
class Client:
    """One connection, with the bytes of an unfinished line, and the time (ns) at which its open request was sent."""

    connection: socket.socket
    rest: bytes = b""
    sent_ns: int = 0
    latencies_s: list[float] = field(default_factory=list)
    samples: int = 0

    def lines(self) -> list[bytes]:
        """Return the complete lines that have arrived.

        Raises:
            ConnectionError: the server closed the connection.
        """
        received = self.connection.recv(1 << 18)
        if not received:
            raise ConnectionError("the server closed a connection")
        *lines, self.rest = (self.rest + received).split(b"\n")
        return lines

    def send(self, request: bytes) -> None:
        """Send a request, and note the time."""
        self.sent_ns = _clock.now_ns()
        self.connection.sendall(request)

    def answered(self, line: bytes) -> None:
        """Count the reply to the open request.

        Raises:
            ValueError: it was refused.
        """
        if b'"error"' in line:
            raise ValueError(f"the server refused a request: {line.decode(errors='replace')}")
        self.latencies_s.append((_clock.now_ns() - self.sent_ns) * 1e-9)


_PATIENCE_S = 20.0


def clients(task: Mapping[str, Any]) -> dict[str, object]:
    """Run clients for `seconds`: `active` ones receive all samples and send `request` at 50 Hz; `silent` ones subscribe and never read.

    The silent clients stay connected to the end. Returns samples per second of all active clients together, and the latencies of the commands.
    """
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        for _ in range(task["silent"]):
            stack.enter_context(_connect(task, SILENT_BUFFER_BYTES)).sendall(SUBSCRIBE)
        active = [Client(stack.enter_context(_connect(task))) for _ in range(task["active"])]
        for client in active:
            selector.register(client.connection, selectors.EVENT_READ, client)
            client.connection.sendall(SUBSCRIBE)
        request = task["request"].encode() + b"\n"
        start = _clock.now_ns()
        end, turn = start + int(task["seconds"] * 1e9), 0
        gap = int(1e9 / (COMMAND_RATE_HZ * len(active)))  # clients take turns, so that commands are evenly spaced
        while (now := _clock.now_ns()) < end:
            if now >= start + turn * gap:
                active[turn % len(active)].send(request)
                turn += 1
            wait = max(0.0, (start + turn * gap - now) * 1e-9)
            for key, _ in selector.select(wait):
                _take(key.data)
        elapsed = (_clock.now_ns() - start) * 1e-9
    latencies = [late for client in active for late in client.latencies_s]
    return {
        "samples_per_s": sum(client.samples for client in active) / elapsed,
        "commands_per_s": len(latencies) / elapsed,
        "command_p99_s": quantile(latencies, 0.99) if latencies else None,
    }


def _take(client: Client) -> None:
    for line in client.lines():
        if b'"method":"sample"' in line:
            client.samples += 1
        elif b'"id":1' in line:
            client.answered(line)


def calls(task: Mapping[str, Any]) -> dict[str, object]:
    """Run `connections` for `seconds`. Each sends `request`, waits for the reply and sends it again. Returns rate and latency of the replies."""
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        everyone = [Client(stack.enter_context(_connect(task))) for _ in range(task["connections"])]
        request = task["request"].encode() + b"\n"
        for client in everyone:
            selector.register(client.connection, selectors.EVENT_READ, client)
            client.send(request)
        start = now = _clock.now_ns()
        end, patience = start + int(task["seconds"] * 1e9), start + int(_PATIENCE_S * 1e9)
        answered = False
        while now < end or (not answered and now < patience):  # on a busy machine the first reply may take longer
            for key, _ in selector.select(0.5):
                client = key.data
                for line in client.lines():
                    if b'"id":1' in line:
                        client.answered(line)
                        client.send(request)
                        answered = True
            now = _clock.now_ns()
    latencies = [late for client in everyone for late in client.latencies_s]
    if not latencies:
        raise ValueError(f"no reply within {max(task['seconds'], _PATIENCE_S):g} s to {task['request']}")
    return {
        "per_s": len(latencies) / ((now - start) * 1e-9),
        "p50_s": quantile(latencies, 0.5),
        "p99_s": quantile(latencies, 0.99),
    }


def _connect(task: Mapping[str, Any], receive_buffer: int = 0) -> socket.socket:
    connection = socket.socket()
    try:
        if receive_buffer:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(_CONNECT_S)
        connection.connect((task["host"], task["port"]))
    except OSError:
        connection.close()
        raise
    return connection


_TASKS: Mapping[str, Callable[[Mapping[str, Any]], dict[str, object]]] = {"clients": clients, "calls": calls}


if __name__ == "__main__":
    carry_out(_TASKS, "load")
