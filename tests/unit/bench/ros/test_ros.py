"""The part ros of the benchmark: it runs, and every figure is one."""

from __future__ import annotations

import pytest
from uwserver_bench.ros.ros import bench_messages, bench_peers


def test_every_figure_is_measured():
    pytest.importorskip("rosbags")
    said = []
    rows = bench_messages(True, said.append)
    assert said == ["ros: messages"]
    names = [row.name for row in rows]
    assert "CDR of an Imu" in names
    assert len(names) == 5
    for row in rows:
        assert row.values or row.note
        assert all(value < 1e6 for value in row.values)


@pytest.mark.slow
def test_peers_hear_on_each_carrier():
    pytest.importorskip("rosbags")
    said = []
    rows = {row.name: row for row in bench_peers(True, said.append)}
    assert said == ["ros: peers, repeat 1 of 1"]
    assert len(rows) == 8
    for row in rows.values():
        assert row.values or row.note
        assert all(0.0 < value < 1e6 for value in row.values)
