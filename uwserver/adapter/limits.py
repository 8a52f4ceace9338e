"""Limits for peers that ask too often, or for too much."""

from __future__ import annotations

WINDOW_S = 1.0
"""Wall time over which requests are counted."""


class RateMeter:
    """Counts the requests of one client.

    Args:
        most: requests that are allowed in a window.
        window_s: wall time of a window; default `WINDOW_S`.

    Attributes:
        count: requests in this window.
        end: loop time at which the window ends.
    """

    def __init__(self, most: int, window_s: float | None = None) -> None:
        self.most = most
        self._window_s = WINDOW_S if window_s is None else window_s
        self.count = 0
        self.end = 0.0

    def take(self, now: float, weight: int = 1) -> bool:
        """Count a request, which may weigh as much as several; return whether it is still allowed."""
        if now >= self.end:
            self.end = now + self._window_s
            self.count = 0
        self.count += weight
        return self.count <= self.most

    def is_full(self, now: float) -> bool:
        """Tell whether one more request would be too many in this window, for callers that let it wait instead of refusing it."""
        return self.count >= self.most and now < self.end

    def is_flooded(self, now: float) -> bool:
        """Tell whether more requests came than are allowed in this window."""
        return self.count > self.most and now < self.end


class TurnTimes:
    """Gives peers that have used up their turn the time of their next one: one after the other, with a rest before each.

    While the loop works, the simulation waits for the interpreter. With the rests the simulation has it most of the time, however many peers
    flood the server.
    """

    def __init__(self) -> None:
        self._next = 0.0

    def after(self, now: float, turn_s: float, rest_s: float) -> float:
        """Return the loop time at which a peer whose turn ends now has the next one.

        Args:
            now: loop time.
            turn_s: length of a turn.
            rest_s: length of the rest before a turn.
        """
        at = max(self._next, now + rest_s)
        self._next = at + turn_s + rest_s
        return at
