"""The part ros of the benchmark: it runs, and every figure is one."""

from __future__ import annotations

import pytest
from uwserver_bench.ros import bench_ros


def test_every_figure_is_measured():
    pytest.importorskip("rosbags")
    said = []
    rows = bench_ros(True, said.append)
    assert said == ["ros: messages"]
    names = [row.name for row in rows]
    assert "CDR of an Imu" in names
    assert len(names) == 5
    for row in rows:
        assert row.values or row.note
        assert all(value < 1e6 for value in row.values)
