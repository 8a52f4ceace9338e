"""SIGTERM ends a server within two seconds of its processor time in every phase of its life, and what it records is complete."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import uwclient

from uwserver.recording.replay import replay

MOST_CPU_S = 2.0
PATIENCE_S = 120
COMMAND = [sys.executable, "-m", "uwserver", "run"]
KILLED = -signal.SIGTERM


def also(*values: object) -> list[object]:
    """Other moments of the same phase, for `make test-all`."""
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Life:
    """A server from its first instruction to its end."""

    def __init__(self, *args: str, before: tuple[str, ...] = (), env: dict[str, str] | None = None) -> None:
        self.process = subprocess.Popen(
            [*before, *COMMAND, *args], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | (env or {})
        )  # fmt: skip
        self.said: list[str] = []
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._news:
                self.said.append(line)
                self._news.notify()

    def wait_for(self, word: str) -> str:
        """The first line that has it."""
        with self._news:
            assert self._news.wait_for(lambda: any(word in line for line in self.said), PATIENCE_S), self.said
            return next(line for line in self.said if word in line)

    @property
    def port(self) -> int:
        return int(self.wait_for("  tcp: ").rpartition(":")[2])

    def work(self, pid: int, seconds: float) -> None:
        """Wait until a process has had this much processor time."""
        end = time.monotonic() + PATIENCE_S
        while self._reader.is_alive() and cpu_s(pid) < seconds:
            assert time.monotonic() < end
            time.sleep(0.005)

    def compile(self, pid: int) -> None:
        """Wait until kernels are being compiled for a process, by processes of its own."""
        self.wait_for("compiling")
        children = Path(f"/proc/{pid}/task/{pid}/children")
        while not (workers := children.read_text().split()):
            time.sleep(0.005)
        self.work(int(workers[0]), 0.5)

    def end(self) -> tuple[int, float]:
        """Its exit status, and the processor time from SIGTERM to the end."""
        before = cpu_s(self.process.pid)
        os.kill(self.process.pid, signal.SIGTERM)
        return self._ended(before)

    def _ended(self, before: float) -> tuple[int, float]:
        watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        watchdog.start()
        _, status, usage = os.wait4(self.process.pid, 0)
        watchdog.cancel()
        self.process.returncode = os.waitstatus_to_exitcode(status)
        self._reader.join()
        return self.process.returncode, usage.ru_utime + usage.ru_stime - before


@contextlib.contextmanager
def life(*args: str, **keys: object) -> Iterator[Life]:
    lived = Life(*args, "--port", "0", **keys)  # type: ignore[arg-type]
    try:
        yield lived
    finally:
        if lived.process.returncode is None:
            lived.process.kill()
            lived._ended(0.0)
        assert lived.process.stdout is not None
        lived.process.stdout.close()


@pytest.mark.parametrize("at_s", [0.2, 0.9, *also(0.03, 0.5)])
def test_before_it_serves_it_ends_at_once(at_s: float) -> None:
    """Nothing is recorded or served yet, so the signal itself ends it."""
    with life("one_of_everything") as lived:
        lived.work(lived.process.pid, at_s)
        status, cpu = lived.end()
    assert status == KILLED
    assert cpu < MOST_CPU_S


def test_while_kernels_are_compiled(tmp_path: Path) -> None:
    env = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    with life("bluerov2_pool", env=env) as lived:
        lived.compile(lived.process.pid)
        status, cpu = lived.end()
    assert (status, "Ctrl-C" in lived.said[-1]) == (KILLED, False)
    assert cpu < MOST_CPU_S


def with_a_seabed(folder: Path) -> Path:
    """A scenario whose seabed has 1.7 million points: four seconds of work before it serves."""
    x = np.arange(1300.0)
    np.save(folder / "bed.npy", 20.0 + np.sin(x[:, None] / 9.0) + np.cos(x[None] / 7.0))
    file = folder / "it.toml"
    file.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\n[adapters.tcp]\nkind = "sockets"\n'
        '[seabed]\nkind = "grid"\nfile = "bed.npy"\nspacing_m = [1.0, 1.0]\n'
    )
    return file


@pytest.mark.parametrize("at_s", [1.7, *also(1.0, 2.4, 3.1)])
def test_while_a_large_seabed_is_loaded(at_s: float, tmp_path: Path) -> None:
    with life(str(with_a_seabed(tmp_path))) as lived:
        lived.work(lived.process.pid, at_s)
        status, cpu = lived.end()
    assert (status, lived.said) == (KILLED, [])
    assert cpu < MOST_CPU_S


def with_a_mesh(folder: Path) -> Path:
    """A scenario with a structure of a million triangles, some 50 MB: more than five seconds of work before it serves."""
    n = 708
    corner = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("of", "<u2")])
    north, east = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    points = np.stack([north, east, -20.0 + np.sin(north / 9.0) * np.cos(east / 7.0)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.zeros(2 * n * n, corner)
    triangles["corners"] = np.stack([np.stack([a, b, d], axis=2), np.stack([b, c, d], axis=2)], axis=2).reshape(
        -1, 3, 3
    )
    (folder / "rock.stl").write_bytes(bytes(80) + len(triangles).to_bytes(4, "little") + triangles.tobytes())
    file = folder / "it.toml"
    file.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\n[adapters.tcp]\nkind = "sockets"\n'
        '[structures.rock]\nkind = "mesh"\nfile = "rock.stl"\n'
    )
    return file


@pytest.mark.parametrize("at_s", [1.5, *also(2.5, 3.5)])
def test_while_a_large_mesh_is_loaded(at_s: float, tmp_path: Path) -> None:
    with life(str(with_a_mesh(tmp_path))) as lived:
        lived.work(lived.process.pid, at_s)
        status, cpu = lived.end()
    assert (status, lived.said) == (KILLED, [])
    assert cpu < MOST_CPU_S


@pytest.mark.parametrize("phase", ["imports", *also("compilation", "seabed", "serving")])
def test_as_the_first_process_of_a_container(phase: str, tmp_path: Path) -> None:
    """Which no signal ends that it does not handle: who handles it during the imports does so in all that follows."""
    new = ("unshare", "--pid", "--fork", "--kill-child")
    if shutil.which(new[0]) is None or subprocess.run([*new, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no process namespaces here")
    env = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""} if phase == "compilation" else {}
    scenario = str(with_a_seabed(tmp_path)) if phase == "seabed" else "bluerov2_pool"
    with life(scenario, before=new, env=env) as lived:
        children = Path(f"/proc/{lived.process.pid}/task/{lived.process.pid}/children")
        while (
            not (first := children.read_text().split())
            or b"uwserver" not in Path(f"/proc/{first[0]}/cmdline").read_bytes()
        ):
            time.sleep(0.005)
        pid = int(first[0])
        if phase == "imports":
            lived.work(pid, 0.3)
        elif phase == "seabed":
            lived.work(pid, 2.0)
        elif phase == "compilation":
            lived.compile(pid)
        else:
            lived.wait_for("Ctrl-C")
        before = cpu_s(pid)
        os.kill(pid, signal.SIGTERM)
        status, cpu = lived._ended(before)
    assert status == (0 if phase == "serving" else 128 + signal.SIGTERM)
    assert cpu < MOST_CPU_S


def test_while_an_adapter_waits_for_something_outside(tmp_path: Path) -> None:
    file = tmp_path / "it.toml"
    file.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\n[adapters.tcp]\nkind = "sockets"\n'
        '[adapters.bus]\nkind = "moos"\n[adapters.bus.communities.a]\nport = 9\nvehicle = "rov"\n'
    )
    with life(str(file), "--record", str(tmp_path / "run.mcap")) as lived:
        lived.wait_for("recording to")
        status, cpu = lived.end()
    assert status == 0
    assert cpu < MOST_CPU_S
    done = replay(tmp_path / "run.mcap")
    assert (done.truncated, done.difference) == (False, None)


@pytest.mark.parametrize("twice", [True, *also(False)])
def test_in_free_run_with_subscribers_a_recording_and_calls_under_way(twice: bool, tmp_path: Path) -> None:
    """The recording is whole: its last entry is the state at the end, and it replays."""
    path = tmp_path / "run.mcap"
    with contextlib.ExitStack() as stack:
        lived = stack.enter_context(life("bluerov2_pool", "--mode", "freerun", "--record", str(path)))
        clients = [stack.enter_context(uwclient.connect("127.0.0.1", lived.port, reconnect=False, timeout=PATIENCE_S)) for _ in range(8)]  # fmt: skip
        for client in clients:
            client.subscribe("**")
        clients[0].call("world/snapshot", name="a")
        callers = [threading.Thread(target=call_on, args=(client,)) for client in clients[:3]]
        for caller in callers:
            caller.start()
        lived.work(lived.process.pid, cpu_s(lived.process.pid) + 0.5)
        if twice:  # a supervisor signals both the process and its group
            os.kill(lived.process.pid, signal.SIGTERM)
        status, cpu = lived.end()
        for caller in callers:
            caller.join()
    assert status == 0, lived.said
    assert cpu < MOST_CPU_S
    done = replay(path)
    assert (done.truncated, done.difference) == (False, None)
    assert done.requests > 0


def test_a_signal_in_the_last_moments_does_not_make_a_whole_run_look_killed(tmp_path: Path) -> None:
    """Python takes its handlers away before it ends: for a second of two signals there was none."""
    (tmp_path / "sitecustomize.py").write_text(
        "import atexit, os, signal\natexit.register(lambda: [os.kill(os.getpid(), n) for n in (signal.SIGTERM, signal.SIGINT)])\n"
    )
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    with life("bluerov2_pool", "--mode", "freerun", "--until", "0.1", env={"PYTHONPATH": path}) as lived:
        status, _ = lived._ended(0.0)
    assert status == 0, lived.said


def call_on(client: uwclient.Client) -> None:
    """Snapshots and restores until the server is gone."""
    with contextlib.suppress(uwclient.UwError, OSError):
        while True:
            client.call("world/snapshot", name="a")
            client.call("world/reset")
            client.call("world/restore", name="a")


def test_in_free_run_with_thousands_of_requests_that_rebuild_the_world(tmp_path: Path) -> None:
    """Each takes milliseconds, and free-run would carry out all that wait in one tick."""
    path = tmp_path / "run.mcap"
    with contextlib.ExitStack() as stack:
        lived = stack.enter_context(life("pool_inspection", "--mode", "freerun", "--record", str(path)))
        peers = [stack.enter_context(socket.create_connection(("127.0.0.1", lived.port))) for _ in range(4)]
        began = cpu_s(lived.process.pid)
        for n, peer in enumerate(peers):
            spawn = {"name": f"guest{n}", "like": "bluerov2", "p_NB": [2.0, 1.0, 1.0]}
            calls = [("world/spawn", spawn), ("world/remove", {"name": f"guest{n}"})] * 500
            params = [{"service": service, "args": args} for service, args in calls]
            lines = [{"jsonrpc": "2.0", "id": k, "method": "call", "params": each} for k, each in enumerate(params)]
            peer.sendall("".join(json.dumps(line) + "\n" for line in lines).encode())
        lived.work(lived.process.pid, began + 0.5)
        status, cpu = lived.end()
    assert status == 0, lived.said
    assert cpu < MOST_CPU_S
    done = replay(path)
    assert (done.truncated, done.difference) == (False, None)
    assert 0 < done.requests < 4000


def test_a_disk_that_fills_ends_the_recording_and_the_exit_status_tells(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with contextlib.ExitStack() as stack:
        lived = stack.enter_context(life("bluerov2_pool", "--mode", "freerun", "--record", str(path)))
        client = stack.enter_context(uwclient.connect("127.0.0.1", lived.port, reconnect=False, timeout=PATIENCE_S))
        # Only now: a cache of kernels is larger.
        resource.prlimit(lived.process.pid, resource.RLIMIT_FSIZE, (400_000, 400_000))
        lived.wait_for("File too large; the world continues without it")
        tick = client.call("world/status")["tick"]
        # Two requests may be answered between the same two ticks.
        lived.work(lived.process.pid, cpu_s(lived.process.pid) + 0.2)
        status = client.call("world/status")
        assert status["tick"] > tick
        assert (status["recorder"]["recording"], status["recorder"]["error"]) == (False, "File too large")
        ended, _ = lived.end()
    assert ended == 1
    assert sum("the world continues" in line for line in lived.said) == 1
    done = replay(path)
    assert (done.truncated, done.difference) == (True, None)
    assert done.hashes > 0


def test_a_server_without_descriptors_goes_on_and_says_what_it_cannot_do(tmp_path: Path) -> None:
    few = ("prlimit", "--nofile=24")
    if shutil.which(few[0]) is None:
        pytest.skip("no prlimit here")
    file = tmp_path / "it.toml"
    file.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\n[server]\nstate_folder = "states"\nmetrics = false\n'
        '[adapters.tcp]\nkind = "sockets"\nbind = "127.0.0.1"\n'
    )
    with contextlib.ExitStack() as stack:
        lived = stack.enter_context(life(str(file), before=few))
        client = stack.enter_context(uwclient.connect("127.0.0.1", lived.port, reconnect=False, timeout=PATIENCE_S))
        with contextlib.ExitStack() as crowd:
            for _ in range(30):
                crowd.enter_context(socket.create_connection(("127.0.0.1", lived.port), timeout=PATIENCE_S))
            lived.wait_for("descriptors")
            tick = client.call("world/status")["tick"]
            with pytest.raises(uwclient.CallRefused, match="Too many open files"):
                client.call("world/save", name="a")
            assert client.call("world/status")["tick"] > tick
        deadline = time.monotonic() + PATIENCE_S
        while True:
            with contextlib.suppress(uwclient.CallRefused):
                assert client.call("world/save", name="a")["bytes"] > 0
                break
            assert time.monotonic() < deadline
        status, cpu = lived.end()
    assert status == 0
    assert cpu < MOST_CPU_S
