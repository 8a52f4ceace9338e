"""The vehicle mode of MAVLink: cost of ground stations, and how fast they get the parameters.

The ground station has only as much of MAVLink as it needs, and shares no code with the adapter.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from threading import Event

from uwserver.simulation.clock import SystemTime
from uwserver.world.warm import warm
from uwserver_bench.processes import BenchFailed, Served, processor_s, scenario_file, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS

STATIONS, SHARE_BAR, PARAMETERS_BAR = 4, 5.0, 300.0
_PATIENCE_S = 20.0
_SCENARIO = """\
schema = 1
title = "bench mavlink"
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]
[vehicles.rov.autopilot]
[vehicles.rov.sensors.ahrs]
kind = "attitude"
rate_hz = 60
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.gcs]
kind = "mavlink"
links = ["udpin:127.0.0.1:0"]
origin_deg = [63.44, 10.39]
"""
_EXTRA = {0: 50, 21: 159, 66: 148}
"""CRC_EXTRA of each message that is sent: HEARTBEAT, PARAM_REQUEST_LIST, REQUEST_DATA_STREAM."""
_STREAMS = ((1, 2), (2, 2), (3, 2), (6, 3), (10, 20), (11, 10), (12, 3))
"""Group and rate (Hz) of the streams that QGroundControl requests from a submarine."""
_HEAD, _CHUNK = 10, 4096


def bench_mavlink(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on MAVLink.

    Args:
        quick: one short repeat.
        say: gets a line of progress.

    Raises:
        BenchFailed: the server did not work as expected.
    """
    name = f"{STATIONS} ground stations at the rates of QGroundControl: added share of a core"
    if find_spec("pymavlink") is None:
        return [Row("mavlink", name, "%", (), note="not measured: pip install uwserver")]
    warm()
    repeats, seconds = (1, 2.0) if quick else (3, 10.0)
    alone, shares, told, downloads = list[float](), list[float](), list[float](), list[float]()
    with _serving() as (served, port):
        for repeat in range(repeats):
            say(f"mavlink: repeat {repeat + 1} of {repeats}")
            base = _share(served.pid, lambda: SystemTime().wait(seconds, Event()))
            counts: list[int] = []
            with _stations(port) as stations:
                with_stations = _share(served.pid, lambda: counts.append(_listen(stations, seconds)))  # noqa: B023  # called at once
                downloads.append(_download(stations[0]))
            alone.append(base)
            shares.append(with_stations - base)
            told.append(counts[0] / seconds)
    return [
        Row("mavlink", name, "%", tuple(shares), at_most=SHARE_BAR),
        Row("mavlink", "messages to them", "1/s", tuple(told)),
        Row("mavlink", "share of a core of the server without them", "%", tuple(alone)),
        Row("mavlink", "parameters to one of them", "1/s", tuple(downloads), at_least=PARAMETERS_BAR),
    ]


@contextlib.contextmanager
def _serving() -> Iterator[tuple[Served, int]]:
    """Start a server. Yields it and its UDP port for ground stations."""
    with scenario_file(_SCENARIO) as scenario, serving(scenario) as served:
        address = served.ask(STATUS)["value"]["adapters"]["gcs"]["address"]
        yield served, int(address.rpartition(":")[2])


@contextlib.contextmanager
def _stations(port: int) -> Iterator[list[MavlinkPeer]]:
    """Start ground stations that have asked for telemetry."""
    with contextlib.ExitStack() as stack:
        peers = [stack.enter_context(contextlib.closing(MavlinkPeer(port, 255 - k))) for k in range(STATIONS)]
        for peer in peers:
            peer.beat()
            peer.ask_for_streams()
        _listen(peers, 1.0)
        yield peers


def _listen(peers: Sequence[MavlinkPeer], seconds: float) -> int:
    """Return the number of messages that all ground stations received in this time. Each sends a heartbeat once per second."""
    clock, heard = SystemTime(), 0
    end = clock.now_ns() + int(seconds * 1e9)
    beat_at = 0
    with selectors.DefaultSelector() as selector:
        for peer in peers:
            selector.register(peer, selectors.EVENT_READ, peer)
        while (now := clock.now_ns()) < end:
            if now - beat_at > 1_000_000_000:
                beat_at = now
                for peer in peers:
                    peer.beat()
            for key, _ in selector.select(max(0.0, min(0.2, (end - now) * 1e-9))):
                heard += len(key.data.read())
    return heard


def _download(peer: MavlinkPeer) -> float:
    """Download all parameters, and return their number per second."""
    clock = SystemTime()
    start = clock.now_ns()
    peer.ask_for_parameters()
    seen: set[int] = set()
    while (elapsed := (clock.now_ns() - start) * 1e-9) < _PATIENCE_S:
        for id, payload in peer.read(0.1):
            if id == MavlinkPeer.PARAM_VALUE:
                count, index = MavlinkPeer.count_and_index(payload)
                seen.add(index)
                if len(seen) == count:
                    return count / ((clock.now_ns() - start) * 1e-9)
    raise BenchFailed(f"{len(seen)} parameters came in {elapsed:.0f} s")


def _share(pid: int, work: Callable[[], object]) -> float:
    """Return the part of a core that a process uses during some work, in per cent."""
    clock = SystemTime()
    start_ns, start_s = clock.now_ns(), _cpu_s(pid)
    work()
    return 100.0 * (_cpu_s(pid) - start_s) / ((clock.now_ns() - start_ns) * 1e-9)


def _cpu_s(pid: int) -> float:
    spent = processor_s(pid)
    if spent is None:
        raise BenchFailed("processor time of the server is not known here: this system has no /proc")
    return spent


class MavlinkPeer:
    """One ground station on UDP.

    Args:
        port: port of the server, on loopback.
        system: its system number.
    """

    PARAM_VALUE = 22

    def __init__(self, port: int, system: int) -> None:
        self._system = system
        self._seq = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._socket.fileno()

    def beat(self) -> None:
        """Send a heartbeat."""
        self._send(0, struct.pack("<IBBBBB", 0, 6, 8, 0, 4, 3))

    def ask_for_streams(self) -> None:
        """Request telemetry."""
        for group, rate in _STREAMS:
            self._send(66, struct.pack("<HBBBB", rate, 1, 1, group, 1))

    def ask_for_parameters(self) -> None:
        """Request all parameters."""
        self._send(21, bytes((1, 1)))

    def read(self, timeout_s: float = 0.0) -> list[tuple[int, bytes]]:
        """Return numbers and payloads of the messages that have arrived. Waits at most `timeout_s` for the first one."""
        found: list[tuple[int, bytes]] = []
        if timeout_s:
            self._socket.settimeout(timeout_s)
            with contextlib.suppress(OSError):
                found += _messages(self._socket.recv(_CHUNK))
            self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            while True:
                found += _messages(self._socket.recv(_CHUNK))
        return found

    @staticmethod
    def count_and_index(payload: bytes) -> tuple[int, int]:
        """Return the count and the index in a PARAM_VALUE."""
        count, index = struct.unpack_from("<HH", payload.ljust(25, b"\0"), 4)
        return int(count), int(index)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, id: int, payload: bytes) -> None:
        body = bytes((len(payload), 0, 0, self._seq, self._system, 190)) + id.to_bytes(3, "little") + payload
        self._seq = (self._seq + 1) & 0xFF
        with contextlib.suppress(OSError):
            self._socket.send(b"\xfd" + body + _crc(body + bytes((_EXTRA[id],))).to_bytes(2, "little"))


def _messages(data: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while len(data) >= at + _HEAD and data[at] == 0xFD:
        size = data[at + 1]
        found.append((int.from_bytes(data[at + 7 : at + _HEAD], "little"), data[at + _HEAD : at + _HEAD + size]))
        at += _HEAD + size + 2
    return found


def _crc(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        low = (byte ^ crc) & 0xFF
        low = (low ^ low << 4) & 0xFF
        crc = crc >> 8 ^ low << 8 ^ low << 3 ^ low >> 4
    return crc
