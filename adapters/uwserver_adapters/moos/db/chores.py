"""What is done in pieces and nobody waits for, as tidying up after a client that is gone."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator

from uwserver.adapter import TURN_S

REST_S = 0.004
"""Wall time between two turns."""


class Chores:
    """One after the other, on the running loop, with a rest whenever a turn is used up."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[Iterator[None]] = deque()
        self._turn: asyncio.TimerHandle | None = None

    def add(self, steps: Iterator[None]) -> None:
        """Do this too, after what waits already."""
        self._waiting.append(steps)
        if self._turn is None:
            self._turn = self._loop.call_later(0.0, self._work)

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._waiting:
            for _ in self._waiting[0]:
                if self._loop.time() >= end:
                    self._turn = self._loop.call_later(REST_S, self._work)
                    return
            self._waiting.popleft()

    def close(self) -> None:
        """Leave what is left."""
        if self._turn is not None:
            self._turn.cancel()
        self._waiting.clear()
