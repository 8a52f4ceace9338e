"""Servers of both versions with the same clients: processor time for the same simulated time, start, memory, and latencies.

Both servers of a pair exist at the same time; all are paused except the one that is measured. It runs until a given time, at four times real time. So
it does the same work whatever else the machine does, and no client falls behind.
"""

from __future__ import annotations

import contextlib
import selectors
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from threading import Event
from typing import Any, Protocol

from uwserver.simulation.clock import SystemTime
from uwserver_bench.against import scenarios
from uwserver_bench.against.installation import Installation
from uwserver_bench.against.pairs import Kind, Pairs, Unable, in_turns
from uwserver_bench.autopilots.mavlink import MavlinkPeer
from uwserver_bench.moos import moos_load
from uwserver_bench.moos.moos_load import MoosPeer
from uwserver_bench.net.wires import Peer, Refusal, SocketPeer, ZenohPeer, ask, connect
from uwserver_bench.processes import BenchFailed, Served, processor_s, resident_mb, serving
from uwserver_bench.report import quantile
from uwserver_bench.server import LATENESS_BAR_MS, START_BAR_S, STATUS, first_sample, lateness_p99_ms

SPEED = 4.0
CLIENTS, STATIONS = 30, 4
READING_P50_BAR_MS, COMMAND_P99_BAR_MS = 1.0, 1e3 / scenarios.RATE_HZ + 2.0
_PATIENCE_S = 60.0
_QUIET_S = 0.05
_clock = SystemTime()


class ReceivingClient(Protocol):
    """A client that receives data."""

    def fileno(self) -> int | None:
        """Return the file descriptor, for a selector; None if there is none."""

    def drain(self) -> int:
        """Receive what has come, and return its amount."""

    def close(self) -> None:
        """Close the connection."""


class _Reader:
    """Receives bytes without reading them, so that clients cost little compared with the server."""

    def __init__(self, peer: SocketPeer) -> None:
        self._socket = peer.socket
        self.fileno, self.close = peer.fileno, peer.close

    def drain(self) -> int:
        return len(self._socket.recv(1 << 20))


class _Station(MavlinkPeer):
    """A ground station that counts messages."""

    def drain(self) -> int:
        return len(self.read())


class _Database(MoosPeer):
    """A MOOS client that counts notifications."""

    def drain(self) -> int:
        return len(self.receive(0.0))


class _Session(ZenohPeer):
    """A zenoh client that counts samples."""

    def drain(self) -> int:
        return len(self.receive(0.0))


@dataclass(frozen=True)
class Running:
    """A paused server of one version.

    Attributes:
        control: connection for control requests.
        addresses: addresses of its adapters, by name.
        start_s, start_cpu_s: wall time and processor time from its creation to the first sample at a client.
        memory_mb: resident memory then.
    """

    served: Served
    control: Peer
    addresses: Mapping[str, str]
    start_s: float
    start_cpu_s: float
    memory_mb: float

    def call(self, service: str, **args: object) -> Any:
        """Call a service, and return the result."""
        return ask(self.control, "call", _PATIENCE_S, service=service, args=args)["value"]

    def cpu_s(self) -> float:
        """Return the processor time that it has used, s."""
        spent = processor_s(self.served.pid)
        if spent is None:
            raise BenchFailed("processor time of a server is not known here: this system has no /proc")
        return spent

    def run(self, seconds: float, listeners: Sequence[ReceivingClient] = ()) -> float:
        """Let it run for `seconds`, then pause it. Returns the processor time of a simulated second.

        Raises:
            BenchFailed: it did not reach that time, or a listener received nothing.
        """
        goal = float(self.call("world/status")["t_s"]) + seconds
        before, heard = self.cpu_s(), dict.fromkeys(listeners, 0)
        identity = _clock.now_ns()
        self.control.send("call", {"service": "world/run_until", "args": {"t_s": goal}}, identity)
        with selectors.DefaultSelector() as selector:
            control = selector.register(self.control.fileno() or 0, selectors.EVENT_READ)
            for listener in listeners:
                if (number := listener.fileno()) is not None:
                    selector.register(number, selectors.EVENT_READ, listener)
            end, arrived = _clock.now_ns() + int(_PATIENCE_S * 1e9), False
            # Samples that are still in flight then are part of the work.
            while ready := selector.select(_QUIET_S if arrived else _PATIENCE_S):
                for key, _ in ready:
                    if key is control:
                        arrived = self._replied(identity) or arrived
                    else:
                        heard[key.data] += key.data.drain()
                if _clock.now_ns() > end:
                    break
            if not arrived:
                raise BenchFailed(f"a server did not simulate {seconds:g} s within {_PATIENCE_S:g} s")
        for listener in listeners:
            if listener.fileno() is None:
                heard[listener] += listener.drain()
        if not all(heard.values()):
            raise BenchFailed(f"{sum(not n for n in heard.values())} of {len(heard)} clients heard nothing")
        return (self.cpu_s() - before) / seconds

    def _replied(self, identity: int) -> bool:
        for message in self.control.receive(0.0):
            if message.body.get("id") == identity:
                if "error" in message.body:
                    raise BenchFailed(f"world/run_until: {message.body['error']['message']}")
                if "result" in message.body:
                    return True
        return False


@contextlib.contextmanager
def running(version: Installation, scenario: Path, place: Path) -> Iterator[Running]:
    """Run a server. It has sent its first sample, and is paused.

    Raises:
        Unable: it did not start.
    """
    begin = _clock.now_ns()
    with contextlib.ExitStack() as stack:
        try:
            served = stack.enter_context(serving(scenario, version.python, version.environment, place))
        except BenchFailed as error:
            raise Unable(str(error)) from error
        first_sample(served)
        start_s = (_clock.now_ns() - begin) * 1e-9
        cpu_s, memory_mb = processor_s(served.pid) or 0.0, resident_mb(served.pid) or 0.0
        control = connect("TCP msgpack", f"{served.host}:{served.port}")
        stack.callback(control.close)
        ask(control, "call", service="world/pause")
        adapters = served.ask(STATUS)["value"]["adapters"]
        addresses = {name: str(adapter["address"]) for name, adapter in adapters.items()}
        yield Running(served, control, addresses, start_s, cpu_s, memory_mb)


# -- measurements --------------------------------------------------------------------------------------------------------------------


def _crowd(wire: str) -> Callable[[Running], list[ReceivingClient]]:
    def join(server: Running) -> list[ReceivingClient]:
        found: list[ReceivingClient] = []
        for _ in range(CLIENTS):
            peer = connect(wire, server.addresses["tcp"])
            assert isinstance(peer, SocketPeer)
            ask(peer, "subscribe", pattern="**")
            found.append(_Reader(peer))
        return found

    return join


def _stations(server: Running) -> list[ReceivingClient]:
    port = int(server.addresses["gcs"].rpartition(":")[2])
    stations = [_Station(port, 255 - k) for k in range(STATIONS)]
    for station in stations:
        station.beat()
        station.ask_for_streams()
    return [*stations]


def _navigation(server: Running) -> list[ReceivingClient]:
    reader = _Database(server.addresses["moos"], f"bench{_clock.now_ns()}")
    reader.hear("NAV_*")
    return [reader]


def _session(server: Running) -> list[ReceivingClient]:
    session = _Session(server.addresses["zenoh"])
    ask(session, "subscribe", pattern="**")
    return [session]


CROWDS: Mapping[str, tuple[str, Callable[[Running], list[ReceivingClient]]]] = {
    "world, sensors, adapters without a client": ("", lambda server: []),
    f"the same with {CLIENTS} clients of TCP JSON": ("", _crowd("TCP JSON")),
    f"with {CLIENTS} clients of TCP msgpack": ("", _crowd("TCP msgpack")),
    f"with {CLIENTS} clients of WebSocket": ("", _crowd("WebSocket")),
    "with a zenoh client": ("zenoh", _session),
    f"with {STATIONS} MAVLink ground stations": ("pymavlink", _stations),
    "with a MOOS client of NAV_*": ("", _navigation),
}
"""For each figure the extra that its listeners need, and the function that makes them."""
_SERVERS = Kind("server", "all that needs a server", "")


class Servers:
    """Measures pairs of servers.

    Args:
        versions: by side.
        place: an empty working directory, for the scenario.
        quick: very little work in each turn.
        extras: those of `EXTRAS` that both versions have.
    """

    def __init__(self, versions: Mapping[str, Installation], place: Path, quick: bool, extras: Collection[str]) -> None:
        self._versions, self._place, self._extras = versions, place, extras
        self._seconds, self._calls, self._flow_s = (0.4, 10, 0.1) if quick else (2.0, 150, 0.4)
        self._scenario = place / "server.toml"
        self._scenario.write_text(scenarios.server("pymavlink" in extras, "zenoh" in extras), encoding="utf-8")

    def measure(self, pair: int, pairs: Pairs) -> None:
        """Measure one pair of every figure, with new servers.

        Raises:
            BenchFailed: our version failed.
        """
        turns = in_turns(pair)
        if pairs.left_out(_SERVERS):
            return
        with contextlib.ExitStack() as stack:
            servers: dict[str, Running] = {}
            for side in turns[:2]:
                try:
                    servers[side] = stack.enter_context(running(self._versions[side], self._scenario, self._place))
                except Unable as error:
                    if side == "ours":
                        raise BenchFailed(str(error)) from error
                    pairs.leave_out(_SERVERS, f"their version: {error}")
                    return
            self._starts(turns[:2], servers, pairs)
            self._latencies(turns[:2], servers, pairs)
            for server in servers.values():
                server.call("world/set_speed", speed=SPEED)
                server.run(0.2)
            for name, (extra, join) in CROWDS.items():
                kind = Kind("server", name, "ms/s")
                if extra and extra not in self._extras:
                    pairs.leave_out(kind, f"{extra} is not installed on both sides")
                pairs.measure(kind, turns[:2], lambda side, join=join: self._crowd_ms(servers[side], join))  # type: ignore[misc]
            self._requests(turns, servers, pairs)
            kind = Kind("server", "a double through the MOOS database", "us")
            pairs.measure(kind, turns, lambda side: self._flow_us(servers[side]))

    @staticmethod
    def _starts(turns: Sequence[str], servers: Mapping[str, Running], pairs: Pairs) -> None:
        pairs.measure(
            Kind("start", "start to the first sample, processor time", "s"),
            turns,
            lambda side: servers[side].start_cpu_s,
        )
        pairs.measure(Kind("start", "memory with a client", "MB"), turns, lambda side: servers[side].memory_mb)
        pairs.measure(
            Kind("latencies", "start to the first sample", "s", START_BAR_S), turns, lambda side: servers[side].start_s
        )

    def _latencies(self, turns: Sequence[str], servers: Mapping[str, Running], pairs: Pairs) -> None:
        """Measure latencies in real time, with one client."""
        status = Kind("latencies", "world/status, p50", "ms", READING_P50_BAR_MS)
        command = Kind("latencies", "command to its reply, p99", "ms", COMMAND_P99_BAR_MS)
        lateness = Kind("latencies", f"tick lateness p99 at {scenarios.RATE_HZ} Hz", "ms", LATENESS_BAR_MS)
        if not any(map(pairs.wanted, (status, command, lateness))):
            return
        for side in turns:
            server = servers[side]
            server.call("world/resume")
            read = [self._took_ms(server, "call", service="world/status", args={}) for _ in range(self._calls)]
            value = {"u": [0.1] * 8}
            told = [self._took_ms(server, "command", port="rov/thrusters", value=value) for _ in range(self._calls)]
            late = lateness_p99_ms(server.served)
            server.call("world/pause")
            for kind, found in ((status, median(read)), (command, quantile(told, 0.99)), (lateness, late)):
                if pairs.wanted(kind):
                    pairs.add(kind, side, found)

    @staticmethod
    def _took_ms(server: Running, method: str, **params: Any) -> float:
        start = _clock.now_ns()
        ask(server.control, method, _PATIENCE_S, **params)
        return (_clock.now_ns() - start) * 1e-6

    def _crowd_ms(self, server: Running, join: Callable[[Running], list[ReceivingClient]]) -> float:
        try:
            listeners = join(server)
        except (OSError, KeyError, Refusal) as error:
            raise Unable(f"{type(error).__name__}: {error}") from error
        try:
            return 1e3 * server.run(self._seconds, listeners)
        finally:
            for listener in listeners:
                listener.close()

    def _requests(self, turns: Sequence[str], servers: Mapping[str, Running], pairs: Pairs) -> None:
        """Measure requests one after the other, while the world is paused."""
        kinds: dict[str, tuple[str, str, dict[str, Any]]] = {
            "a ping over TCP JSON": ("TCP JSON", "ping", {}),
            "a call of a sensor's properties, TCP JSON": ("TCP JSON", "call", {"service": "rov/imu/get"}),
            "a call of a sensor's properties, TCP msgpack": ("TCP msgpack", "call", {"service": "rov/imu/get"}),
            "world/status, TCP JSON": ("TCP JSON", "call", {"service": "world/status"}),
        }
        for name, (wire, method, params) in kinds.items():

            def cost(side: str, wire: str = wire, method: str = method, params: Mapping[str, Any] = params) -> float:
                server = servers[side]
                with contextlib.closing(connect(wire, server.addresses["tcp"])) as peer:
                    ask(peer, method, _PATIENCE_S, **params)
                    before = server.cpu_s()
                    for _ in range(self._calls):
                        ask(peer, method, _PATIENCE_S, **params)
                    return 1e6 * (server.cpu_s() - before) / self._calls

            pairs.measure(Kind("server", name, "us"), turns, cost)

    def _flow_us(self, server: Running) -> float:
        before = server.cpu_s()
        count = moos_load.flow({"address": server.addresses["moos"], "seconds": self._flow_s})["count"]
        assert isinstance(count, int)
        if not count:
            raise BenchFailed("nothing came through the MOOS database")
        _clock.wait(_QUIET_S, Event())
        return 1e6 * (server.cpu_s() - before) / count
