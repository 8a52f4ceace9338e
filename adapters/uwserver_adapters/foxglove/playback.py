"""The state of a recording's playback. The player answers when it has its turn, so messages about it come later."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from uwserver.adapter import AdapterContext, within
from uwserver.ports import Json, Progress, Refused, Reply
from uwserver_adapters.foxglove import codec

_STATE = "playback/state"
_PATIENCE_S = 2.0
"""Wall time for which a greeting waits for the player."""


class Playback:
    """Asks the player for its state. Loop thread.

    Args:
        context: the world.

    Attributes:
        span_ns: begin and end of what is played, ns, as last known; None for a running world.
    """

    def __init__(self, context: AdapterContext) -> None:
        self.span_ns: tuple[int, int] | None = None
        self._context = context

    def tell(self, has_sought: bool, request: str, send: Callable[[bytes], None]) -> None:
        """Send the state as soon as the player has given it; for a running world nothing.

        Args:
            has_sought: whether time has jumped.
            request: id of the request that is answered; "" for none.
            send: sends the message.
        """

        def take(state: dict[str, Json]) -> None:
            t_s, speed = _number(state, "t_s"), _number(state, "speed")
            status = codec.PAUSED if state.get("paused") else codec.PLAYING
            send(codec.playback_state(status, t_s or 0.0, 1.0 if speed is None else speed, has_sought, request))

        self._ask(take)

    async def follow(self) -> None:
        """Update `span_ns`, waiting for the player for a limited time."""
        if _STATE not in self._context.services:
            return
        answered = asyncio.Event()
        self._ask(lambda _: answered.set(), answered.set)
        with contextlib.suppress(TimeoutError):
            await within(_PATIENCE_S, answered.wait(), "no answer")

    def _ask(self, then: Callable[[dict[str, Json]], None], otherwise: Callable[[], None] = lambda: None) -> None:
        def take(answer: Reply | Progress) -> None:
            if not isinstance(answer, Reply):
                return
            if not isinstance(answer.result, dict):
                otherwise()
                return
            begin_s, end_s = _number(answer.result, "from_s"), _number(answer.result, "to_s")
            if begin_s is not None and end_s is not None:
                self.span_ns = codec.nanoseconds(begin_s), codec.nanoseconds(end_s)
            then(answer.result)

        if _STATE not in self._context.services:
            return
        try:
            self._context.call(_STATE, {}, self._context.name, take)
        except Refused:
            otherwise()


def _number(state: dict[str, Json], key: str) -> float | None:
    found = state.get(key)
    return float(found) if isinstance(found, int | float) else None
