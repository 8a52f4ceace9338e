"""What bounds a peer that asks too often."""

from __future__ import annotations

WINDOW_S = 1.0
"""Wall time over which requests are counted."""


class RateMeter:
    """Counts the requests of one client.

    Args:
        most: allowed in a window.
        window_s: wall time of a window; default `WINDOW_S`.

    Attributes:
        count: requests in this window.
        end: wall time (of the loop) at which the window ends.
    """

    def __init__(self, most: int, window_s: float | None = None) -> None:
        self.most = most
        self._window_s = WINDOW_S if window_s is None else window_s
        self.count = 0
        self.end = 0.0

    def take(self, now: float) -> bool:
        """Count one; whether it is still allowed."""
        if now >= self.end:
            self.end = now + self._window_s
            self.count = 0
        self.count += 1
        return self.count <= self.most

    def is_flooded(self, now: float) -> bool:
        """Whether more came than allowed, and the window lasts."""
        return self.count > self.most and now < self.end
