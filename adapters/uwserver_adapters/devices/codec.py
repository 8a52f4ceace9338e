"""Units in which devices speak: degrees on the wire, radians inside."""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

from uwserver.units import NANOSECONDS, deg, rad

FULL_TURN_DEG = deg(2.0 * math.pi)

__all__ = ["FULL_TURN_DEG", "NANOSECONDS", "deg", "instant", "rad"]


_ZERO = datetime(1970, 1, 1, tzinfo=timezone.utc)
_LAST_NS = (datetime(9999, 12, 31, 23, 59, 59, tzinfo=timezone.utc) - _ZERO) // timedelta(seconds=1) * NANOSECONDS
_FIRST_NS = (datetime(1, 1, 1, tzinfo=timezone.utc) - _ZERO) // timedelta(seconds=1) * NANOSECONDS


def instant(utc_ns: int) -> datetime:
    """The date of a UTC since 1970; the first or last one that there is where a world is beyond it."""
    return _ZERO + timedelta(microseconds=max(_FIRST_NS, min(utc_ns, _LAST_NS)) // 1000)
