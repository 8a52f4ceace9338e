"""Arrays of what sensors said while the world was stepped."""

from __future__ import annotations

import numpy as np
import pytest

import uwserver
from uwserver.ports import Refused


@pytest.fixture
def world():
    return uwserver.load("bluerov2_pool")


def test_what_is_recorded_is_what_was_delivered(world):
    world.step(24)
    dive = world.record("bluerov2/depth", "bluerov2/truth/*")
    samples = world.step(240)
    assert set(dive) == {"bluerov2/depth", *(path for path in world.ports if "/truth/" in path)}
    own = [sample for sample in samples if sample.port == "bluerov2/depth"]
    depth = dive["bluerov2/depth"]
    assert len(depth) == len(own) == 48
    np.testing.assert_array_equal(depth.t, [sample.t_ns / 1e9 for sample in own])
    np.testing.assert_array_equal(depth.depth, [sample.value[0] for sample in own])
    assert dive["bluerov2/truth/pose"].p_NB.shape == (20, 3)
    assert depth.valid.all()


def test_columns_are_what_a_data_frame_takes(world):
    dive = world.record("bluerov2/mocap", "bluerov2/ahrs")
    world.step(60)
    columns = dive["bluerov2/mocap"].columns()
    assert list(columns) == ["t", "valid", "p_NS_0", "p_NS_1", "p_NS_2", "q_NS_0", "q_NS_1", "q_NS_2", "q_NS_3"]
    assert {column.shape for column in columns.values()} == {(len(dive["bluerov2/mocap"]),)}
    np.testing.assert_array_equal(columns["p_NS_2"], dive["bluerov2/mocap"]["p_NS"][:, 2])
    settling = dive["bluerov2/ahrs"]
    assert not settling.valid.any()
    assert np.isnan(settling.heading).all()


def test_it_ends_by_stop_or_with_its_block(world):
    with world.record("bluerov2/depth") as dive:
        world.step(48)
    world.step(48)
    other = world.record()
    world.step(48)
    other.stop()
    other.stop()
    world.step(48)
    assert len(dive["bluerov2/depth"]) == pytest.approx(9, abs=1)
    assert dive["bluerov2/depth"].t[-1] < 0.2 < other["bluerov2/depth"].t[0] + 0.25
    assert len(other["bluerov2/depth"]) in (9, 10)


def test_before_the_first_sample_there_are_empty_arrays(world):
    dive = world.record("bluerov2/mocap")
    assert dive["bluerov2/mocap"].p_NS.shape == (0, 3)
    assert "0 samples of p_NS, q_NS" in repr(dive)
    with pytest.raises(AttributeError, match='no field "p_NB"'):
        dive["bluerov2/mocap"].p_NB  # noqa: B018
    with pytest.raises(KeyError, match="is not recorded"):
        dive["bluerov2/depth"]


def test_what_no_sensor_matches_is_refused(world):
    with pytest.raises(Refused, match="no sensor matches bluerov2/thrusters; there are: bluerov2/imu"):
        world.record("bluerov2/thrusters")
