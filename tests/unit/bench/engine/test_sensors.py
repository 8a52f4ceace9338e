"""Pictures are measured by day, by lamps, as depth and as ids, each against its bar; and the scene shows something."""

from __future__ import annotations

import pytest
from uwserver_bench.engine.sensors import bench_cameras


@pytest.mark.slow
def test_a_row_for_each_case() -> None:
    rows = bench_cameras(quick=True, say=lambda line: None)
    assert [row.at_least for row in rows] == [10.0, None, 20.0, None]
    assert all(len(row.values) == 2 and min(row.values) > 0.0 for row in rows)
