"""Parses the instant of t = 0 as a scenario file writes it."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone

from uwserver.units import NANOSECONDS

_RFC_3339 = re.compile(r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d:\d\d)(?:\.(\d+))?([Zz]|[+-]\d\d:\d\d)")


def instant(text: str) -> datetime:
    """Return the instant in UTC, to the microsecond.

    Raises:
        ValueError: the text is not an RFC 3339 instant; the message says why.
    """
    match = _RFC_3339.fullmatch(text)
    if match is None:
        raise ValueError('write it as "2026-01-01T00:00:00Z"')
    day, clock, fraction, zone = match.groups()
    # The fraction is added by hand: Python 3.10 parses only some lengths of it.
    whole = datetime.fromisoformat(f"{day}T{clock}{zone.upper().replace('Z', '+00:00')}").astimezone(timezone.utc)
    return whole + timedelta(microseconds=int(f"{fraction or '':0<6}"[:6]))


def nanoseconds(at: datetime) -> int:
    """Return the nanoseconds since 1970, without leap seconds."""
    since = at - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return (since.days * 86_400 + since.seconds) * NANOSECONDS + since.microseconds * 1000


def year_of(at: datetime) -> float:
    """Return the year with its fraction."""
    start, end = (datetime(at.year + k, 1, 1, tzinfo=timezone.utc) for k in (0, 1))
    return at.year + (at - start) / (end - start)
