"""How soon a server is ready, and how much memory it takes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Event

from uwserver.simulation.clock import SystemTime
from uwserver_bench.load import SUBSCRIBE
from uwserver_bench.processes import BenchFailed, Served, resident_mb, serving
from uwserver_bench.report import Row

DEFAULT_SCENARIO = "bluerov2_pool"
START_BAR_S, IMPORT_BAR_S, MEMORY_BAR_MB = 3.0, 0.03, 250.0
_SETTLE_S = 3.0
_SAMPLE_TIMEOUT_S = 30.0


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
