"""Wall time that a test owns."""

from __future__ import annotations

import threading

from uwserver.units import NANOSECONDS


class MockTime:
    """A `uwserver.simulation.clock.Time` that passes only when somebody waits, or when the test moves it.

    Attributes:
        waits: length of every wait, s.
    """

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns
        self.waits: list[float] = []

    def now_ns(self) -> int:
        """The mocked time, ns."""
        return self._now_ns

    def wait(self, seconds: float, wake: threading.Event) -> None:
        """Time passes at once, exactly as asked."""
        self.waits.append(seconds)
        self._now_ns += max(1, round(seconds * NANOSECONDS))

    def pass_time(self, seconds: float) -> None:
        """Let time pass without a wait: a busy or stopped process."""
        self._now_ns += round(seconds * NANOSECONDS)
