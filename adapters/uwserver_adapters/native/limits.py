"""What bounds one host that tries tokens."""

from __future__ import annotations

from uwserver.adapter import RateMeter
from uwserver.ports import Fault

WRONG_TOKENS = 10
"""Wrong tokens that a host may show in `LOCKOUT_S`; then it is not heard until that ends."""
LOCKOUT_S = 10.0
LOCKOUT_HOSTS = 1024
"""Hosts whose wrong tokens are counted at once."""


class Lockout:
    """Hosts that try tokens: after too many wrong ones a host is not heard for a while, with whatever it says. Clients that it has stay.

    Attributes:
        fault: what such a host is told.
    """

    fault = Fault(
        "denied",
        f"more than {WRONG_TOKENS} wrong tokens of one host: it is not heard for up to {LOCKOUT_S:g} s",
        "token",
    )

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
