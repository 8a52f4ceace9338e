"""The newest of each port, whether its samples are made or rows."""

from __future__ import annotations

from unit.ports.test_told import SAMPLES, told

from uwserver.ports import Sample
from uwserver.simulation.newest import Newest


def test_the_newest_counts_made_or_not():
    newest = Newest()
    newest.put([Sample("rov/imu", 6, 90, 90, True, ((0.0, 0.0, 0.0), 1)), Sample("rov/depth", 1, 90, 90, True, (1.0,))])
    newest.put(told())
    assert dict(newest) == {
        "rov/imu": SAMPLES[2], "rov/state": SAMPLES[1], "rov/depth": Sample("rov/depth", 1, 90, 90, True, (1.0,)),
    }  # fmt: skip
    last = Sample("rov/imu", 9, 120, 120, True, ((0.0, 0.0, 0.0), 1))
    newest.put([SAMPLES[0], last])
    assert newest["rov/imu"] == last
    assert newest.get("rov/gps") is None


def test_what_is_not_kept_is_forgotten():
    newest = Newest()
    newest.put(told())
    newest.keep(lambda path: path == "rov/state")
    assert list(newest) == ["rov/state"]
    assert len(newest) == 1
    newest.clear()
    assert "rov/state" not in newest
