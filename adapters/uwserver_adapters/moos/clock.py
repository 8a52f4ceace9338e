"""MOOS time: seconds since 1970 times the warp, plus what the database's clock is ahead."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable
from datetime import datetime, timezone

from uwserver.adapter import AdapterContext

log = logging.getLogger(__name__)

CREDIBLE_S = 86_400.0
"""Difference of two clocks above which the warp must be different, MOOS seconds at warp 1."""
_JUMP_S = 1.0
_GAIN = 0.1
_MEAN_OF = 5


def unix_s() -> float:
    """Seconds since 1970, by the machine's clock."""
    return datetime.now(timezone.utc).timestamp()


class DatabaseClock:
    """MOOS time as a MOOSDB has it: the machine's date at any time, steps of it included. Its clients on this machine follow the same steps, and
    throw away mail that is far from their own time.

    Args:
        warp: MOOS seconds in a second.
        unix: seconds since 1970 now; default: the machine's.

    Attributes:
        warp: as given.
    """

    def __init__(self, warp: float, unix: Callable[[], float] = unix_s) -> None:
        self.warp = warp
        self._unix = unix

    def now(self) -> float:
        """MOOS time, s."""
        return self._unix() * self.warp


class MoosClock:
    """That of a client. Steady: the machine's date is asked once, later steps of it are followed with the database's, as a skew.

    Args:
        warp: MOOS seconds in a second; the MOOSTimeWarp of the community.
        steady: a clock that never jumps, s (that of the loop).
        unix: seconds since 1970 now; default: the machine's.

    Attributes:
        warp: as given.
        skew: what is added to follow the database, MOOS seconds.
    """

    def __init__(self, warp: float, steady: Callable[[], float], unix: float | None = None) -> None:
        self.warp = warp
        self.skew = 0.0
        self._steady = steady
        start = unix_s() if unix is None else unix
        self._offset = start - steady()

    def now(self) -> float:
        """MOOS time, s."""
        return (self._steady() + self._offset) * self.warp + self.skew

    def observe(self, sent: float, theirs: float, received: float) -> float:
        """Follow the database's clock.

        A time of theirs between our sending and receiving is what equal clocks show, so nothing is changed then.

        Args:
            sent, received: our MOOS times of a question and its answer.
            theirs: the database's MOOS time in between.

        Returns:
            By how much the clock jumped, MOOS seconds; 0 for a small difference, which is followed smoothly.
        """
        if sent <= theirs <= received:
            return 0.0
        ahead = theirs - 0.5 * (sent + received)
        if abs(ahead) > _JUMP_S * self.warp:
            self.skew += ahead
            return ahead
        self.skew += _GAIN * ahead
        return 0.0

    @property
    def is_credible(self) -> bool:
        """Whether the difference to the database can be one of clocks: another warp makes it far larger."""
        return abs(self.skew) < CREDIBLE_S * self.warp


def warp_of(context: AdapterContext, given: float | None) -> float:
    """MOOSTimeWarp: as given, else the speed of the server. Warns when the two differ, as time would run differently on the two sides."""
    world = context.world
    if world.mode != "realtime":
        return 1.0 if given is None else given
    if given is not None and abs(given - world.speed) > 1e-9 * world.speed:
        text = "%s: warp = %g, but this server runs at speed %g: give both the same, or leave warp out"
        log.warning(text, context.name, given, world.speed)
    return world.speed if given is None else given


class Latency:
    """How long the heartbeats of a client were under way, ms of MOOS time by the clocks of both sides; its text is that of DB_QOS."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=_MEAN_OF)
        self._most, self._least = -math.inf, math.inf

    def add(self, latency_ms: float) -> None:
        """One more."""
        self._last.append(latency_ms)
        self._most, self._least = max(self._most, latency_ms), min(self._least, latency_ms)

    def __bool__(self) -> bool:
        return bool(self._last)

    def __str__(self) -> str:
        return f"{self._last[-1]:g}:{self._most:g}:{self._least:g}:{sum(self._last) / len(self._last):g}"
