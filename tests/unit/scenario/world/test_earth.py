"""The instant of t = 0 as RFC 3339 in UTC, and the magnetic field about the origin with its gradient."""

from __future__ import annotations

import math
from datetime import datetime, timezone

import numpy as np
import pytest

from uwserver.environment.earth import latitude_longitude
from uwserver.scenario.world.earth import WMM_YEARS, instant, magnetic_about, nanoseconds, year_of
from uwserver.units import deg, rad

UTC = timezone.utc


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("2026-01-01T00:00:00Z", datetime(2026, 1, 1, tzinfo=UTC)),
        ("2026-01-01t00:00:00z", datetime(2026, 1, 1, tzinfo=UTC)),
        ("2026-01-01 12:34:56Z", datetime(2026, 1, 1, 12, 34, 56, tzinfo=UTC)),
        ("2026-01-01T02:00:00+02:00", datetime(2026, 1, 1, tzinfo=UTC)),
        ("2025-12-31T21:30:00-02:30", datetime(2026, 1, 1, tzinfo=UTC)),
        ("2026-01-01T00:00:00.5Z", datetime(2026, 1, 1, microsecond=500_000, tzinfo=UTC)),
        ("2026-01-01T00:00:00.123456Z", datetime(2026, 1, 1, microsecond=123_456, tzinfo=UTC)),
        ("2026-01-01T00:00:00.1234569Z", datetime(2026, 1, 1, microsecond=123_456, tzinfo=UTC)),
        ("2026-01-01T00:00:00.000001+00:00", datetime(2026, 1, 1, microsecond=1, tzinfo=UTC)),
        ("2024-02-29T23:59:59Z", datetime(2024, 2, 29, 23, 59, 59, tzinfo=UTC)),
    ],
)
def test_an_instant(text: str, at: datetime) -> None:
    assert instant(text) == at
    assert instant(text).utcoffset() == at.utcoffset()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2026-01-01",
        "2026-01-01T00:00:00",
        "2026-01-01T00:00Z",
        "2026-1-1T00:00:00Z",
        "2026-01-01T00:00:00.Z",
        "2026-01-01T00:00:00 Z",
        "2026-01-01T00:00:00+0200",
        " 2026-01-01T00:00:00Z",
        "2026-01-01T00:00:00Z\n",
        "now",
    ],
)
def test_what_is_no_instant_is_told_how_to_write_one(text: str) -> None:
    with pytest.raises(ValueError, match='write it as "2026-01-01T00:00:00Z"'):
        instant(text)


@pytest.mark.parametrize(
    "text",
    ["2026-13-01T00:00:00Z", "2025-02-29T00:00:00Z", "2026-01-01T24:00:01Z", "2026-01-01T00:60:00Z"],
)
def test_a_day_or_time_that_does_not_exist_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"must be in|out of range"):
        instant(text)


def test_nanoseconds_since_1970_are_exact() -> None:
    assert nanoseconds(datetime(1970, 1, 1, tzinfo=UTC)) == 0
    assert nanoseconds(datetime(2026, 1, 1, tzinfo=UTC)) == 1_767_225_600 * 10**9
    assert nanoseconds(datetime(2026, 1, 1, microsecond=999_999, tzinfo=UTC)) == 1_767_225_600_999_999_000
    assert nanoseconds(datetime(1969, 12, 31, 23, 59, 59, 500_000, tzinfo=UTC)) == -500_000_000


def test_the_year_with_its_fraction_knows_leap_years() -> None:
    assert year_of(datetime(2026, 1, 1, tzinfo=UTC)) == 2026.0
    assert year_of(datetime(2025, 7, 2, 12, tzinfo=UTC)) == pytest.approx(2025.5, abs=1e-12)
    assert year_of(datetime(2024, 7, 2, tzinfo=UTC)) == pytest.approx(2024.5, abs=1e-12)
    assert year_of(datetime(2024, 12, 31, 23, 59, 59, tzinfo=UTC)) < 2025.0


TRONDHEIM = rad(63.43), rad(10.40)


# Of the test values published with WMM2025 (NOAA, table of test values): year, latitude, longitude (deg), X, Y, Z (nT), height 0.
PUBLISHED = [
    (2025.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
    (2025.0, 0.0, 120.0, 39677.8, -109.6, -10580.2),
    (2025.0, -80.0, 240.0, 6117.5, 15751.9, -52022.5),
]


@pytest.mark.parametrize(("year", "latitude", "longitude", "x", "y", "z"), PUBLISHED)
def test_the_field_at_the_origin_is_the_published_one(
    year: float, latitude: float, longitude: float, x: float, y: float, z: float
) -> None:
    at = magnetic_about(rad(latitude), rad(longitude), year)[0]
    assert [1e9 * c for c in at] == pytest.approx([x, y, z], abs=0.06)


def test_units_are_tesla_and_the_field_dips_into_the_sea_in_the_north() -> None:
    at = magnetic_about(*TRONDHEIM, 2026.0)[0]
    assert 4.5e-5 < math.hypot(*at) < 5.8e-5
    assert at[2] > 4e-5
    assert 0.0 < math.atan2(at[1], at[0]) < rad(8.0)


@pytest.mark.parametrize("place", [(5000.0, 0.0, 0.0), (0.0, -8000.0, 0.0), (3000.0, 3000.0, 500.0)])
def test_linear_about_the_origin_it_holds_for_kilometres(place: tuple[float, float, float]) -> None:
    at, *slopes = (np.array(v) for v in magnetic_about(*TRONDHEIM, 2026.0))
    there = at + sum(slope * way for slope, way in zip(slopes, place, strict=True))
    latitude, longitude = latitude_longitude(place[0], place[1], *TRONDHEIM)
    from pygeomag import GeoMag

    exact = GeoMag(coefficients_file="wmm/WMM_2025.COF").calculate(
        glat=deg(latitude), glon=deg(longitude), alt=-1e-3 * place[2], time=2026.0
    )
    assert there == pytest.approx(1e-9 * np.array([exact.x, exact.y, exact.z]), abs=2e-9)
    assert np.abs(there - at).max() > 1e-9


def test_deeper_is_stronger() -> None:
    """A dipole's field grows by 3 / radius towards the middle of the Earth."""
    at, _, _, down = (np.array(v) for v in magnetic_about(*TRONDHEIM, 2026.0))
    growth = float(at @ down) / float(at @ at)
    assert growth == pytest.approx(3.0 / 6.371e6, rel=0.25)


def test_the_field_drifts_with_the_years() -> None:
    first, last = (magnetic_about(*TRONDHEIM, year)[0] for year in (2025.0, 2029.9))
    assert first != last
    assert first == pytest.approx(last, rel=0.2)


@pytest.mark.parametrize("year", [WMM_YEARS[0] - 0.5, WMM_YEARS[1] + 0.5, 1970.0])
def test_a_year_outside_the_model_is_refused(year: float) -> None:
    with pytest.raises(ValueError, match="year"):
        magnetic_about(*TRONDHEIM, year)
