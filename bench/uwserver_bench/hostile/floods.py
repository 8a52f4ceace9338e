"""Table of the floods against a running server. A new attack is a new row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from uwserver_adapters.moos import wire as moos

from uwserver.adapter import frame, line
from uwserver_bench.hostile.messages import JSON, MSGPACK

CONNECTIONS = 3
DATAGRAM_S = 0.001
"""Wall time between two datagrams of an attacker. Without a pause, UDP would let it use a whole processor, which is not what is measured."""
BURST = 100
BURST_S = BURST * CONNECTIONS / 50_000
"""All connections together send 50 000 datagrams per second."""
HEARTBEAT = bytes.fromhex("fd09000000ffbe000000000000000608c00403e473")
"""MAVLink 2 HEARTBEAT of a ground station, system 255, component 190."""
HELLO = b"hello"
"""Marks a flood by UDP that begins with a session, and so with the cookie of the server."""

WEB_SOCKET = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
"""Handshake of a flood over WebSocket."""

RATE_HZ = 240
SCENARIO = f"""\
schema = 1
title = "bench hostile"
[world]
rate_hz = {RATE_HZ}
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]
[vehicles.rov.autopilot]
[adapters.tcp]
kind = "sockets"
port = 0
udp_port = 0
[adapters.moos]
kind = "moosdb"
port = 0
[adapters.text]
kind = "moos_text"
port = 0
"""
MAVLINK = """\
[adapters.mavlink]
kind = "mavlink"
links = ["udpin:127.0.0.1:0"]
"""


@dataclass(frozen=True)
class Flood:
    """Connections that send the same bytes repeatedly, as fast as the server takes them. A closed connection is opened again.

    Attributes:
        name: name of the row.
        address: name of the address in the list of the server: that of the adapter, or "udp".
        data: bytes that are sent repeatedly.
        first: bytes that each connection sends once; `HELLO` for a session by UDP.
        connections: number of simultaneous connections.
        is_udp: whether they send datagrams.
        pause_s: wall time between two sendings of a connection.
        burst: number of datagrams in a sending.
    """

    name: str
    address: str
    data: bytes
    first: bytes = b""
    connections: int = CONNECTIONS
    is_udp: bool = False
    pause_s: float = 0.0
    burst: int = 1


def _tcp(name: str, data: bytes, **more: float) -> Flood:
    return Flood(f"TCP: {name}", "tcp", data, pause_s=more.get("pause_s", 0.0))


def _floods() -> Iterator[Flood]:
    for name in (
        "1 MiB of 1e300,", "8 KiB of 1e300,", "16 KiB of 1e9,", "64 KiB of 123.4567890123456,", "1500 of []", "}{ x 500 000", "1 MiB of base64",
        "integers of 4000 digits", "set_fault, 16 KiB of 1e9,", "set_mission, 700 items", "world/load, a piece of 768 KiB",
    ):  # fmt: skip
        yield _tcp(name, line(JSON[name]))
    for name in ("a misspelt service", "describe, another pattern", "world/describe"):
        yield _tcp(name, line(JSON[name]) * 20)
    yield _tcp("256 KiB of blank lines", b"\n" * (1 << 18))
    part, upgrade = bytes((0, 0x81)) + bytes(4) + b"x", WEB_SOCKET
    yield Flood("WebSocket: parts of a text", "tcp", part * 10_000, upgrade + bytes((1, 0x80)) + bytes(4))
    yield Flood("WebSocket: pongs", "tcp", (bytes((0x8A, 0x80)) + bytes(4)) * 10_000, upgrade)
    yield _tcp("small pings, 1000 in a piece", line(b'{"id":1,"method":"ping"}') * 1000)
    for name in ("250 000 texts", "6000 texts", "1500 maps", "a buffer of 1 MiB"):
        yield _tcp(f"msgpack, {name}", frame(MSGPACK[name]))
    yield Flood(
        "UDP strangers: 2 KiB of 1e300,", "udp", JSON["16 KiB of 1e300,"][:2040], is_udp=True, pause_s=DATAGRAM_S
    )
    yield Flood("UDP: 16 KiB of 1e9,", "udp", JSON["16 KiB of 1e9,"], HELLO, is_udp=True, pause_s=DATAGRAM_S)
    greeting = moos.HELLO + moos.packet(
        [moos.encode(moos.MoosMessage(moos.DATA, moos.ASYNCHRONOUS, data=b"flood%d", kind=moos.STRING))]
    )
    writes = moos.packet([moos.encode(moos.notify("FLOOD", 1.0, 0.0, "flood"))] * 2048)
    yield Flood("MOOSDB: 2048 writes in a packet", "moos", writes, greeting)
    looks = moos.packet(
        [moos.encode(moos.wildcard(moos.WILDCARD_REGISTER, "flood", 0.0, f"*A*B{n}", "*")) for n in range(200)]
    )
    all_of = moos.packet([moos.encode(moos.MoosMessage(moos.SERVER_REQUEST, "ALL", id=-2))])
    new = moos.packet([moos.encode(moos.notify("A" * 200 + str(n), 1.0, 0.0, "flood")) for n in range(2048)])
    yield Flood("MOOSDB: 2048 new variables, 200 patterns", "moos", new + all_of, greeting + looks)
    yield Flood("MOOS text: 256 writes in a line", "text", b"A=1 " * 256 + b"\n")
    for name, size in (("hello", 100), ("one byte", 1)):
        small = (b'{"id":1,"method":"hello","params":{"version":1}}').ljust(size) if size > 1 else b"{"
        yield Flood(f"UDP strangers: 50 000/s of {name}", "udp", small, is_udp=True, pause_s=BURST_S, burst=BURST)
    yield Flood("MAVLink UDP: 50 000 heartbeats/s", "mavlink", HEARTBEAT, is_udp=True, pause_s=BURST_S, burst=BURST)
    yield Flood("MAVLink UDP: 64 KiB of 0xFD", "mavlink", b"\xfd" * 65_507, is_udp=True, pause_s=DATAGRAM_S)


FLOODS: Mapping[str, Flood] = {flood.name: flood for flood in _floods()}
HAS_MAVLINK = find_spec("pymavlink") is not None
