"""One time base, whatever a clock did."""

import numpy as np
import pytest

from uwserver.logfiles.timebase import gaps, time_base, utc_ns, utc_text

S = 1_000_000_000
UTC = 1_760_000_000 * S


def stamps(*seconds):
    return np.array([round(s * S) for s in seconds], np.int64)


def clock(begin, count=40, period=0.1):
    return [begin + k * period for k in range(count)]


def test_times_begin_at_the_first_entry():
    base = time_base(stamps(*clock(5.0)) + UTC, utc=True)
    assert base.t_ns[0] == 0
    assert base.epoch_ns == UTC + 5 * S
    assert base.remarks == ()


def test_entries_that_were_written_late_are_sorted():
    base = time_base(stamps(10.0, 10.2, 10.1, 9.9, 10.3), utc=False)
    assert (base.t_ns[base.order] / S).round(3).tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert base.remarks == ()
    assert base.epoch_ns is None


def test_a_clock_that_was_set_back_goes_on():
    base = time_base(stamps(*clock(100.0), *clock(0.0)), utc=False)
    t = base.t_ns / S
    assert t[39] == pytest.approx(3.9)
    assert t[40] == pytest.approx(3.9)
    assert t[79] == pytest.approx(7.8)
    assert (np.diff(base.t_ns[base.order]) >= 0).all()
    assert base.remarks[0] == "the clock was set back by 103.900 s at 3.900 s"
    assert len(base.remarks) == 2


def test_a_clock_that_was_set_by_gps_gives_the_epoch():
    """Before it there is no UTC: it is computed back, and told."""
    base = time_base(np.concatenate([stamps(*clock(0.0)), stamps(*clock(0.0)) + UTC]), utc=True)
    assert base.epoch_ns == UTC - round(3.9 * S)
    assert base.t_ns[-1] == pytest.approx(7.8 * S)
    assert any("set ahead" in r for r in base.remarks)
    assert any("computed back" in r for r in base.remarks)


def test_a_damaged_stamp_is_no_reset():
    times = clock(50.0)
    times[10], times[20] = 4e9, 1.0
    base = time_base(stamps(*times), utc=False)
    t = base.t_ns / S
    assert t[-1] == pytest.approx(3.9)
    assert t[10] == pytest.approx(0.9)
    assert t[20] == pytest.approx(1.9)
    assert len(base.remarks) == 1
    assert "2 entries have stamps that contradict their neighbours" in base.remarks[0]


def test_many_resets_are_told_shortly():
    base = time_base(stamps(*(clock(100.0) * 40)), utc=False)
    assert len(base.remarks) == 10
    assert "and 31 more of these" in base.remarks


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_stamps_are_time_never_runs_back(seed):
    rng = np.random.default_rng(seed)
    raw = rng.integers(-(1 << 63), 1 << 63, 500, dtype=np.int64)
    raw[rng.integers(0, 500, 300)] = UTC
    base = time_base(raw, utc=True)
    ordered = base.t_ns[base.order]
    assert (np.diff(ordered) >= 0).all()
    assert ordered[0] == 0


def test_nothing_has_no_time():
    assert len(time_base(np.zeros(0, np.int64), utc=True).t_ns) == 0


def test_gaps():
    t = stamps(*clock(0.0), *clock(10.0), *clock(17.0))
    assert gaps("imu", t) == ["imu: no data for 6.100 s from 3.900 s, and 1 shorter gaps"]
    assert gaps("imu", stamps(*clock(0.0))) == []


def test_instants():
    assert utc_ns("2026-01-01T00:00:00Z") == 1_767_225_600 * S
    assert utc_text(utc_ns("2026-11-23T05:00:00.250Z")) == "2026-11-23T05:00:00.250Z"
    assert utc_ns("yesterday") is None
    assert utc_text(1 << 62) == "2116-02-20T23:53:38.427Z"
