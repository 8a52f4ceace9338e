"""Wall time, how simulation time follows it, and how late ticks are. No other module reads the clock of the machine."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from uwserver.units import NANOSECONDS

OVERLOAD_NS = NANOSECONDS // 4
"""If ticks are late by more than this, the deadlines begin again from now, so that a process that was stopped does not catch up in a burst."""

_WAKE_NS = NANOSECONDS // 20
"""Longer waits can be interrupted; shorter ones use the more precise sleep."""

Mode = Literal["realtime", "freerun", "lockstep"]
OnLoss = Literal["wait", "continue", "pause"]
BUCKETS_S = (1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2, 5e-2, 0.1, 0.25)
"""Upper bounds of the histogram, s."""
_RECENT = 8192


@dataclass(frozen=True)
class Timing:
    """How time passes in a simulation; fields as in the scenario's ``[world.clock]``."""

    mode: Mode = "realtime"
    speed: float = 1.0
    paused: bool = False
    lockstep_clients: tuple[str, ...] = ()
    lockstep_timeout_s: float = 10.0
    on_loss: OnLoss = "wait"
    max_speed: float | None = None

    @property
    def pace(self) -> float | None:
        """Simulated seconds per second of wall time that ticks keep to; None if they wait for no clock."""
        return {"realtime": self.speed, "lockstep": self.max_speed, "freerun": None}[self.mode]


class Time(Protocol):
    """Wall time; tests replace it by `uwserver.testing.MockTime`."""

    def now_ns(self) -> int:
        """Return monotonic time, ns."""

    def wait(self, seconds: float, wake: threading.Event) -> None:
        """Return after a time. A long wait ends early when `wake` is set."""


class SystemTime:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Return monotonic time, ns."""
        return time.monotonic_ns()

    def wait(self, seconds: float, wake: threading.Event) -> None:
        """Sleep. A wait of more than 50 ms ends early when `wake` is set."""
        if seconds * NANOSECONDS > _WAKE_NS:
            wake.wait(seconds)
        elif seconds > 0.0:
            time.sleep(seconds)


def processor_ns() -> int:
    """Return the processor time that this process has used, ns. On a busy machine it grows more slowly than wall time."""
    return time.process_time_ns()


def utc_text() -> str:
    """Return wall-clock UTC as ``20260131T235959Z``, for names of files."""
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())


class Pace:
    """Keeps ticks to wall time at a speed, by absolute deadlines: the n-th tick is due at anchor + t_n / speed, so lateness never adds up.

    Attributes:
        speed: simulated seconds per second.
        overruns: how often the deadlines had to begin again.
    """

    def __init__(self, time: Time, speed: float = 1.0) -> None:
        self._time = time
        self.speed = speed
        self.overruns = 0
        self._anchor_wall: int | None = None
        self._anchor_sim = 0

    def anchor(self, t_ns: int) -> None:
        """Let simulation time t_ns be due now."""
        self._anchor_wall, self._anchor_sim = self._time.now_ns(), t_ns

    def release(self) -> None:
        """Forget the anchor; the next wait sets a new one. Called after a pause, a reset or a change of mode."""
        self._anchor_wall = None

    def wait(self, t_ns: int, wake: threading.Event) -> int | None:
        """Wait until simulation time t_ns is due. Returns how late it is then, ns (>= 0); None if `wake` has interrupted a long wait."""
        if self._anchor_wall is None:
            self.anchor(t_ns)
        assert self._anchor_wall is not None
        deadline = self._anchor_wall + round((t_ns - self._anchor_sim) / self.speed)
        left = deadline - self._time.now_ns()
        while left > 0:
            if left > _WAKE_NS and wake.is_set():
                return None
            self._time.wait(left / NANOSECONDS, wake)
            left = deadline - self._time.now_ns()
        late = max(0, -left)
        if late > OVERLOAD_NS:
            self.overruns += 1
            self.anchor(t_ns)
        return late


class Barrier:
    """Lets lockstep time go as far as every named client has granted. Thread-safe.

    Attributes:
        clients: names of the clients that must grant.
    """

    def __init__(self, clients: Iterable[str]) -> None:
        self.clients = frozenset(clients)
        self._granted = dict.fromkeys(self.clients, 0)
        self._present: dict[str, int] = {}
        self._excused: set[str] = set()
        self._lock = threading.Lock()

    def join(self, client: str) -> None:
        """Note that a client of this name is connected."""
        with self._lock:
            self._present[client] = self._present.get(client, 0) + 1
            self._excused.discard(client)

    def leave(self, client: str) -> None:
        """Note that one connection of this name is gone."""
        with self._lock:
            left = self._present.pop(client, 1) - 1
            if left > 0:  # a name without a connection is not kept
                self._present[client] = left

    def grant(self, client: str, ticks: int, now: int) -> int:
        """Let time go `ticks` further than the client granted before (or further than tick `now`). Returns the tick that it now allows."""
        with self._lock:
            self._granted[client] = max(self._granted.get(client, 0), now) + ticks
            self._excused.discard(client)
            return self._granted[client]

    def granted(self, client: str) -> int:
        """Return the tick up to which this client lets time go."""
        return self._granted.get(client, 0)

    def is_excused(self, client: str) -> bool:
        """Return whether time goes on without this client."""
        return client in self._excused

    def restart(self, tick: int) -> None:
        """Drop all grants beyond a tick, as the world was put there."""
        with self._lock:
            self._granted = dict.fromkeys(self.clients, tick)

    def excuse(self, clients: Iterable[str]) -> None:
        """Go on without these clients until they grant or join again."""
        with self._lock:
            self._excused |= set(clients)

    def missing(self, tick: int) -> list[str]:
        """Return the clients that do not yet let a tick begin, in order of their names."""
        with self._lock:
            return sorted(c for c in self.clients - self._excused if self._granted[c] <= tick)

    def absent(self) -> list[str]:
        """Return the named clients that are not connected."""
        with self._lock:
            return sorted(c for c in self.clients if not self._present.get(c))


class Lateness:
    """Histogram over the whole run, and quantiles over the last 8192 paced ticks.

    Attributes:
        ticks: number of all ticks.
        counts: paced ticks in each bucket, the last one without a bound.
        total_s: sum of the lateness of all paced ticks, s.
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.counts = [0] * (len(BUCKETS_S) + 1)
        self.total_s = 0.0
        self._recent = np.zeros(_RECENT)
        self._paced = 0

    def add(self, late_ns: int) -> None:
        """Count one paced tick."""
        late = late_ns * 1e-9
        self.counts[bisect_left(BUCKETS_S, late)] += 1
        self.total_s += late
        self._recent[self._paced % _RECENT] = late
        self._paced += 1

    def quantiles(self) -> dict[str, float]:
        """Return p50, p99 and max of the recent lateness, s; zeros before the first paced tick."""
        recent = self._recent[: min(self._paced, _RECENT)]
        if not len(recent):
            return {"p50_s": 0.0, "p99_s": 0.0, "max_s": 0.0}
        p50, p99 = np.percentile(recent, (50, 99)).tolist()
        return {"p50_s": p50, "p99_s": p99, "max_s": float(recent.max())}
