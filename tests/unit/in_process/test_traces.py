"""Recordings as arrays: what they hold, what their columns are called, when they are made, and where they end or begin anew."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import uwserver
from uwserver.in_process.traces import Trace, Traces, chosen
from uwserver.ports import Buffer, Field, Layout, Port, Refused, Sample


@pytest.fixture(scope="module")
def loaded():
    with uwserver.load("bluerov2_pool") as loaded:
        yield loaded


@pytest.fixture
def world(loaded):
    loaded.reset()
    yield loaded
    for traces in list(loaded._traces):
        traces.stop()


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
    assert {"depth", "columns"} < set(dir(depth))


def test_columns_are_what_a_data_frame_takes_and_have_the_names_of_axes(world):
    dive = world.record("bluerov2/mocap", "bluerov2/ahrs", "bluerov2/imu")
    world.step(60)
    columns = dive["bluerov2/mocap"].columns()
    assert list(columns) == ["t", "valid", "p_NS_x", "p_NS_y", "p_NS_z", "q_NS_w", "q_NS_x", "q_NS_y", "q_NS_z"]
    assert {column.shape for column in columns.values()} == {(len(dive["bluerov2/mocap"]),)}
    np.testing.assert_array_equal(columns["p_NS_z"], dive["bluerov2/mocap"]["p_NS"][:, 2])
    assert {"f_S_x", "f_S_y", "f_S_z", "temperature"} < set(dive["bluerov2/imu"].columns())
    settling = dive["bluerov2/ahrs"]
    assert not settling.valid.any()
    assert np.isnan(settling.heading).all()


def test_arrays_are_made_once_and_grow_by_what_is_new(world):
    depth = world.record("bluerov2/depth")["bluerov2/depth"]
    world.step(240)
    first = depth.depth
    assert np.shares_memory(depth.depth, first)
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 0.0
    kept = first.copy()
    for _ in range(3):
        world.step(240)
        np.testing.assert_array_equal(depth.depth, [sample.value[0] for sample in depth.samples])
        np.testing.assert_array_equal(depth.t, [sample.t_ns / 1e9 for sample in depth.samples])
    np.testing.assert_array_equal(first, kept)


def test_each_sample_is_converted_once(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "uwserver.in_process.traces.as_array", lambda field, value: asked.append(value) or np.array(value)
    )
    trace = Trace(Port("a/b", "sensor", "x", (Field("x", "m", "x"),), "x"))
    for k in range(200):
        trace.take(Sample("a/b", k, k, k, True, (float(k),)))
        assert trace.x[-1] == k
    assert len(asked) == 200


def test_pictures_of_different_sizes_are_an_array_of_arrays():
    port = Port(
        "a/b",
        "sensor",
        "x",
        (Field("p", "1", "", type="buffer", buffer=Layout("uint8", (-1, -1))), Field("to", "1", "", type="str")),
        "x",
    )
    trace = Trace(port)
    assert trace.p.shape == (0,)
    for k, size in enumerate((2, 2, 3)):
        picture = Buffer.of(np.full((size, 4), k, dtype=np.uint8))
        trace.take(Sample("a/b", k, k, k, True, (picture, "x" * k)))
        assert trace.p.shape == ((k + 1, 2, 4) if size == 2 else (3,))
    assert [each.shape for each in trace.p] == [(2, 4), (2, 4), (3, 4)]
    assert trace.p[2].max() == 2
    assert trace.to.tolist() == ["", "x", "xx"]
    assert list(trace.columns()) == ["t", "valid", "to"]


def test_it_ends_by_stop_or_with_its_block(world):
    with world.record("bluerov2/depth") as dive:
        world.step(48)
    world.step(48)
    other = world.record()
    world.step(48)
    other["bluerov2/imu"].stop()
    world.step(48)
    other.stop()
    other.stop()
    world.step(48)
    assert len(dive["bluerov2/depth"]) == pytest.approx(9, abs=1)
    assert dive["bluerov2/depth"].t[-1] < 0.2 < other["bluerov2/depth"].t[0] + 0.25
    assert len(other["bluerov2/depth"]) in (18, 19, 20)
    assert len(other["bluerov2/imu"]) == pytest.approx(24, abs=1)


@pytest.mark.parametrize("how", ["reset", "seed", "restore", "load"])
def test_no_array_runs_back_in_time(world, how):
    """It begins anew when the time is set, whichever way; what was stopped before stays."""
    world.step(24)
    state, _ = world.save(), world.call("world/snapshot")
    dive, stopped = world.record("bluerov2/imu"), world.record("bluerov2/imu")
    world.step(48)
    stopped.stop()
    count = len(stopped["bluerov2/imu"])
    set_back = {
        "reset": world.reset, "seed": lambda: world.reset(seed=9), "restore": lambda: world.call("world/restore"), "load": lambda: world.load(state)
    }  # fmt: skip
    set_back[how]()
    assert len(dive["bluerov2/imu"]) == 0
    world.step(24)
    imu = dive["bluerov2/imu"]
    assert (np.diff(imu.t) > 0).all()
    assert len(imu) == len(imu.f_S) == len(imu.columns()["f_S_x"]) == pytest.approx(12, abs=1)
    assert len(stopped["bluerov2/imu"]) == count
    world.reset(seed=1)


def test_clear_begins_anew_and_leaves_what_was_read(world):
    dive = world.record("bluerov2/depth", "bluerov2/imu")
    world.step(48)
    before = dive["bluerov2/depth"].depth
    dive["bluerov2/depth"].clear()
    assert len(dive["bluerov2/depth"]) == 0 < len(dive["bluerov2/imu"])
    assert len(before) > 0
    world.step(24)
    assert dive["bluerov2/depth"].t[0] > 0.18
    dive.clear()
    assert len(dive["bluerov2/imu"].w_S) == 0


def test_a_frame_needs_pandas_and_says_so(world, monkeypatch):
    dive = world.record("bluerov2/imu")
    world.step(24)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        dive["bluerov2/imu"].to_frame()


def test_a_frame_has_the_columns(world, monkeypatch):
    """Of pandas, which the tests do not need, one call is made."""

    class Pandas:
        DataFrame = dict

    dive = world.record("bluerov2/imu")
    world.step(24)
    monkeypatch.setitem(sys.modules, "pandas", Pandas)
    frame = dive["bluerov2/imu"].to_frame()
    assert frame.keys() == dive["bluerov2/imu"].columns().keys()
    np.testing.assert_array_equal(frame["f_S_z"], dive["bluerov2/imu"].f_S[:, 2])


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
    assert [port.path for port in chosen(world.ports, ["*/depth"])] == ["bluerov2/depth"]
    assert repr(Traces([], [])) == ""
