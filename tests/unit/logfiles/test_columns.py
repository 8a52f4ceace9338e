"""Columns: units and time by their names."""

import pytest

from uwserver.logfiles import LogError
from uwserver.logfiles.columns import field_of, stamp_of, time_column


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("depth_m", "m"),
        ("yaw [deg]", "deg"),
        ("speed (kn)", "kn"),
        ("v_mps", "m/s"),
        ("north", ""),
        ("p [Pa]", "Pa"),
        ("u [what]", ""),
    ],
)
def test_units(name, unit):
    assert field_of(name, "number").unit == unit


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["x", "t_s"], (1, 10**9)),
        (["Time [ms]", "x"], (0, 10**6)),
        (["timestamp", "time"], (0, 0)),
    ],
)
def test_the_time(names, found):
    assert time_column("a.csv", [field_of(name, "") for name in names]) == found


def test_a_table_without_a_time_column_is_refused():
    with pytest.raises(LogError, match=r"a\.csv: no time column; .* the columns are: x, thyme"):
        time_column("a.csv", [field_of(name, "") for name in ("x", "thyme")])


@pytest.mark.parametrize(
    ("text", "factor", "ns"),
    [
        ("1.5", 10**9, 1_500_000_000), ("1760000000123456789", 0, 1_760_000_000_123_456_789), ("1760000000.5", 0, 1_760_000_000_500_000_000),
        ("1760000000123", 0, 1_760_000_000_123_000_000), ("2026-01-01T00:00:00Z", 0, 1_767_225_600 * 10**9), ("nan", 0, None),
        ("soon", 0, None), ("inf", 1, None), ("1e300", 1, None), ("9" * 400, 1, None),
    ],
)  # fmt: skip
def test_stamps(text, factor, ns):
    assert stamp_of(text, factor) == ns
