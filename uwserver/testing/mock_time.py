"""Wall time that a test controls."""

from __future__ import annotations

import threading

from uwserver.units import NANOSECONDS


class MockTime:
    """A `uwserver.simulation.clock.Time` that passes only while somebody waits, or when the test says so.

    Attributes:
        waits: duration of every wait, s.
    """

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns
        self.waits: list[float] = []

    def now_ns(self) -> int:
        """Return the mocked time, ns."""
        return self._now_ns

    def wait(self, seconds: float, wake: threading.Event) -> None:
        """Let exactly this time pass, at once."""
        self.waits.append(seconds)
        self._now_ns += max(1, round(seconds * NANOSECONDS))

    def pass_time(self, seconds: float) -> None:
        """Let time pass without a wait, as in a busy or stopped process."""
        self._now_ns += round(seconds * NANOSECONDS)
