"""Limits for peers that ask too often or for too much, and for waiting."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")

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


async def within(seconds: float, what: Awaitable[T], text: str) -> T:
    """Wait for a result, but no longer than so many seconds. `asyncio.wait_for` would lose a cancellation that comes together with the result.

    Raises:
        TimeoutError: it took too long; the error begins with `text`. It is an `OSError`, like other losses of a peer.
    """
    task = asyncio.ensure_future(what)
    try:
        await asyncio.wait({task}, timeout=seconds)
    finally:
        if not task.done():
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
    if task.cancelled():
        raise TimeoutError(f"{text} in {seconds:g} s")
    return task.result()
