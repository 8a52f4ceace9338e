"""A small client for each transport, all with the same few methods, for the load process and for tests of all transports.

A message is a map as in docs/reference/protocol.md, for every transport.
"""

from __future__ import annotations

import contextlib
import json
import queue
import socket
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import msgspec

from uwserver.simulation.clock import SystemTime

CONNECT_S = 10.0
_CHUNK = 1 << 18
_clock = SystemTime()


class TimedMessage(NamedTuple):
    """A decoded message, and the monotonic time (ns) at which the client received it."""

    at_ns: int
    body: dict[str, Any]


class Refusal(Exception):
    """The server refused a request."""


class Peer(Protocol):
    """One client of a server."""

    def send(self, method: str, params: Mapping[str, object], identity: int) -> None:
        """Send a request."""

    def receive(self, timeout_s: float) -> list[TimedMessage]:
        """Return the messages that have arrived; [] if none came in time.

        Raises:
            ConnectionError: the server closed the connection.
        """

    def fileno(self) -> int | None:
        """Return the file descriptor, for a selector; None if there is none."""

    def close(self) -> None:
        """Close the connection."""


def ask(
    peer: Peer, method: str, timeout_s: float = CONNECT_S, seen: list[TimedMessage] | None = None, **params: object
) -> Any:
    """Send a request, and return its result. Other messages that come meanwhile are added to `seen`.

    Raises:
        Refusal: the server refused it.
        TimeoutError: no reply in time.
    """
    identity = _clock.now_ns()
    peer.send(method, params, identity)
    end, result, found = _clock.now_ns() + int(timeout_s * 1e9), None, False
    while not found:
        if _clock.now_ns() >= end:
            raise TimeoutError(f"no reply to {method} within {timeout_s:g} s")
        for message in peer.receive(0.1):
            if message.body.get("id") != identity:
                if seen is not None:
                    seen.append(message)
            elif "error" in message.body:
                raise Refusal(f"{method}: {message.body['error']['message']}")
            else:
                result, found = message.body["result"], True
    return result


class Framing(Protocol):
    """Encodes and decodes the messages of one connection."""

    def encode(self, body: Mapping[str, object]) -> bytes:
        """Encode a message."""

    def feed(self, chunk: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these bytes."""


class JsonLines:
    """One JSON object in each line."""

    def __init__(self) -> None:
        self._rest = b""

    def encode(self, body: Mapping[str, object]) -> bytes:
        """See `Framing`."""
        return msgspec.json.encode(body) + b"\n"

    def feed(self, chunk: bytes) -> list[dict[str, Any]]:
        """See `Framing`."""
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        return [msgspec.json.decode(line) for line in lines]


class MsgpackFrames:
    """Length as u32, big-endian, then one msgpack map."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def encode(self, body: Mapping[str, object]) -> bytes:
        """See `Framing`."""
        packed = msgspec.msgpack.encode(body)
        return len(packed).to_bytes(4, "big") + packed

    def feed(self, chunk: bytes) -> list[dict[str, Any]]:
        """See `Framing`."""
        self._rest += chunk
        found, start = [], 0
        while len(self._rest) >= start + 4:
            end = start + 4 + int.from_bytes(self._rest[start : start + 4], "big")
            if len(self._rest) < end:
                break
            found.append(msgspec.msgpack.decode(self._rest[start + 4 : end]))
            start = end
        del self._rest[:start]
        return found


class SocketPeer:
    """A connected TCP or UDP socket with a framing.

    Args:
        connected: the socket.
        framing: framing of its messages.
    """

    def __init__(self, connected: socket.socket, framing: Framing) -> None:
        self.socket = connected
        self._framing = framing

    def send(self, method: str, params: Mapping[str, object], identity: int) -> None:
        """See `Peer`."""
        body = {"jsonrpc": "2.0", "id": identity, "method": method, "params": params}
        self.socket.sendall(self._framing.encode(body))

    def receive(self, timeout_s: float) -> list[TimedMessage]:
        """See `Peer`."""
        self.socket.settimeout(max(timeout_s, 1e-6))
        try:
            chunk = self.socket.recv(_CHUNK)
        except TimeoutError:
            return []
        if not chunk:
            raise ConnectionError("the server closed a connection")
        bodies = self._framing.feed(chunk)
        now = _clock.now_ns()
        return [TimedMessage(now, body) for body in bodies]

    def fileno(self) -> int:
        """See `Peer`."""
        return self.socket.fileno()

    def close(self) -> None:
        """See `Peer`."""
        self.socket.close()


class WebSocketFrames:
    """JSON in text messages of a WebSocket, by the part of the websockets library that does no I/O."""

    def __init__(self, connected: socket.socket, host: str, port: int) -> None:
        from websockets.client import ClientProtocol
        from websockets.frames import Opcode
        from websockets.uri import parse_uri

        self._protocol = ClientProtocol(parse_uri(f"ws://{host}:{port}/"), max_size=None)
        self._message_opcodes = (Opcode.TEXT, Opcode.CONT)
        self._partial = b""
        self._protocol.send_request(self._protocol.connect())
        connected.sendall(b"".join(self._protocol.data_to_send()))
        while self._protocol.state.name == "CONNECTING":
            chunk = connected.recv(_CHUNK)
            if not chunk:
                raise ConnectionError("the server ended the connection in the WebSocket handshake")
            self._protocol.receive_data(chunk)
            if self._protocol.handshake_exc is not None:
                raise ConnectionError(f"no WebSocket: {self._protocol.handshake_exc}")

    def encode(self, body: Mapping[str, object]) -> bytes:
        """See `Framing`."""
        self._protocol.send_text(msgspec.json.encode(body))
        return b"".join(self._protocol.data_to_send())

    def feed(self, chunk: bytes) -> list[dict[str, Any]]:
        """See `Framing`."""
        self._protocol.receive_data(chunk)
        found = []
        for frame in self._protocol.events_received():
            if getattr(frame, "opcode", None) in self._message_opcodes:
                self._partial += frame.data  # type: ignore[union-attr]
                if frame.fin:  # type: ignore[union-attr]
                    found.append(msgspec.json.decode(self._partial))
                    self._partial = b""
        return found


class Datagrams:
    """One JSON message in each datagram."""

    def encode(self, body: Mapping[str, object]) -> bytes:
        """See `Framing`."""
        return msgspec.json.encode(body)

    def feed(self, chunk: bytes) -> list[dict[str, Any]]:
        """See `Framing`."""
        return [msgspec.json.decode(chunk)]


class ZenohPeer:
    """A zenoh session with a server. Its callbacks decode messages, add the time, and queue them."""

    def __init__(self, endpoint: str, server: str = "uwserver", mode: str = "peer") -> None:
        import zenoh

        self._zenoh: Any = zenoh
        config: Any = zenoh.Config()
        settings: dict[str, object] = {
            "mode": mode,
            "connect/endpoints": [endpoint],
            "listen/endpoints": [],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
            "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        }
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        self._session: Any = zenoh.open(config)
        self._root = f"uw/{server}"
        self._queue: queue.SimpleQueue[TimedMessage] = queue.SimpleQueue()

    def send(self, method: str, params: Mapping[str, object], identity: int) -> None:
        """See `Peer`. The zenoh session itself handles `subscribe`. When a later request is answered, the server knows of the subscription."""
        if method == "subscribe":
            key = f"{self._root}/{params['pattern']}"
            self._session.declare_subscriber(
                key, self._direct(self._on_sample), allowed_origin=self._zenoh.Locality.REMOTE
            )
            self._session.get(f"{self._root}/@describe", self._direct(lambda reply: self._on_reply(identity, reply)))
            return
        targets = {"command": (params.get("port"), params.get("value")), "step": ("world/step", params)}
        path, value = targets.get(method, (params.get("service"), params.get("args") or {}))
        self._session.get(
            f"{self._root}/{path}",
            self._direct(lambda reply: self._on_reply(identity, reply)),
            payload=msgspec.msgpack.encode(value),
            encoding="application/msgpack",
            timeout=60.0,
            priority=self._zenoh.Priority.REAL_TIME,
            express=True,
        )

    def receive(self, timeout_s: float) -> list[TimedMessage]:
        """See `Peer`."""
        found = []
        with contextlib.suppress(queue.Empty):
            found.append(self._queue.get(timeout=timeout_s) if timeout_s > 0.0 else self._queue.get_nowait())
            while True:
                found.append(self._queue.get_nowait())
        return found

    def fileno(self) -> None:
        """See `Peer`."""

    def close(self) -> None:
        """See `Peer`."""
        self._session.close()

    def _direct(self, callback: Callable[[Any], None]) -> Any:
        return self._zenoh.handlers.Callback(callback, indirect=False)

    def _on_sample(self, sample: Any) -> None:
        if sample.attachment is None:
            return  # the reply to a command of another client
        meta = _decoded(sample.attachment.to_bytes(), str(sample.encoding))
        params = {**meta, "value": _decoded(sample.payload.to_bytes(), str(sample.encoding))}
        self._queue.put(TimedMessage(_clock.now_ns(), {"method": "sample", "params": params}))

    def _on_reply(self, identity: int, reply: Any) -> None:
        answer = reply.ok if reply.ok is not None else reply.err
        body = _decoded(answer.payload.to_bytes(), str(answer.encoding))
        key = "result" if reply.ok is not None else "error"
        self._queue.put(TimedMessage(_clock.now_ns(), {"id": identity, key: body}))


def _decoded(payload: bytes, media: str) -> Any:
    return msgspec.msgpack.decode(payload) if media == "application/msgpack" else msgspec.json.decode(payload)


def connect(wire: str, address: str) -> Peer:
    """Connect by a transport of `WIRES`. `address` is "host:port", or an endpoint for zenoh.

    Raises:
        OSError: no server answers.
        ImportError: the library of the transport is not installed.
    """
    return WIRES[wire](address)


def _tcp(address: str, make: Callable[[socket.socket, str, int], Framing]) -> SocketPeer:
    host, _, port = address.rpartition(":")
    connected = socket.create_connection((host, int(port)), timeout=CONNECT_S)
    try:
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return SocketPeer(connected, make(connected, host, int(port)))
    except BaseException:
        connected.close()
        raise


def _udp(address: str) -> SocketPeer:
    host, _, port = address.rpartition(":")
    connected = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    connected.connect((host, int(port)))
    peer = SocketPeer(connected, Datagrams())
    # The first hello is answered with a cookie, which the second one must contain.
    hello = {"version": 1, "cookie": "-" * 64}
    for _ in range(2):
        peer.send("hello", hello, 0)
        answers = peer.receive(CONNECT_S)
        if not answers:
            peer.close()
            raise ConnectionError("no answer to a UDP hello")
        hello = {"version": 1, "cookie": answers[0].body.get("cookie", "")}
    return peer


WIRES: Mapping[str, Callable[[str], Peer]] = {
    "TCP JSON": lambda address: _tcp(address, lambda connected, host, port: JsonLines()),
    "TCP msgpack": lambda address: _tcp(address, lambda connected, host, port: MsgpackFrames()),
    "WebSocket": lambda address: _tcp(address, WebSocketFrames),
    "UDP": _udp,
    "zenoh": ZenohPeer,
}
"""The function that connects, for each transport."""
