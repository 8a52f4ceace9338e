"""What a part of a program leaves behind: tasks, threads, open files and sockets."""

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
    """What a part of a program holds of its process."""

    tasks: frozenset[asyncio.Task[Any]]
    threads: frozenset[str]
    files: Mapping[str, str]

    @classmethod
    def now(cls) -> Traces:
        """As it is now."""
        threads = frozenset(f"{thread.name} ({thread.ident})" for thread in threading.enumerate())
        return cls(frozenset(asyncio.all_tasks()), threads, _open_files())

    def new_since(self, before: Traces) -> list[str]:
        """Descriptions of what is there and was not."""
        files = [
            f"file {number}: {target}" for number, target in self.files.items() if before.files.get(number) != target
        ]
        tasks = [f"task {task.get_name()}: {task.get_coro()}" for task in self.tasks - before.tasks]
        return [*tasks, *(f"thread {name}" for name in sorted(self.threads - before.threads)), *files]


def _open_files() -> dict[str, str]:
    folder = Path("/proc/self/fd")
    found = {}
    for entry in folder.iterdir() if folder.exists() else ():
        with contextlib.suppress(OSError):  # the descriptor of the listing itself
            found[entry.name] = str(entry.readlink())
    return found


async def assert_no_traces(before: Traces, after: str) -> None:
    """Fail, naming what is left, unless everything opened since `before` is gone again; `after` says what was done.

    Transports are freed in the next turns of the loop, and threads end a moment after their last work; a library's own threads
    close its sockets when a busy machine lets them: it looks again for 5 s, and goes on as soon as nothing is left.

    Raises:
        AssertionError: tasks, threads, sockets or files are left.
    """
    left: list[str] = []
    for _ in range(500):
        await asyncio.sleep(0.01)
        left = Traces.now().new_since(before)
        if not left:
            return
    raise AssertionError(f"{after} leaves behind: {'; '.join(left)}; close it in the finally of run()")
