"""What a process uses, as Linux tells it."""

from __future__ import annotations

import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Usage:
    """Of a process, now: resident memory (bytes), open descriptors, threads."""

    memory: int
    descriptors: int
    threads: int


def usage(pid: int) -> Usage:
    """Of any process of this user."""
    root = Path(f"/proc/{pid}")
    pages = int((root / "statm").read_text().split()[1])
    counts = [len([*(root / part).iterdir()]) for part in ("fd", "task")]
    return Usage(pages * os.sysconf("SC_PAGE_SIZE"), *counts)


def own_usage() -> Usage:
    """Of this process, after everything that can be given back was."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return usage(os.getpid())


def processor_s(pid: int) -> dict[int, float]:
    """Processor time of each thread, s; the main thread has the number of the process."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        fields = (task / "stat").read_text().rpartition(")")[2].split()
        found[int(task.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return found
