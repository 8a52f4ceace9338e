"""The instant of t = 0: RFC 3339 with all its freedoms, in UTC, to the microsecond."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest

from uwserver.scenario.world.epoch import instant, nanoseconds, year_of

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
