"""A server in its own process, with clients over loopback: how late its ticks are with and without clients, how soon it answers, and how soon after
its start it serves.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Event

from uwserver.simulation.clock import SystemTime
from uwserver.world.warm import warm
from uwserver_bench.load import SUBSCRIBE
from uwserver_bench.processes import BenchFailed, Bystanders, Load, Served, loading, resident_mb, scenario_file, serving
from uwserver_bench.report import Row

RATE_HZ = 250
ACTIVE, SILENT, CONNECTIONS = 10, 10, 10

LATENESS_BAR_MS, ADDED_LATENESS_BAR_MS = 1.0, 0.3
READING_P99_BAR_MS, READING_RATE_BAR = 2.0, 10_000.0
FREE_RUNNING_SUBSCRIBERS = 8
FREE_RUNNING_PING_BAR_MS = 50.0
CHANGING_P99_BAR_MS = 1000.0 / RATE_HZ + 2.0

UNKNOWN = "not measured: this system has no /proc"

_TRIES = 50

VEHICLE = f"""\
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 20.0]

# The rates of the vehicle file divide 240 Hz. These are the nearest rates that divide {RATE_HZ} Hz.
[vehicles.rov.override.sensors]
imu = {{ rate_hz = 125.0 }}
pressure = {{ rate_hz = 50.0 }}
depth = {{ rate_hz = 50.0 }}
"""
"""A vehicle in a world of `RATE_HZ`."""
SCENARIO = f"""\
schema = 1
title = "bench"

[world]
rate_hz = {RATE_HZ}

[server]
metrics = false

{VEHICLE}
[adapters.tcp]
kind = "sockets"
port = 0
"""

STATUS = '{"jsonrpc":"2.0","id":1,"method":"call","params":{"service":"world/status"}}'
COMMAND = (
    '{"jsonrpc":"2.0","id":1,"method":"command","params":{"port":"rov/thrusters",'
    '"value":{"u":[0.1,0.1,-0.1,-0.1,0.2,0.2,0.2,0.2]}}}'
)
READING = {"ping": '{"jsonrpc":"2.0","id":1,"method":"ping","params":{}}', "world/status": STATUS}
CHANGING = {
    "command": COMMAND,
    "call rov/imu/get": '{"jsonrpc":"2.0","id":1,"method":"call","params":{"service":"rov/imu/get"}}',
}
DEFAULT_SCENARIO = "bluerov2_pool"
START_BAR_S, IMPORT_BAR_S, MEMORY_BAR_MB = 3.0, 0.03, 280.0
_SETTLE_S = 3.0
_SAMPLE_TIMEOUT_S = 30.0


def bench_server(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on the server.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    say("server: warming the kernel cache")
    warm()
    with scenario_file(SCENARIO) as scenario, loading() as load:
        pairs, seconds = (1, 0.5) if quick else (5, 4.0)
        rows = _lateness(scenario, load, pairs, seconds, say)
        repeats, seconds = (1, 0.2) if quick else (5, 1.0)
        rows += _answers(scenario, load, repeats, seconds, say)
        repeats, seconds = (1, 1.0) if quick else (3, 8.0)
        return rows + _free_running(load, repeats, seconds, say)


# -- lateness -----------------------------------------------------------------------------------------------------------------------


def _lateness(scenario: Path, load: Load, pairs: int, seconds: float, say: Callable[[str], None]) -> list[Row]:
    """Measure the lateness of ticks, alternately with and without clients. Each phase has a new server, so that phases do not mix."""
    without: list[float] = []
    crowded: list[float] = []
    busy: list[float] = []
    results = []
    for pair in range(pairs):
        say(f"server: lateness with and without clients, pair {pair + 1} of {pairs}")
        with serving(scenario) as served:
            bystanders = Bystanders(served.pid)
            SystemTime().wait(seconds, Event())
            without.append(lateness_p99_ms(served))
            busy += [cores] if (cores := bystanders.cores()) is not None else []
        with serving(scenario) as served:
            crowd = load.do("clients", served, active=ACTIVE, silent=SILENT, seconds=seconds, request=COMMAND)
            results.append(crowd)
            crowded.append(lateness_p99_ms(served))
    added = tuple(there - alone for there, alone in zip(crowded, without, strict=True))
    who = f"{ACTIVE} active clients, {SILENT} that never read"
    return [
        Row("server", f"tick lateness p99 at {RATE_HZ} Hz, no client", "ms", tuple(without)),
        Row("server", f"tick lateness p99 at {RATE_HZ} Hz, {who}", "ms", tuple(crowded), at_most=LATENESS_BAR_MS),
        Row("server", "what the clients add to it", "ms", added, at_most=ADDED_LATENESS_BAR_MS),
        Row(
            "server",
            "other work on this machine meanwhile (none: idle)",
            "cores",
            tuple(busy),
            note="" if busy else UNKNOWN,
        ),
        Row("server", f"samples received by the {ACTIVE}", "1/s", tuple(r["samples_per_s"] for r in results)),
        Row("server", f"their commands, {ACTIVE} x 50 Hz", "1/s", tuple(r["commands_per_s"] for r in results)),
    ]


def lateness_p99_ms(served: Served) -> float:
    """Return the p99 of the lateness of all ticks since the start of the server, ms."""
    for _ in range(_TRIES):
        lateness = served.ask(STATUS)["value"]["lateness"]
        if lateness.get("p99_s"):
            return float(lateness["p99_s"]) * 1e3
        SystemTime().wait(0.1, Event())
    raise BenchFailed('"world/status" tells no lateness: the server does not run in real time')


# -- answers ------------------------------------------------------------------------------------------------------------------------


def _answers(scenario: Path, load: Load, repeats: int, seconds: float, say: Callable[[str], None]) -> list[Row]:
    """Measure ten connections with one open request each; all kinds of requests in turn on one server."""
    requests = {**READING, **CHANGING}
    rates: dict[str, list[float]] = {name: [] for name in requests}
    late: dict[str, list[float]] = {name: [] for name in requests}
    with serving(scenario) as served:
        for repeat in range(repeats):
            say(f"server: answers, repeat {repeat + 1} of {repeats}")
            for name, request in requests.items():
                result = load.do("calls", served, connections=CONNECTIONS, seconds=seconds, request=request)
                rates[name].append(result["per_s"])
                late[name].append(result["p99_s"] * 1e3)
    rows = []
    for name in READING:
        title = f"{name}, {CONNECTIONS} connections"
        rows.append(Row("server", f"{title}: rate", "1/s", tuple(rates[name]), at_least=READING_RATE_BAR))
        rows.append(Row("server", f"{title}: p99", "ms", tuple(late[name]), at_most=READING_P99_BAR_MS))
    for name in CHANGING:
        title = f"{name}, {CONNECTIONS} connections"
        rows.append(Row("server", f"{title}: rate", "1/s", tuple(rates[name])))
        rows.append(Row("server", f"{title}: p99", "ms", tuple(late[name]), at_most=CHANGING_P99_BAR_MS))
    return rows


# -- free-running -------------------------------------------------------------------------------------------------------------------


def _free_running(load: Load, repeats: int, seconds: float, say: Callable[[str], None]) -> list[Row]:
    """Measure a free-running world, which only waits for the loop that delivers its samples: its speed, and how soon the loop answers meanwhile."""
    late: list[float] = []
    alone: list[float] = []
    crowded: list[float] = []
    for repeat in range(repeats):
        say(f"server: free-running, repeat {repeat + 1} of {repeats}")
        with serving("one_of_everything", options=("--mode", "freerun")) as served, loading() as crowd:
            before = _now(served)
            SystemTime().wait(seconds, Event())
            alone.append(_ticks_per_s(before, _now(served)))
            task = {"host": served.host, "port": served.port, "active": FREE_RUNNING_SUBSCRIBERS, "silent": 0}
            crowd.begin("clients", **task, request=READING["ping"], seconds=seconds + 2.0)
            SystemTime().wait(1.0, Event())
            before = _now(served)
            pings = load.do("calls", served, connections=1, seconds=seconds, request=READING["ping"])
            crowded.append(_ticks_per_s(before, _now(served)))
            late.append(pings["p99_s"] * 1e3)
            crowd.result()
    who = f"{FREE_RUNNING_SUBSCRIBERS} subscribers to everything"
    return [
        Row("server", f"one_of_everything, free-running, {who}: ping p99", "ms", tuple(late), at_most=FREE_RUNNING_PING_BAR_MS),
        Row("server", f"one_of_everything, free-running, {who}", "ticks/s", tuple(crowded)),
        Row("server", "one_of_everything, free-running, no subscriber", "ticks/s", tuple(alone)),
    ]  # fmt: skip


def _now(served: Served) -> tuple[int, int]:
    """Return wall time (ns) and the present tick of the server."""
    return SystemTime().now_ns(), int(served.ask(STATUS)["tick"])


def _ticks_per_s(before: tuple[int, int], after: tuple[int, int]) -> float:
    return (after[1] - before[1]) / ((after[0] - before[0]) * 1e-9)


def bench_start(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on the start.

    Args:
        quick: one repeat, and no wait before the memory is measured.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    repeats = 1 if quick else 3
    say("start: a first run warms the kernel cache and the files")
    _start(0.0)
    started: list[float] = []
    memory: list[float] = []
    imported: list[float] = []
    for repeat in range(repeats):
        say(f"start: repeat {repeat + 1} of {repeats}")
        seconds, resident = _start(0.2 if quick else _SETTLE_S)
        started.append(seconds)
        memory += [] if resident is None else [resident]
        imported.append(import_s(sys.executable, os.environ))
    return [
        Row("start", "`uwserver run` to the first sample at a client", "s", tuple(started), at_most=START_BAR_S),
        Row("start", "`import uwserver`, beyond the bare interpreter", "s", tuple(imported), at_most=IMPORT_BAR_S),
        Row(
            "start", "memory of the default server with a client", "MB", tuple(memory), at_most=MEMORY_BAR_MB,
            note="" if memory else "not measured: this system has no /proc",
        ),
    ]  # fmt: skip


def first_sample(served: Served) -> None:
    """Subscribe to everything, and wait for the first sample.

    Raises:
        BenchFailed: no sample came.
    """
    with socket.create_connection((served.host, served.port), timeout=_SAMPLE_TIMEOUT_S) as connection:
        connection.sendall(SUBSCRIBE)
        with connection.makefile("rb") as lines:
            if not any(b'"method":"sample"' in line for line in lines):
                raise BenchFailed("the server closed the connection before its first sample")


def import_s(python: str, environment: Mapping[str, str], place: Path | None = None) -> float:
    """Return the processor time of `import uwserver` in a new process, without that of the start of Python, s."""
    code = "import time; start = time.process_time_ns(); import uwserver; print(time.process_time_ns() - start)"
    done = subprocess.run([python, "-c", code], check=True, stdout=subprocess.PIPE, cwd=place, env=dict(environment))
    return int(done.stdout) * 1e-9


def _start(settle_s: float) -> tuple[float, float | None]:
    """Return the time from the start of the process to the first received sample (s), and the resident memory `settle_s` later (MB)."""
    clock = SystemTime()
    begin = clock.now_ns()
    with serving(DEFAULT_SCENARIO) as served:
        first_sample(served)
        seconds = (clock.now_ns() - begin) * 1e-9
        clock.wait(settle_s, Event())
        return seconds, resident_mb(served.pid)
