"""Conversions that several devices need: degrees on the wire, calendar dates, and lines of the NMEA 0183 form."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import datetime, timedelta, timezone

from uwserver.units import NANOSECONDS, deg, rad

FULL_TURN_DEG = deg(2.0 * math.pi)

__all__ = ["FULL_TURN_DEG", "NANOSECONDS", "checksum", "deg", "instant", "rad", "sentence"]


_ZERO = datetime(1970, 1, 1, tzinfo=timezone.utc)
_LAST_NS = (datetime(9999, 12, 31, 23, 59, 59, tzinfo=timezone.utc) - _ZERO) // timedelta(seconds=1) * NANOSECONDS
_FIRST_NS = (datetime(1, 1, 1, tzinfo=timezone.utc) - _ZERO) // timedelta(seconds=1) * NANOSECONDS


def instant(utc_ns: int) -> datetime:
    """Return the date of a UTC time, ns since 1970. A time outside the years 1 to 9999 gives the first or the last date."""
    return _ZERO + timedelta(microseconds=max(_FIRST_NS, min(utc_ns, _LAST_NS)) // 1000)


def checksum(body: bytes) -> int:
    """Return the exclusive or of all characters: those between the first character of a sentence and its asterisk."""
    total = 0
    for byte in body:
        total ^= byte
    return total


def sentence(address: str, fields: Iterable[str]) -> bytes:
    """Return a whole line: ``sentence("GPHDT", ("12.3", "T"))`` is ``$GPHDT,12.3,T*2B``, CR and LF."""
    body = ",".join((address, *fields)).encode("ascii")
    return b"$%b*%02X\r\n" % (body, checksum(body))
