"""MOOS time: seconds since 1970 times the warp, plus the lead of the database's clock."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable
from datetime import datetime, timezone

from uwserver.adapter import AdapterContext

log = logging.getLogger(__name__)

CREDIBLE_S = 86_400.0
"""Difference of two clocks above which their warps must be different, MOOS seconds at warp 1."""
_JUMP_S = 1.0
"""Difference that is followed at once, MOOS seconds at warp 1."""
_GAIN = 0.1
"""Share of a smaller difference by which the clock is corrected with each answer."""
_MEAN_OF = 5
"""Heartbeats of which DB_QOS tells the mean."""


def unix_s() -> float:
    """Return seconds since 1970 by the machine's clock."""
    return datetime.now(timezone.utc).timestamp()


class DatabaseClock:
    """MOOS time of a MOOSDB: the date of the machine, with all its steps. Clients on this machine follow the same steps, and throw away mail whose
    time is far from theirs.

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
    """MOOS time of a client. The date of the machine is read once; later steps of it are followed as a skew, together with the database.

    Args:
        warp: MOOS seconds in a second; the MOOSTimeWarp of the community.
        steady: a clock that never jumps, s (that of the loop).
        unix: seconds since 1970 now; default: the machine's.

    Attributes:
        warp: as given.
        skew: correction that follows the database, MOOS seconds.
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

        Equal clocks give a time between our question and its answer, so nothing is changed then.

        Args:
            sent, received: our MOOS times of a question and its answer.
            theirs: the database's MOOS time in between.

        Returns:
            The jump of the clock, MOOS seconds; 0 for a small difference, which is followed smoothly.
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
        """Whether the skew can be a difference of two clocks. Another warp makes it far larger."""
        return abs(self.skew) < CREDIBLE_S * self.warp


def warp_of(context: AdapterContext, given: float | None) -> float:
    """Return the MOOSTimeWarp: as given, else the speed of the server. Warns where both are known and differ, as time would run differently then."""
    world = context.world
    if world.mode != "realtime":
        return 1.0 if given is None else given
    if given is not None and abs(given - world.speed) > 1e-9 * world.speed:
        text = "%s: warp = %g, but this server runs at speed %g: give both the same, or leave warp out"
        log.warning(text, context.name, given, world.speed)
    return world.speed if given is None else given


class Latency:
    """Travel times of a client's heartbeats, ms of MOOS time by the clocks of both sides. Its text is that of DB_QOS: last, most, least, mean."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=_MEAN_OF)
        self._most, self._least = -math.inf, math.inf

    def add(self, latency_ms: float) -> None:
        """Add a travel time."""
        self._last.append(latency_ms)
        self._most, self._least = max(self._most, latency_ms), min(self._least, latency_ms)

    def __bool__(self) -> bool:
        return bool(self._last)

    def __str__(self) -> str:
        return f"{self._last[-1]:g}:{self._most:g}:{self._least:g}:{sum(self._last) / len(self._last):g}"
