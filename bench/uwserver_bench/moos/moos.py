"""The embedded MOOSDB: throughput, latency of NAV_*, fan-out to many clients, and warp 20, each with a running vehicle. For comparison the
throughput of the MOOSDB of MOOS-IvP, if the environment variable UWSERVER_MOOS_BIN names its folder."""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from threading import Event

from uwserver.simulation.clock import SystemTime
from uwserver.world.warm import warm
from uwserver_bench.net.net_processes import Traced, traced_server
from uwserver_bench.processes import START_TIMEOUT_S, BenchFailed, Bystanders, Load, loading, running
from uwserver_bench.report import Row
from uwserver_bench.server import ADDED_LATENESS_BAR_MS, LATENESS_BAR_MS, STATUS, UNKNOWN, lateness_p99_ms

FLOW_BAR, NAV_P99_BAR_MS, CROWD_BAR, WARP = 20_000.0, 20.0, 20_000.0, 20.0
CLIENTS, CROWD_PER_S = 50, 20_500.0
RATE_HZ = 240
VARIABLE = "UWSERVER_MOOS_BIN"
NO_MOOSDB = f"not measured: {VARIABLE} names no folder with a MOOSDB"
_LOAD = "uwserver_bench.moos.moos_load"
_SETTLE_S = 1.5

_SCENARIO = """\
schema = 1
title = "bench moos"
[world]
rate_hz = {rate}
[world.clock]
speed = {speed}
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]
[vehicles.rov.truth]
rate_hz = 20
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.moos]
kind = "moosdb"
port = 0
truth = true
[adapters.moos.bridge]
publish = []
[adapters.moos.bridge.nav]
"""


def bench_moos(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on MOOS.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    warm()
    repeats, seconds = (1, 0.5) if quick else (3, 3.0)
    rates, nav, crowd, factors = list[float](), list[float](), list[float](), list[float]()
    alone, late, busy = list[float](), list[float](), list[float]()
    with loading(_LOAD) as load:
        for repeat in range(repeats):
            say(f"moos: repeat {repeat + 1} of {repeats}")
            with _serving(1.0) as traced:
                place = {"address": traced.addresses["moos"], "trace": traced.trace, "rate_hz": RATE_HZ}
                nav.append(load.ask("navigation", **place, seconds=max(seconds, 2.0))["p99_s"] * 1e3)
                rates.append(load.ask("flow", **place, seconds=seconds)["per_s"])
            with _serving(1.0) as traced:
                bystanders = Bystanders(traced.served.pid)
                SystemTime().wait(seconds, Event())
                alone.append(lateness_p99_ms(traced.served))
                busy += [cores] if (cores := bystanders.cores()) is not None else []
            with _serving(1.0) as traced:
                place = {"address": traced.addresses["moos"]}
                crowd.append(load.ask("crowd", **place, seconds=seconds, clients=CLIENTS, per_s=CROWD_PER_S)["per_s"])
                late.append(lateness_p99_ms(traced.served))
            with _serving(WARP) as traced:
                place = {"address": traced.addresses["moos"], "trace": traced.trace, "rate_hz": RATE_HZ}
                SystemTime().wait(_SETTLE_S, Event())
                load.ask("navigation", **place, seconds=max(seconds, 2.0))
                factors.append(float(traced.served.ask(STATUS)["value"]["real_time_factor"]))
        theirs = _their_rates(load, repeats, seconds)
    added = tuple(there - without for there, without in zip(late, alone, strict=True))
    return [
        Row("moos", "doubles through the embedded MOOSDB, both ends here", "1/s", tuple(rates), at_least=FLOW_BAR),
        Row("moos", "the same through the MOOSDB of MOOS-IvP", "1/s", theirs, at_least=FLOW_BAR, note="" if theirs else NO_MOOSDB),
        Row("moos", "NAV_*: end of the tick to the client, p99", "ms", tuple(nav), at_most=NAV_P99_BAR_MS),
        Row("moos", f"notifications to {CLIENTS} clients, of {CROWD_PER_S:g}/s", "1/s", tuple(crowd), at_least=CROWD_BAR),
        Row("moos", f"tick lateness p99 at {RATE_HZ} Hz, no client", "ms", tuple(alone)),
        Row("moos", "tick lateness p99 with these clients", "ms", tuple(late), at_most=LATENESS_BAR_MS),
        Row("moos", "what the clients add to it", "ms", added, at_most=ADDED_LATENESS_BAR_MS),
        Row("moos", "other work on this machine meanwhile (none: idle)", "cores", tuple(busy), note="" if busy else UNKNOWN),
        Row("moos", f"real-time factor at warp {WARP:g}, NAV_* heard", "1", tuple(factors), at_least=0.99 * WARP),
    ]  # fmt: skip


def _serving(speed: float) -> AbstractContextManager[Traced]:
    """Run a server with a vehicle, an embedded MOOSDB and a trace of the ticks, on free loopback ports."""
    return traced_server(_SCENARIO.format(rate=RATE_HZ, speed=speed))


def _their_rates(load: Load, repeats: int, seconds: float) -> tuple[float, ...]:
    """Return doubles per second through a real MOOSDB; nothing if there is no such program."""
    folder = os.environ.get(VARIABLE)
    program = Path(folder).resolve() / "MOOSDB" if folder else None
    if program is None or not program.is_file():
        return ()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [str(program), f"--moos_port={port}", "--moos_community=bench", "--moos_suicide_disable"]
    quiet = subprocess.DEVNULL
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as place:
        with running(command, cwd=place, stdin=quiet, stdout=quiet, stderr=quiet):
            _await_listener(port, " ".join(command))
            return tuple(
                load.ask("flow", address=f"127.0.0.1:{port}", seconds=seconds)["per_s"] for _ in range(repeats)
            )


def _await_listener(port: int, command: str) -> None:
    clock = SystemTime()
    deadline = clock.now_ns() + int(START_TIMEOUT_S * 1e9)
    while clock.now_ns() < deadline:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
        except OSError:
            clock.wait(0.1, Event())
        else:
            return
    raise BenchFailed(f"nothing listens after {START_TIMEOUT_S:g} s of {command}")
