"""Samples by the names of their fields, and arrays of them, in a process that steps the world itself; and what a world says of itself."""

from __future__ import annotations

import numpy as np
import pytest

import uwserver
from uwserver.ports import Buffer, Field, Layout, Port, Refused, Sample
from uwserver.world.in_process import Reading


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


@pytest.fixture(scope="module")
def stepped():
    stepped = uwserver.load("bluerov2_pool")
    stepped.step(240)
    return stepped


def test_fields_are_attributes_and_items(stepped):
    reading = stepped.read("bluerov2/mocap")
    assert reading.p_NS == reading["p_NS"] == reading.value[0]
    assert list(reading) == ["p_NS", "q_NS"]
    np.testing.assert_array_equal(reading.array("p_NS"), reading.value[0])
    assert stepped.read("bluerov2/depth").depth == pytest.approx(1.0, abs=0.2)
    assert reading.t_s == reading.t_ns / 1e9
    with pytest.raises(AttributeError, match='no field "p_NB"; there are: p_NS, q_NS'):
        reading.p_NB  # noqa: B018
    with pytest.raises(KeyError):
        reading["p_NB"]


def test_a_reading_equals_its_sample(stepped):
    reading = stepped.read("bluerov2/depth")
    assert reading == reading.sample
    assert reading == stepped.read("bluerov2/depth")
    assert reading != stepped.read("bluerov2/mocap")
    assert hash(reading) == hash(reading.sample)
    assert (reading.port, reading.valid, reading.seq) == ("bluerov2/depth", True, reading.sample.seq)
    assert reading.t_sent_ns > reading.t_ns


def test_a_missing_number_is_nan_in_arrays_and_a_picture_is_itself():
    fields = (
        Field("range", "m", "range"), Field("ok", "1", "fine", type="bool"), Field("v_S", "m/s", "velocity", "S", (3,)),
        Field("picture", "1", "echoes", type="buffer", buffer=Layout("uint8", (-1, 2))), Field("to", "1", "name", type="str"),
    )  # fmt: skip
    picture = Buffer.of(np.array([[1, 2], [3, 4]], dtype=np.uint8))
    reading = Reading(
        Port("a/b", "sensor", "x", fields, "x"), Sample("a/b", 0, 0, 0, False, (None, True, None, picture, "x"))
    )
    assert np.isnan(reading.array("range"))
    assert np.isnan(reading.array("v_S")).tolist() == [True] * 3
    assert reading.array("picture").tolist() == [[1, 2], [3, 4]]
    assert reading.array("to").item() == "x"
    assert "invalid" in repr(reading)


def test_what_a_world_and_a_vehicle_say_of_themselves(stepped):
    assert repr(stepped) == "<World bluerov2_pool at 1.000 s (tick 240): bluerov2; 10 sensors, 4 actuators>"
    assert repr(stepped.vehicles["bluerov2"]).startswith("<bluerov2 (bluerov2_heavy): p_NB = (0.000, 0.000, 1.0")
    assert repr(stepped.read("bluerov2/depth")).startswith("<bluerov2/depth at 0.9")


@pytest.mark.parametrize("n", [0, -1])
def test_less_than_a_tick_is_refused_and_changes_nothing(stepped, n):
    before = stepped.tick
    with pytest.raises(Refused, match=f"step takes 1 tick or more, not {n}"):
        stepped.step(n)
    assert stepped.tick == before
