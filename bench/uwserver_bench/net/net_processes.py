"""The processes of `uwserver bench net`: a server with a trace of its ticks, and a zenoh router that can be killed."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from uwserver_bench.processes import BenchFailed, Served, processor_s, running, scenario_file
from uwserver_bench.server import RATE_HZ, VEHICLE

WIRE_ADDRESS: Mapping[str, str] = {
    "TCP JSON": "tcp", "TCP msgpack": "tcp", "WebSocket": "tcp", "UDP": "udp", "zenoh": "zenoh",
}  # fmt: skip
"""Names under which the server lists the address of each transport."""
HAS_ZENOH = importlib.util.find_spec("zenoh") is not None
NO_ZENOH = "not measured: pip install uwserver"

_SCENARIO = f"""\
schema = 1
title = "bench net"

[world]
rate_hz = {RATE_HZ}

[world.clock]
mode = "%s"

[server]
metrics = false

{VEHICLE}
[vehicles.rov.truth]
rate_hz = {RATE_HZ}.0

[adapters.tcp]
kind = "sockets"
port = 0
udp_port = 0
truth = true
"""
_ZENOH = """
[adapters.zenoh]
kind = "zenoh"
scouting = false
encoding = "msgpack"
truth = true
"""


@dataclass(frozen=True)
class Traced:
    """A running server, with its addresses by name, its trace file, and a connection for requests."""

    addresses: Mapping[str, str]
    trace: str
    served: Served

    def place(self, wire: str) -> dict[str, object]:
        """Return the arguments with which a task of the load process reaches it."""
        return {
            "wire": wire,
            "address": self.addresses[WIRE_ADDRESS[wire]],
            "trace": self.trace,
            "rate_hz": RATE_HZ,
        }

    def processor_s(self) -> float | None:
        """Return the processor time that its threads have used, s; None if the system does not tell."""
        return processor_s(self.served.pid)


@contextlib.contextmanager
def tracing(mode: str = "realtime", router: str = "", megabyte: bool = False) -> Iterator[Traced]:
    """Run a server on free loopback ports, with sockets and (if installed) zenoh, while the context is open.

    Args:
        mode: mode of its clock.
        router: endpoint of a zenoh router to which it connects; without one it listens as a peer.
        megabyte: whether it has a sensor with samples of a megabyte at 10 Hz.

    Raises:
        BenchFailed: it did not start.
    """
    way = f'mode = "client"\nconnect = ["{router}"]\n' if router else 'listen = ["tcp/127.0.0.1:0"]\n'
    text = _SCENARIO % mode + (_ZENOH + way if HAS_ZENOH else "")
    with traced_server(text, *(["megabyte"] if megabyte else [])) as traced:
        yield traced


@contextlib.contextmanager
def traced_server(text: str, *options: str, is_quiet: bool = False) -> Iterator[Traced]:
    """Run a server of a scenario with an adapter `tcp` of sockets, while the context is open. Options are those of `traced`.

    A quiet one prints no messages.

    Raises:
        BenchFailed: it did not start.
    """
    with scenario_file(text) as scenario:
        trace = str(scenario.with_suffix(".trace"))
        command = [sys.executable, "-m", "uwserver_bench.net.traced", str(scenario), trace, *options]
        with running(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL if is_quiet else None) as process:
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line:
                raise BenchFailed("the traced server did not start" + ("" if is_quiet else ": see its message above"))
            addresses = json.loads(line)
            host, _, port = addresses["tcp"].rpartition(":")
            yield Traced(addresses, trace, Served(host, int(port), process.pid))


def free_endpoint() -> str:
    """Return an unused zenoh endpoint on loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Router:
    """A zenoh router at an endpoint. It is ready when the object is made.

    Raises:
        BenchFailed: it did not start.
    """

    def __init__(self, endpoint: str) -> None:
        command = [sys.executable, "-m", "uwserver_bench.net.router", endpoint]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        if not self._process.stdout.readline():
            self.kill()
            raise BenchFailed("the zenoh router did not start: see its message above")

    def kill(self) -> None:
        """Kill its process."""
        self._process.kill()
        with self._process:
            self._process.wait()
