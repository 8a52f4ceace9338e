"""Logs of MOOS."""

import numpy as np
import pytest

from uwserver.logfiles import LogError, open_log

HEAD = """%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%
%% LOG FILE:       ./MOOSLog.alog
%% FILE OPENED ON  Wed Apr 29 2015
%% LOGSTART           1760000000.25
%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%%
"""
LINES = """0.10000         NAV_X            uSimMarine      1.5
0.20000         NAV_HEADING      uSimMarine      359.9
0.15000         DEPLOY           pMarineViewer:me  true
0.30000         NODE_REPORT_LOCAL  pNodeReporter  NAME=alpha,TYPE=UUV,X=12.5,Y=-3,HDG=90
0.40000         NAV_X            uSimMarine      1e400
0.50000         EMPTY            pX
0.60000         NAV_X            uSimMarine      nan
"""


def opened(tmp_path, text, name="run.alog"):
    file = tmp_path / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return open_log(file)


def test_postings_become_data(tmp_path):
    log = opened(tmp_path, HEAD + LINES)
    data = list(log.read())
    assert log.kind == "alog"
    assert log.epoch_ns == 1_760_000_000_350_000_000
    assert [(d.t_ns, d.topic) for d in data[:3]] == [(0, "NAV_X"), (50_000_000, "DEPLOY"), (100_000_000, "NAV_HEADING")]
    assert data[0].value == {"value": 1.5, "source": "uSimMarine"}
    assert data[1].value == {"value": "true", "source": "pMarineViewer:me"}
    report = next(d for d in data if d.topic == "NODE_REPORT_LOCAL").value
    assert (report["NAME"], report["X"], report["HDG"]) == ("alpha", 12.5, 90.0)
    assert next(d for d in data if d.topic == "EMPTY").value["value"] == ""
    assert log.topics["NAV_HEADING"].fields[0].unit == "deg"
    assert log.topics["NAV_X"].count == 3


def test_lines_that_are_no_postings_are_told(tmp_path):
    log = opened(tmp_path, HEAD + LINES + "and a continued value\n1e300 FAR pX 1\n0.7 HALF")
    assert log.remarks == ("3 lines are no postings and were skipped",)


def test_a_warped_clock_has_no_utc(tmp_path):
    log = opened(tmp_path, HEAD.replace("1760000000.25", "17600000000.25") + LINES)
    assert log.epoch_ns is None
    assert "time warp" in log.remarks[0]


def test_the_last_line_may_be_cut_anywhere(tmp_path):
    text = HEAD + LINES
    whole = list(opened(tmp_path, text).read())
    for cut in range(len(HEAD) + 60, len(text), 3):
        log = opened(tmp_path, text[:cut])
        some = sorted(log.read(), key=lambda d: d.t_ns)
        assert len(some) <= len(whole)
        log.close()


def test_hostile_bytes_never_crash(tmp_path):
    rng = np.random.default_rng(1)
    base = (HEAD + LINES).encode()
    for _ in range(200):
        hurt = bytearray(base)
        for at in rng.integers(len(HEAD), len(base), 8):
            hurt[at] = int(rng.integers(0, 256))
        log = opened(tmp_path, bytes(hurt))
        times = [d.t_ns for d in log.read()]
        assert times == sorted(times)


def test_no_posting_at_all(tmp_path):
    with pytest.raises(LogError, match="no line is a posting"):
        opened(tmp_path, HEAD)


def test_a_long_line_is_refused(tmp_path):
    from uwserver.logfiles import Limits

    file = tmp_path / "long.alog"
    file.write_bytes(HEAD.encode() + b"0.1 A b " + b"x" * (1 << 24) + b"\n")
    with pytest.raises(LogError, match="the line at byte 189 has"):
        open_log(file, Limits(record_bytes=1 << 20))
