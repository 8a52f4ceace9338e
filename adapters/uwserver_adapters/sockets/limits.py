"""What bounds one client, and how refusals are told: in `stats.details`, and in the log once per cause."""

from __future__ import annotations

import logging

from uwserver.adapter import AdapterStats
from uwserver.ports import Json

_log = logging.getLogger(__name__)

WINDOW_S = 1.0
"""Wall time over which requests are counted."""
WRONG_TOKENS = 10
"""Wrong tokens that a host may show in `LOCKOUT_S`; then it is not heard until that ends."""
LOCKOUT_S = 10.0
LOCKOUT_HOSTS = 1024
"""Hosts whose wrong tokens are counted at once."""


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


class Lockout:
    """Hosts that try tokens: after too many wrong ones a host is not heard for a while, with whatever it says."""

    def __init__(self) -> None:
        self._hosts: dict[object, RateMeter] = {}

    def wrong(self, host: object, now: float) -> bool:
        """Count a wrong token; whether it was the one too many."""
        meter = self._hosts.pop(host, None) or RateMeter(WRONG_TOKENS, LOCKOUT_S)
        while len(self._hosts) >= LOCKOUT_HOSTS:
            del self._hosts[next(iter(self._hosts))]  # the one that was wrong least recently
        self._hosts[host] = meter
        return not meter.take(now) and meter.count == meter.most + 1

    def is_out(self, host: object, now: float) -> bool:
        """Whether it is not heard now."""
        meter = self._hosts.get(host)
        return meter is not None and meter.is_flooded(now)


class Refusals:
    """Counts what was refused by cause; the first of each cause is logged.

    Args:
        name: of the adapter, for the log.
        stats: ``details["refused"]`` maps each cause to its count.
    """

    def __init__(self, name: str, stats: AdapterStats) -> None:
        self._name = name
        self._stats = stats
        self._counts: dict[str, Json] = {}

    def note(self, cause: str, text: str) -> None:
        """One more. `cause` is one of few fixed texts, never what a peer said."""
        known = self._counts.get(cause, 0)
        assert isinstance(known, int)
        self._counts[cause] = known + 1
        self._stats.details["refused"] = self._counts
        if not known:
            _log.warning(
                "%s refused (%s): %s. Further ones are only counted, in world/status", self._name, cause, text[:500]
            )
