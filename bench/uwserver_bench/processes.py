"""Processes of a bench: `uwserver run` on a free port, and the one process that plays all clients."""

from __future__ import annotations

import contextlib
import json
import os
import re
import selectors
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from uwserver.simulation.clock import SystemTime

START_TIMEOUT_S, STOP_TIMEOUT_S, ANSWER_TIMEOUT_S = 60.0, 10.0, 60.0

_ADDRESS = re.compile(rb"tcp: (?:tcp://)?([0-9.]+):([0-9]+)\n")


class BenchFailed(Exception):
    """A process did not do its part; the text says which and what it printed."""


@dataclass(frozen=True)
class Served:
    """A running server: where it listens, and its process id."""

    host: str
    port: int
    pid: int

    def ask(self, request: str) -> Any:
        """One JSON-RPC request on a connection of its own; returns its result.

        Raises:
            BenchFailed: the server refused it.
        """
        with socket.create_connection((self.host, self.port), timeout=ANSWER_TIMEOUT_S) as connection:
            connection.sendall(request.encode() + b"\n")
            with connection.makefile("rb") as lines:
                for line in lines:
                    message = json.loads(line)
                    if "result" in message:
                        return message["result"]
                    if "error" in message:
                        raise BenchFailed(f"the server refused {request}: {message['error']['message']}")
        raise BenchFailed(f"the server closed the connection after {request}")


@contextlib.contextmanager
def serving(
    scenario: str | Path,
    python: str = sys.executable,
    environment: Mapping[str, str] = os.environ,
    place: Path | None = None,
    options: Sequence[str] = (),
) -> Iterator[Served]:
    """Run a scenario on a free loopback port for as long as the context is open.

    Args:
        scenario: a shipped name or a file.
        python: whose uwserver serves.
        environment: of the server.
        place: folder that it works in; default: this process's.
        options: further ones of `uwserver run`.

    Raises:
        BenchFailed: it did not come up.
    """
    command = [python, "-m", "uwserver", "run", str(scenario), "--port", "0", "--log-level", "error", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=place, env=dict(environment)) as process:
        try:
            assert process.stdout is not None
            host, port = _address(process.stdout, " ".join(command))
            yield Served(host, port, process.pid)
        finally:
            stop(process)


Task = Mapping[str, Any]


def carry_out(
    tasks: Mapping[str, Callable[[Task], Mapping[str, object]]],
    who: str,
    errors: tuple[type[Exception], ...] = (OSError, ValueError),
    lines: Iterable[str] | None = None,
) -> None:
    """Be the process of a `Load`: carry out its tasks until stdin ends.

    Args:
        tasks: by name, what each does, and returns as its result.
        who: this process is called in the result of a task that failed.
        errors: by which a task fails; others end the process.
        lines: the tasks, JSON with the name as `task`; default: of stdin.
    """
    for line in sys.stdin if lines is None else lines:
        task = json.loads(line)
        try:
            result = tasks[task["task"]](task)
        except errors as error:
            result = {"failed": f"{who} task {task['task']}: {error}"}
        print(json.dumps(result), flush=True)


class Load:
    """The load process (`uwserver_bench.load`): told what to do a line at a time, so that its own start is never measured."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def do(self, task: str, served: Served, **arguments: object) -> dict[str, Any]:
        """Let it carry out a task against a server, and wait for the result.

        Raises:
            BenchFailed: it broke off.
        """
        return self.ask(task, host=served.host, port=served.port, **arguments)

    def ask(self, task: str, **arguments: object) -> dict[str, Any]:
        """As `do`, for a task that is told by its arguments where the server is."""
        self.begin(task, **arguments)
        return self.result()

    def begin(self, task: str, **arguments: object) -> None:
        """Start a task without waiting for it."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"task": task, **arguments}).encode() + b"\n")
        self._process.stdin.flush()

    def result(self) -> dict[str, Any]:
        """Wait for what it says next.

        Raises:
            BenchFailed: it broke off.
        """
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise BenchFailed("the load process ended: see its message above")
        answer: dict[str, Any] = json.loads(line)
        if "failed" in answer:
            raise BenchFailed(str(answer["failed"]))
        return answer


@contextlib.contextmanager
def loading(module: str = "uwserver_bench.load") -> Iterator[Load]:
    """The load process, for as long as the context is open; `module` carries out its tasks."""
    command = [sys.executable, "-m", module]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            yield Load(process)
        finally:
            stop(process)


def _address(stdout: IO[bytes], command: str) -> tuple[str, int]:
    """Where the server says that it listens."""
    clock, seen = SystemTime(), b""
    deadline = clock.now_ns() + int(START_TIMEOUT_S * 1e9)
    with selectors.DefaultSelector() as selector:
        selector.register(stdout, selectors.EVENT_READ)
        while clock.now_ns() < deadline:
            if not selector.select(timeout=1.0):
                continue
            chunk = os.read(stdout.fileno(), 4096)
            if not chunk:
                break
            seen += chunk
            if found := _ADDRESS.search(seen):
                return found[1].decode(), int(found[2])
    raise BenchFailed(f"{command} named no address; it printed: {seen.decode(errors='replace') or 'nothing'}")


def processor_s(pid: int) -> float | None:
    """Processor time that the threads of a process have used; None where the system does not tell."""
    try:
        # In ns; /proc/<pid>/stat counts hundredths of a second, more than a client costs in one.
        spent = [int(thread.read_text().split()[0]) for thread in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    except (OSError, ValueError):
        return None
    return sum(spent) * 1e-9 if spent else None


def resident_mb(pid: int) -> float | None:
    """Memory of a process that is in use; None where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    found = re.search(r"^VmRSS:\s+(\d+) kB", text, re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else None


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a process, in order if it can."""
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
