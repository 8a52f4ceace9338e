"""The processes of a benchmark: `uwserver run` on a free port, one process with all clients, and how much of the machine others use."""

from __future__ import annotations

import contextlib
import json
import os
import re
import selectors
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uwserver.simulation.clock import SystemTime

START_TIMEOUT_S, STOP_TIMEOUT_S, ANSWER_TIMEOUT_S = 60.0, 10.0, 60.0

_ADDRESS = re.compile(rb"tcp: (?:tcp://)?([0-9.]+):([0-9]+)\n")


class BenchFailed(Exception):
    """A process did not work as expected; the text says which one, and what it printed."""


@dataclass(frozen=True)
class Served:
    """A running server, with its address and its process id."""

    host: str
    port: int
    pid: int

    def ask(self, request: str) -> Any:
        """Send a JSON-RPC request on a new connection, and return its result.

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
    """Run a scenario on a free loopback port while the context is open.

    Args:
        scenario: name of a shipped scenario, or a file.
        python: program with the uwserver that serves.
        environment: environment of the server.
        place: its working directory; default: that of this process.
        options: further options of `uwserver run`.

    Raises:
        BenchFailed: it did not start.
    """
    command = [python, "-m", "uwserver", "run", str(scenario), "--port", "0", "--log-level", "error", *options]
    with running(command, stdout=subprocess.PIPE, cwd=place, env=dict(environment)) as process:
        yield served_by(process, " ".join(command))


Task = Mapping[str, Any]


def carry_out(
    tasks: Mapping[str, Callable[[Task], Mapping[str, object]]],
    who: str,
    errors: tuple[type[Exception], ...] = (OSError, ValueError),
    lines: Iterable[str] | None = None,
) -> None:
    """Carry out the tasks of a `Load` until stdin ends. This is the main function of its process.

    Args:
        tasks: the functions that carry out tasks and return their results, by name.
        who: name of this process in the result of a task that failed.
        errors: exceptions with which a task fails; others end the process.
        lines: the tasks as JSON, with the name as `task`; default: the lines of stdin.
    """
    for line in sys.stdin if lines is None else lines:
        task = json.loads(line)
        try:
            result = tasks[task["task"]](task)
        except errors as error:
            result = {"failed": f"{who} task {task['task']}: {error}"}
        print(json.dumps(result), flush=True)


class Load:
    """The load process (`uwserver_bench.load`). It gets tasks while it runs, so that its own start is never measured."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def do(self, task: str, served: Served, **arguments: object) -> dict[str, Any]:
        """Let it carry out a task with a server, and return the result.

        Raises:
            BenchFailed: the task failed, or the process ended.
        """
        return self.ask(task, host=served.host, port=served.port, **arguments)

    def ask(self, task: str, **arguments: object) -> dict[str, Any]:
        """Do the same for a task whose arguments contain the address of the server."""
        self.begin(task, **arguments)
        return self.result()

    def begin(self, task: str, **arguments: object) -> None:
        """Start a task without waiting for it."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"task": task, **arguments}).encode() + b"\n")
        self._process.stdin.flush()

    def result(self) -> dict[str, Any]:
        """Wait for the next result, and return it.

        Raises:
            BenchFailed: the task failed, or the process ended.
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
    """Run the load process while the context is open. `module` carries out its tasks."""
    with running([sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield Load(process)


@contextlib.contextmanager
def running(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process while the context is open. Options are those of `subprocess.Popen`."""
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            stop(process)


@contextlib.contextmanager
def scenario_file(text: str) -> Iterator[Path]:
    """Write a scenario to a file of its own folder, which is removed when the context is closed."""
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as folder:
        file = Path(folder, "bench.toml")
        file.write_text(text, encoding="utf-8")
        yield file


def served_by(process: subprocess.Popen[bytes], command: str) -> Served:
    """Wait until a process has printed the address of its server.

    Raises:
        BenchFailed: it named no address.
    """
    assert process.stdout is not None
    clock, seen, stdout = SystemTime(), b"", process.stdout
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
                return Served(found[1].decode(), int(found[2]), process.pid)
    raise BenchFailed(f"{command} named no address; it printed: {seen.decode(errors='replace') or 'nothing'}")


def processor_s(pid: int) -> float | None:
    """Return the processor time that the threads of a process have used, s; None if the system does not tell."""
    try:
        # In ns. /proc/<pid>/stat counts hundredths of a second, which is more than a client costs in a second.
        spent = [int(thread.read_text().split()[0]) for thread in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    except (OSError, ValueError):
        return None
    return sum(spent) * 1e-9 if spent else None


def resident_mb(pid: int) -> float | None:
    """Return the resident memory of a process, MB; None if the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    found = re.search(r"^VmRSS:\s+(\d+) kB", text, re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else None


def stop(process: subprocess.Popen[bytes]) -> None:
    """Stop a process, by force if it does not end by itself."""
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class Bystanders:
    """The processor time of all processes but one, since this object was made."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._clock = SystemTime()
        self._start_ns = self._clock.now_ns()
        self._start = _others_s(pid)

    def cores(self) -> float | None:
        """Return the mean number of cores that other processes used since then; None if the system does not tell."""
        now = _others_s(self._pid)
        if now is None or self._start is None:
            return None
        return max(0.0, (now - self._start) / ((self._clock.now_ns() - self._start_ns) * 1e-9))


def _others_s(pid: int) -> float | None:
    """Return the processor time of all processes but `pid` since boot, s."""
    try:
        user, nice, system, _, _, irq, softirq, *_ = map(int, Path("/proc/stat").read_text().split()[1:9])
        own = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (OSError, ValueError):
        return None
    total = user + nice + system + irq + softirq
    return (total - int(own[11]) - int(own[12])) / os.sysconf("SC_CLK_TCK")
