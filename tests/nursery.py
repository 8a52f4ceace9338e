"""Processes of ours that begin warm: forks of one that has imported what they need and loaded the kernels, which takes it seconds.

For tests whose subject is not how a process begins or how Python ends. `python()` is a program that stands for `sys.executable`, and `command`
writes one that stands for `python -m` of a module. What must be known when Python begins, as some variables of the environment, and all but `-m`
and `-c`, is left to an ordinary process; so is everything where the system has no such forks.

Run as a program this file is the process that is forked. It ends with its standard input.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import marshal
import os
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from typing import NoReturn

EARLY = ("PYTHON", "NUMBA", "XDG_CACHE", "OMP_", "OPENBLAS", "LC_", "LANG", "HOME")
"""Beginnings of names of variables that count when Python and its modules are loaded."""
LATE = ("PYTHONUNBUFFERED",)
"""Of these, what a fork does too."""
MOST_BYTES = 1 << 20
WARMING = ("rov_autopilot", "push_the_crate", "remus_survey")
# Of modules that are there at once.
PROGRAM = """#!{python} -IS
import _signal, _socket, marshal, posix, sys
environment, words = dict(posix.environ), [{words} *sys.argv[1:]]
early = {{name: value for name, value in environment.items() if name.startswith({early}) and name not in {late}}}
if early != {here} or not words or words[0] not in ("-m", "-c"):
    posix.execve({python!r}, [{python!r}, *words], environment)
line = _socket.socket(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
line.connect({door!r})
files = b"".join(number.to_bytes(4, sys.byteorder) for number in (0, 1, 2))
told = marshal.dumps((words, posix.getcwd(), environment))
line.sendmsg([told], [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, files)])
pid = marshal.loads(line.recv(100))
for number in 1, 2, 10, 12, 15:
    _signal.signal(number, lambda number, frame: posix.kill(pid, number))
code = posix.waitstatus_to_exitcode(marshal.loads(line.recv(100)))
if code < 0:
    _signal.signal(-code, 0) if code != -9 else None
    posix.kill(posix.getpid(), -code)
posix._exit(code)
"""

# -- the process that is forked --------------------------------------------------------------------------------------------------------


def warm() -> None:
    """Import and load what most commands need, and leave no thread behind."""
    import uwclient.cli_verbs  # noqa: F401

    import uwserver
    import uwserver.cli.scenarios.check
    import uwserver.cli.scenarios.listing
    import uwserver.cli.serving.run
    import uwserver.environment.acoustics.fan
    import uwserver.environment.acoustics.layers
    import uwserver.environment.acoustics.search
    import uwserver.scenario.builder
    import uwserver.server.life_cycle

    uwserver.load("one_of_everything")
    for name in WARMING:
        world = uwserver.load(name)
        world.step(300)
        world.close()
    gc.collect()
    gc.freeze()


class Nursery:
    """Forks for each who connects, and tells him how his process ended; who leaves before has it killed."""

    def __init__(self, path: str) -> None:
        self.peers: dict[int, socket.socket] = {}
        self._folder = Path(path).parent
        self.ended, self._wake = os.pipe()
        os.set_blocking(self._wake, False)
        signal.signal(signal.SIGCHLD, lambda number, frame: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who runs the tests
        signal.set_wakeup_fd(self._wake)
        self.door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.door.bind(path)
        self.door.listen(64)

    def serve(self) -> list[str]:
        """Comes back in the forks, with what they are asked to run."""
        while True:
            ready, _, _ = select.select([0, self.ended, self.door, *self.peers.values()], [], [])
            if 0 in ready:
                for pid in self.peers:
                    os.kill(pid, signal.SIGKILL)
                shutil.rmtree(self._folder, ignore_errors=True)  # whose maker may have been killed
                os._exit(0)
            for pid, peer in list(self.peers.items()):
                if peer in ready and not peer.recv(1):
                    os.kill(pid, signal.SIGKILL)
                    self.peers.pop(pid).close()
            if self.ended in ready:
                os.read(self.ended, 4096)
                self._tell()
            if self.door in ready and (words := self._fork()):
                return words

    def _tell(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    return
                if pid in self.peers:
                    with self.peers.pop(pid) as peer, contextlib.suppress(OSError):
                        peer.send(marshal.dumps(status))

    def _fork(self) -> list[str]:
        peer, _ = self.door.accept()
        told, files, _, _ = socket.recv_fds(peer, MOST_BYTES, 3)
        pid = os.fork()
        if pid:
            self.peers[pid] = peer
            for file in files:
                os.close(file)
            peer.send(marshal.dumps(pid))
            return []
        for each in (self.door, peer, *self.peers.values()):
            each.close()
        signal.set_wakeup_fd(-1)
        os.close(self.ended)
        os.close(self._wake)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, file in enumerate(files):
            os.dup2(file, number)
            os.close(file)
        words, folder, environment = marshal.loads(told)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update({os.fsdecode(name): os.fsdecode(value) for name, value in environment.items()})
        if "PYTHONUNBUFFERED" in os.environ:
            sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
        return words  # type: ignore[no-any-return]


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
def nursery() -> Path | None:
    """The folder of the process that is forked, which is begun by who asks first; None where there is none."""
    if sys.platform != "linux":
        return None
    folder = tempfile.mkdtemp(prefix="nursery")
    process = subprocess.Popen(
        [sys.executable, __file__, f"{folder}/door"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdout.read(1)  # it is warm
    process.stdout.close()

    def end() -> None:
        process.communicate()
        shutil.rmtree(folder, ignore_errors=True)  # where it was killed before it could

    atexit.register(end)
    return Path(folder)


def command(file: Path, *words: str) -> None:
    """Write a program that does what `python` does with these words and its own."""
    place = nursery()
    assert place is not None
    here = {k: v for k, v in os.environb.items() if k.startswith(_bytes(EARLY)) and k not in _bytes(LATE)}
    file.write_text(
        PROGRAM.format(
            python=sys.executable,
            words="".join(f"{word!r}," for word in words),
            early=_bytes(EARLY),
            late=_bytes(LATE),
            here=here,
            door=str(place / "door"),
        )
    )
    file.chmod(0o755)


def _bytes(names: tuple[str, ...]) -> tuple[bytes, ...]:
    return tuple(name.encode() for name in names)


@functools.cache
def python() -> str:
    """A program that stands for `sys.executable`."""
    if (place := nursery()) is None:
        return sys.executable
    command(place / "python")
    return str(place / "python")


if __name__ == "__main__":
    warm()
    house = Nursery(sys.argv[1])
    os.write(1, b".")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    run_to_the_end(house.serve())
