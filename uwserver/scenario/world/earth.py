"""Time and place on the Earth: the instant of t = 0, and the magnetic field about the origin of N by the World Magnetic Model."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone

from uwserver.environment.earth import latitude_longitude
from uwserver.frames import Vec3
from uwserver.units import NANOSECONDS, deg

_RFC_3339 = re.compile(r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d:\d\d)(?:\.(\d+))?([Zz]|[+-]\d\d:\d\d)")
WMM_YEARS = (2025, 2030)
"""First year of the model, and the first year after it."""
_TESLA = 1e-9
_STEP = 1000.0
"""Distance to each side over which the gradient is taken, m."""


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


# -- magnetic field ---------------------------------------------------------------------------------------------------------------------


def magnetic_about(latitude: float, longitude: float, year: float) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Return `Earth.magnetic` by the World Magnetic Model, at mean sea level.

    Args:
        latitude, longitude: those of the origin, rad.
        year: UTC, with its fraction; the model holds from 2025 to 2029.

    Raises:
        ValueError: the year is outside the model.
    """
    from pygeomag import GeoMag

    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")

    def field(north: float, east: float, down: float) -> Vec3:
        lat, lon = latitude_longitude(north, east, latitude, longitude)
        found = model.calculate(glat=deg(lat), glon=deg(lon), alt=-down * 1e-3, time=year)
        return found.x * _TESLA, found.y * _TESLA, found.z * _TESLA

    at = field(0.0, 0.0, 0.0)
    slopes = []
    for x, y, z in ((_STEP, 0.0, 0.0), (0.0, _STEP, 0.0), (0.0, 0.0, _STEP)):
        ahead, behind = field(x, y, z), field(-x, -y, -z)
        slopes.append(tuple((a - b) / (2.0 * _STEP) for a, b in zip(ahead, behind, strict=True)))
    return at, slopes[0], slopes[1], slopes[2]  # type: ignore[return-value]  # three components each
