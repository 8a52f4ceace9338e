"""The newest of each port, whether its samples are made or rows."""

from __future__ import annotations

import weakref

from unit.ports.test_sample_batch import SAMPLES, batch, full

from uwserver.ports import Sample
from uwserver.ports.sample_batch import SampleBatch
from uwserver.simulation.newest import Newest


def test_the_newest_counts_made_or_not():
    newest = Newest()
    newest.put([Sample("rov/imu", 6, 90, 90, True, ((0.0, 0.0, 0.0), 1)), Sample("rov/depth", 1, 90, 90, True, (1.0,))])
    newest.put(batch())
    assert dict(newest) == {
        "rov/imu": SAMPLES[2], "rov/state": SAMPLES[1], "rov/depth": Sample("rov/depth", 1, 90, 90, True, (1.0,)),
    }  # fmt: skip
    last = Sample("rov/imu", 9, 120, 120, True, ((0.0, 0.0, 0.0), 1))
    newest.put([SAMPLES[0], last])
    assert newest["rov/imu"] == last
    assert newest.get("rov/gps") is None


def test_what_is_not_kept_is_forgotten():
    newest = Newest()
    newest.put(batch())
    newest.keep(lambda path: path == "rov/state")
    assert list(newest) == ["rov/state"]
    assert len(newest) == 1
    newest.clear()
    assert "rov/state" not in newest


def test_a_slow_port_does_not_keep_all_that_was_told_with_its_newest():
    newest, origins = Newest(), batch().origins
    logs = [full() for _ in range(3)]
    kept = [weakref.ref(log.entries) for log in logs]
    newest.put(batch(logs[0]))
    for log in logs[1:]:
        newest.put(SampleBatch(origins, log, 2, 3))  # one port alone goes on
    del log
    logs.clear()
    assert newest["rov/state"] == SAMPLES[1]
    assert newest["rov/imu"] == SAMPLES[0]
    assert [array() is None for array in kept] == [True, True, False]
