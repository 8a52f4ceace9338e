"""Finds what a part of a program leaves behind: tasks, threads, open files and sockets."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Traces:
    """The tasks, threads and open files of this process.

    Attributes:
        tasks: tasks of the running loop.
        threads: names and identifiers of threads.
        files: target of each file descriptor.
    """

    tasks: frozenset[asyncio.Task[Any]]
    threads: frozenset[str]
    files: Mapping[str, str]

    @classmethod
    def now(cls) -> Traces:
        """Return the present state."""
        threads = frozenset(f"{thread.name} ({thread.ident})" for thread in threading.enumerate())
        return cls(frozenset(asyncio.all_tasks()), threads, _open_files())

    def new_since(self, before: Traces) -> list[str]:
        """Return descriptions of what is there now and was not there before."""
        files = [
            f"file {number}: {target}" for number, target in self.files.items() if before.files.get(number) != target
        ]
        tasks = [f"task {task.get_name()}: {task.get_coro()}" for task in self.tasks - before.tasks]
        return [*tasks, *(f"thread {name}" for name in sorted(self.threads - before.threads)), *files]


def _open_files() -> dict[str, str]:
    folder = Path("/proc/self/fd")
    found = {}
    for entry in folder.iterdir() if folder.exists() else ():
        # The descriptor of the listing itself is closed already.
        with contextlib.suppress(OSError):
            found[entry.name] = str(entry.readlink())
    return found


async def assert_no_traces(before: Traces, after: str) -> None:
    """Fail if anything that was opened since `before` is left. `after` says what was done.

    Transports are freed in the next turns of the loop, threads end a moment after their last work, and the threads of a library close its
    sockets when a busy machine lets them. So this waits for up to 5 s, but only as long as something is left.

    Raises:
        AssertionError: tasks, threads, sockets or files are left; the text names them.
    """
    left: list[str] = []
    for _ in range(500):
        await asyncio.sleep(0.01)
        left = Traces.now().new_since(before)
        if not left:
            return
    raise AssertionError(f"{after} leaves behind: {'; '.join(left)}; close it in the finally of run()")
