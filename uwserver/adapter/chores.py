"""Work that is done in pieces on the loop, such as a long answer, or the clean-up after a client that is gone."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Iterator

from uwserver.adapter.connection import TURN_S

log = logging.getLogger(__name__)

REST_S = 0.004
"""Wall time between two turns."""


class Chores:
    """Does pieces of work one after the other on the running loop, with a rest after each turn of `TURN_S`.

    The rests are for the simulation, which cannot have the interpreter while the loop works.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[Iterator[None]] = deque()
        self._turn: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, steps: Iterator[None]) -> None:
        """Take on a piece of work, after those that wait already. Each step of the iterator should be short."""
        self._waiting.append(steps)
        if self._turn is None:
            self._turn = self._loop.call_later(0.0, self._work)

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while self._waiting:
            try:
                next(self._waiting[0])
            except StopIteration:
                self._waiting.popleft()
            except Exception:
                # A fault of an adapter must not keep the other pieces waiting.
                log.exception("what an adapter does in pieces ends by a fault of it")
                self._waiting.popleft()
            if self._waiting and self._loop.time() >= end:
                self._turn = self._loop.call_later(REST_S, self._work)
                return

    def close(self) -> None:
        """Drop the work that is left."""
        if self._turn is not None:
            self._turn.cancel()
        self._waiting.clear()
