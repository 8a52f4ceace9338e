"""Processes of ours that begin warm: forks of one that has imported what they need and loaded the kernels, which takes it seconds.

For tests whose subject is not how a process begins. `Warm` is a `subprocess.Popen` of `[sys.executable, "-m", "uwserver", ...]`, of "uwclient" or
of `[sys.executable, "-c", ...]`; `command` writes a program that does the same, for shells. Where something of the environment must be known
before the imports, or the system has no such forks, they are ordinary processes.

Run as a program this file is the process that is forked; it ends with its standard input.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from typing import Any, NoReturn

KNOWN_EARLY = ("PYTHON", "NUMBA", "XDG_CACHE", "OMP", "OPENBLAS", "LC_", "LANG", "HOME")
"""Beginnings of names of variables that count when Python and its modules are loaded."""
MOST_BYTES = 1 << 20
WARMING = ("rov_autopilot", "push_the_crate", "remus_survey")
COMMAND = """#!{python} -IS
import json, os, signal, socket, sys
line = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
line.connect({door!r})
told = {{"words": ["-m", {module!r}, *sys.argv[1:]], "folder": os.getcwd(), "environment": dict(os.environ)}}
socket.send_fds(line, [json.dumps(told).encode()], [0, 1, 2])
pid = json.loads(line.recv({most}))["pid"]
for number in signal.SIGINT, signal.SIGTERM:
    signal.signal(number, lambda number, frame: os.kill(pid, number))
code = os.waitstatus_to_exitcode(json.loads(line.recv({most}))["status"])
sys.exit(code if code >= 0 else 128 - code)
"""

# -- the process that is forked --------------------------------------------------------------------------------------------------------


def serve(path: str) -> list[str]:
    """Fork for each who connects, and tell him how his process ended. Comes back in the forks, with what they are asked to run."""
    children: dict[int, socket.socket] = {}
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who runs the tests
    signal.set_wakeup_fd(writer)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
        listener.listen(64)
        os.write(1, b".")  # it is warm
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        while True:
            ready, _, _ = select.select([listener, reader, 0], [], [])
            if 0 in ready:
                os._exit(0)
            if reader in ready:
                os.read(reader, 4096)
                tell_of_ended(children)
            if listener not in ready:
                continue
            peer, _ = listener.accept()
            told, files, _, _ = socket.recv_fds(peer, MOST_BYTES, 3)
            pid = os.fork()
            if pid == 0:
                for each in (peer, *children.values()):
                    each.close()
                os.close(reader)
                signal.set_wakeup_fd(-1)
                os.close(writer)
                break
            children[pid] = peer
            for file in files:
                os.close(file)
            peer.send(json.dumps({"pid": pid}).encode())
    return become(json.loads(told), files)


def tell_of_ended(children: dict[int, socket.socket]) -> None:
    while children:
        pid, status, usage = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            return
        with children.pop(pid) as peer:
            try:
                peer.send(json.dumps({"status": status, "used_s": usage.ru_utime + usage.ru_stime}).encode())
            except OSError:
                continue  # nobody waits for it any more


def become(told: dict[str, Any], files: list[int]) -> list[str]:
    """Take over the files, the folder, the environment and the signals that were asked for."""
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(told["folder"])
    os.environ.clear()
    os.environ.update(told["environment"])
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    words: list[str] = told["words"]
    return words


def warm() -> None:
    """Import and load what most commands need, and leave no thread behind."""
    import uwclient.cli_verbs  # noqa: F401

    import uwserver
    import uwserver.cli.pace
    import uwserver.cli.run
    import uwserver.cli.scenario
    import uwserver.cli.vehicle_parts
    import uwserver.environment.acoustics.fan
    import uwserver.environment.acoustics.layers
    import uwserver.environment.acoustics.search
    import uwserver.scenario.builder
    import uwserver.server.life_cycle

    uwserver.load("one_of_everything")
    for name in WARMING:
        world = uwserver.load(name)
        world.step(300)
        world.end("warm")
    gc.collect()
    gc.freeze()


def run(words: list[str]) -> None:
    """As `python ...` does."""
    if words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = ["-c", *words[2:]]
        sys.path[0] = ""
        exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})


def run_to_the_end(words: list[str]) -> NoReturn:
    """As Python ends a program, but for what libraries in C do then: some do not bear to have been forked."""
    code: object = 0
    try:
        run(words)
    except SystemExit as end:
        code = end.code or 0
        if not isinstance(code, int):
            print(code, file=sys.stderr)
    except BaseException:  # noqa: BLE001
        code = 1
        traceback.print_exc()
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code & 255 if isinstance(code, int) else 1)


# -- who asks for forks ----------------------------------------------------------------------------------------------------------------


@functools.cache
def nursery() -> str:
    """Where the process listens that is forked; "" where there is none."""
    if sys.platform != "linux":
        return ""
    folder = tempfile.TemporaryDirectory(prefix="nursery")
    path = f"{folder.name}/door"
    process = subprocess.Popen([sys.executable, __file__, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdout.read(1)
    process.stdout.close()

    def end() -> None:
        process.communicate()
        folder.cleanup()

    atexit.register(end)
    return path


def command(file: Path, module: str) -> None:
    """Write a program that runs a module as `python -m` does, in a fork."""
    file.write_text(COMMAND.format(python=sys.executable, door=nursery(), module=module, most=MOST_BYTES))
    file.chmod(0o755)


used_s = 0.0
"""Processor time of the forks that have ended: the system counts it to the one that was forked, until that ends."""


class Warm(subprocess.Popen[Any]):
    """A fork; to who starts it the same as an ordinary process, but that it is no child of his."""

    def __new__(cls, args: list[str], **keys: Any) -> Any:
        environment = keys.get("env") or os.environ
        early = {name for name in {*environment, *os.environ} if name.startswith(KNOWN_EARLY)}
        is_alike = all(environment.get(name) == os.environ.get(name) for name in early)
        if args[0] != sys.executable or args[1] not in ("-m", "-c") or not is_alike or not nursery():
            return subprocess.Popen(args, **keys)
        return super().__new__(cls)

    def _execute_child(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, info, flags, shell, *more):  # type: ignore[no-untyped-def]
        pipes = more[:6]
        stdin, _, _, stdout, _, stderr = pipes
        files = [number if file == -1 else file for number, file in enumerate((stdin, stdout, stderr))]
        told = {"words": args[1:], "folder": str(cwd or Path.cwd()), "environment": dict(env or os.environ)}
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._line.connect(nursery())
        socket.send_fds(self._line, [json.dumps(told).encode()], files)
        self.pid = json.loads(self._line.recv(MOST_BYTES))["pid"]
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        global used_s
        try:
            told = self._line.recv(MOST_BYTES, socket.MSG_DONTWAIT if wait_flags else 0)
        except BlockingIOError:
            return 0, 0
        self._line.close()
        end = json.loads(told)
        used_s += end["used_s"]
        return self.pid, end["status"]

    def _internal_poll(self, *_: object, **__: object) -> int | None:
        if self.returncode is None and self._waitpid_lock.acquire(blocking=False):  # type: ignore[attr-defined]
            try:
                if self.returncode is None and (ended := self._try_wait(os.WNOHANG))[0]:
                    self._handle_exitstatus(ended[1])  # type: ignore[attr-defined]
            finally:
                self._waitpid_lock.release()  # type: ignore[attr-defined]
        return self.returncode


def ran(args: list[str], *, timeout: float | None = None, **keys: Any) -> subprocess.CompletedProcess[Any]:
    """What `subprocess.run` does with `capture_output=True, text=True`."""
    with Warm(args, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **keys) as process:
        try:
            out, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(args, process.returncode, out, errors)


if __name__ == "__main__":
    warm()
    run_to_the_end(serve(sys.argv[1]))
