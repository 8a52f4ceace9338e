"""What bounds a peer that asks too often, or for too much."""

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

    def take(self, now: float, weight: int = 1) -> bool:
        """Count one, or one that costs as much as several; whether it is still allowed."""
        if now >= self.end:
            self.end = now + self._window_s
            self.count = 0
        self.count += weight
        return self.count <= self.most

    def is_full(self, now: float) -> bool:
        """Whether the next one is one too many, and the window lasts: for who lets it wait instead of refusing it."""
        return self.count >= self.most and now < self.end

    def is_flooded(self, now: float) -> bool:
        """Whether more came than allowed, and the window lasts."""
        return self.count > self.most and now < self.end


class TurnTimes:
    """When peers that have used up their turn have the next one: one after the other, with a rest before each. What the loop does keeps the
    simulation waiting for the interpreter; so however many peers flood, it has it to itself for most of the time."""

    def __init__(self) -> None:
        self._next = 0.0

    def after(self, now: float, turn_s: float, rest_s: float) -> float:
        """When (time of the loop) a peer whose turn ends now has the next.

        Args:
            now: time of the loop.
            turn_s: how long it may last.
            rest_s: before each.
        """
        at = max(self._next, now + rest_s)
        self._next = at + turn_s + rest_s
        return at
