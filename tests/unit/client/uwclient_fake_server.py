"""A scripted uwserver for the client's tests: speaks docs/reference/protocol.md over loopback, simulates nothing."""

from __future__ import annotations

import contextlib
import fnmatch
import json
import socket
import struct
import threading
from collections.abc import Iterator

import msgpack

TICK_NS = 4_000_000

IMU = {
    "path": "rov/imu",
    "direction": "sensor",
    "kind": "imu",
    "rate_hz": 125.0,
    "doc": "inertial unit",
    "fields": [
        {"name": "f_S", "type": "float", "shape": [3], "unit": "m/s^2", "frame": "S", "doc": "specific force"},
        {"name": "temperature", "type": "float", "shape": [], "unit": "degC", "frame": "", "doc": "of the chip"},
    ],
}
DEPTH = {
    "path": "rov/depth",
    "direction": "sensor",
    "kind": "pressure",
    "rate_hz": 25.0,
    "doc": "",
    "fields": [{"name": "depth", "type": "float", "shape": [], "unit": "m", "frame": "", "doc": ""}],
}
THRUSTERS = {
    "path": "rov/thrusters",
    "direction": "actuator",
    "kind": "thrusters",
    "rate_hz": None,
    "timeout_s": 1.0,
    "doc": "",
    "fields": [
        {
            "name": "u",
            "type": "float",
            "shape": [8],
            "unit": "1",
            "frame": "",
            "doc": "",
            "minimum": -1.0,
            "maximum": 1.0,
        }
    ],
}
SERVICES = [
    {"path": "world/status", "doc": "", "reads_only": True, "long_running": False, "arguments": []},
    {"path": "world/pause", "doc": "", "reads_only": False, "long_running": False, "arguments": []},
    {
        "path": "world/run_until",
        "doc": "",
        "reads_only": False,
        "long_running": True,
        "arguments": [{"name": "t", "type": "float", "unit": "s", "doc": "", "required": True}],
    },
    {"path": "rov/goto", "doc": "", "reads_only": False, "long_running": True, "arguments": []},
]


class Peer:
    """One connection: what the fake knows of it."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.binary = False
        self.greeted = False
        self.patterns: list[str] = []
        self.unfinished: dict[object, dict] = {}
        self._writing = threading.Lock()

    def write(self, message: dict, piece: int = 0) -> None:
        if self.binary:
            body = msgpack.packb(message)
            data = struct.pack(">I", len(body)) + body
        else:
            data = json.dumps(message, ensure_ascii=False).encode() + b"\r\n"
        self.write_raw(data, piece)

    def write_raw(self, data: bytes, piece: int = 0) -> None:
        with self._writing, contextlib.suppress(OSError):
            step = piece or len(data)
            for start in range(0, len(data), step):
                self.connection.sendall(data[start : start + step])

    def messages(self) -> Iterator[dict]:
        stream = self.connection.makefile("rb")
        with stream:
            first = stream.read(1)
            self.binary = first == b"\0"
            while first:
                if self.binary:
                    (length,) = struct.unpack(">I", first + stream.read(3))
                    yield msgpack.unpackb(stream.read(length))
                else:
                    yield json.loads(first + stream.readline())
                first = stream.read(1)


class FakeServer:
    """Answers as scripted by its attributes, from one thread a connection.

    Attributes:
        requests: every request and notification received, in order.
        samples: how many samples a port sends right after its subscription.
        piece: bytes a write; 0 writes whole messages.
        silent: methods that get no answer.
        vanish_on: methods on which the connection is closed unanswered.
        refuse_patterns: subscriptions to refuse.
    """

    def __init__(self, port: int = 0, token: str | None = None) -> None:
        self.requests: list[dict] = []
        self.token = token
        self.samples = 5
        self.piece = 0
        self.silent: set[str] = set()
        self.vanish_on: set[str] = set()
        self.refuse_patterns: set[str] = set()
        self.ports = [IMU, DEPTH, THRUSTERS]
        self.paused = False
        self.tick = 100
        self.peers: list[Peer] = []
        self._threads: list[threading.Thread] = []
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self._spawn(self._accept)

    def __enter__(self) -> FakeServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in self._threads:
            thread.join(60.0)
            assert not thread.is_alive()

    def drop(self) -> None:
        """Close every connection, as a dying server does."""
        for peer in list(self.peers):
            with contextlib.suppress(OSError):
                peer.connection.shutdown(socket.SHUT_RDWR)

    def methods(self) -> list[str]:
        return [request["method"] for request in self.requests]

    def told(self, method: str) -> list[dict]:
        return [request.get("params", {}) for request in self.requests if request["method"] == method]

    def notify(self, method: str, params: dict) -> None:
        for peer in list(self.peers):
            peer.write({"jsonrpc": "2.0", "method": method, "params": params}, self.piece)

    def sample(self, path: str, seq: int, **changes: object) -> None:
        self.notify("sample", {**sample(path, seq), **changes})

    def _spawn(self, target: object, *args: object) -> None:
        thread = threading.Thread(target=target, args=args, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            peer = Peer(connection)
            self.peers.append(peer)
            self._spawn(self._serve, peer)

    def _serve(self, peer: Peer) -> None:
        with peer.connection:
            with contextlib.suppress(OSError, struct.error, ValueError):
                for request in peer.messages():
                    self.requests.append(request)
                    if request["method"] in self.vanish_on:
                        break
                    if request["method"] not in self.silent:
                        self._answer(peer, request)
            # Out of the list before it is closed: nobody writes to it any more.
            self.peers.remove(peer)
            with contextlib.suppress(OSError):
                peer.connection.shutdown(socket.SHUT_RDWR)

    def _answer(self, peer: Peer, request: dict) -> None:
        method, params = request["method"], request.get("params", {})
        if self.token is not None and not peer.greeted and params.get("token") != self.token:
            self._refuse(peer, request, "denied", "the token is missing or wrong", "token")
            raise OSError
        peer.greeted = True
        answer = getattr(self, f"_{method}", None)
        if answer is None:
            self._refuse(peer, request, "unknown_method", f"no method {method}", "method")
        else:
            answer(peer, request, params)

    def _reply(self, peer: Peer, request: dict, result: object) -> None:
        if "id" in request:
            peer.write({"jsonrpc": "2.0", "id": request["id"], "result": result}, self.piece)

    def _refuse(self, peer: Peer, request: dict, code: str, message: str, where: str) -> None:
        error = {"code": -32602, "message": message, "data": {"code": code, "where": where}}
        peer.write({"jsonrpc": "2.0", "id": request.get("id"), "error": error}, self.piece)

    def _now(self) -> dict:
        return {"tick": self.tick, "t_ns": self.tick * TICK_NS}

    def _hello(self, peer: Peer, request: dict, params: dict) -> None:
        self._reply(peer, request, {"version": 1, "server": "uwserver 0.1.0", "scenario": "fake", "session": 1})

    def _describe(self, peer: Peer, request: dict, params: dict) -> None:
        pattern = params.get("pattern", "**")
        ports = [port for port in self.ports if fnmatch.fnmatch(port["path"], pattern)]
        world = {"scenario": "fake", "rate_hz": 250.0}
        self._reply(
            peer, request, {"server": {"name": "uwserver"}, "world": world, "ports": ports, "services": SERVICES}
        )

    def _subscribe(self, peer: Peer, request: dict, params: dict) -> None:
        pattern = params["pattern"]
        sensors = [port["path"] for port in self.ports if port["direction"] == "sensor"]
        covered = [path for path in sensors if fnmatch.fnmatch(path, pattern)]
        if pattern in self.refuse_patterns or (not covered and "*" not in pattern):
            self._refuse(peer, request, "unknown_port", f'no port "{pattern}"', pattern)
            return
        peer.patterns.append(pattern)
        self._reply(peer, request, {"subscription": len(peer.patterns), "ports": covered})
        for seq in range(self.samples):
            for path in covered:
                # One sequence number is left out, so that a gap can be seen.
                told = sample(path, seq if seq < 3 else seq + 1)
                peer.write({"jsonrpc": "2.0", "method": "sample", "params": told}, self.piece)

    def _unsubscribe(self, peer: Peer, request: dict, params: dict) -> None:
        self._reply(peer, request, {"removed": peer.patterns.count(params["pattern"])})

    def _command(self, peer: Peer, request: dict, params: dict) -> None:
        if any(abs(u) > 1 for u in params["value"]["u"]):
            self._refuse(peer, request, "out_of_range", "u is not within -1..1", "u")
        else:
            self._reply(peer, request, {**self._now(), "conflict": False})

    def _step(self, peer: Peer, request: dict, params: dict) -> None:
        self.tick += params.get("n", 1)
        self._reply(peer, request, self._now())

    def _cancel(self, peer: Peer, request: dict, params: dict) -> None:
        cancelled = peer.unfinished.pop(params["id"], None)
        self._reply(peer, request, {"cancelled": cancelled is not None})
        if cancelled is not None:
            self._refuse(peer, cancelled, "preempted", "cancelled by its caller", "rov/goto")

    def _call(self, peer: Peer, request: dict, params: dict) -> None:
        service, args = params["service"], params.get("args", {})
        value: object = None
        if service == "world/status":
            self.tick += 0 if self.paused else 10
            value = {"paused": self.paused, "speed": 1.0}
        elif service == "world/run_until":
            self.tick = round(args["t"] * 1e9 / TICK_NS)
        elif service == "echo":
            value = args
        elif service == "rov/goto":
            peer.unfinished[request["id"]] = request
            for fraction in (0.25, 0.5):
                progress = {"id": request["id"], "fraction": fraction, "t_ns": 0}
                peer.write({"jsonrpc": "2.0", "method": "progress", "params": progress}, self.piece)
            return
        elif service in ("world/pause", "world/resume"):
            self.paused = service == "world/pause"
        elif service != "world/reset":
            self._refuse(peer, request, "unknown_service", f'no service "{service}"', service)
            return
        self._reply(peer, request, {**self._now(), "value": value})


def sample(path: str, seq: int) -> dict:
    """Return the params of a sample; the imu's temperature is not measured in every second one."""
    value: dict[str, object] = {"depth": 1.5}
    if path == "rov/imu":
        value = {"f_S": [0.1 * seq, 0.0, -9.81], "temperature": 12.0 if seq % 2 == 0 else None}
    t_ns = seq * 2 * TICK_NS
    return {"port": path, "seq": seq, "t_ns": t_ns, "t_sent_ns": t_ns + TICK_NS, "valid": seq % 2 == 0, "value": value}
