"""Measures how much of the machine other processes use, because the bars of lateness hold for an idle machine. Works on Linux only."""

from __future__ import annotations

import os
from pathlib import Path

from uwserver.simulation.clock import SystemTime


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
