"""Samples by the names of their fields, in a process that steps the world itself; and what a world says of itself."""

from __future__ import annotations

import numpy as np
import pytest

import uwserver
from uwserver.ports import Buffer, Field, Layout, Port, Refused, Sample
from uwserver.world.reading import Reading


@pytest.fixture(scope="module")
def world():
    world = uwserver.load("bluerov2_pool")
    world.step(240)
    return world


def test_fields_are_attributes_and_items(world):
    reading = world.read("bluerov2/mocap")
    assert reading.p_NS == reading["p_NS"] == reading.value[0]
    assert list(reading) == ["p_NS", "q_NS"]
    np.testing.assert_array_equal(reading.array("p_NS"), reading.value[0])
    assert world.read("bluerov2/depth").depth == pytest.approx(1.0, abs=0.2)
    assert reading.t_s == reading.t_ns / 1e9
    with pytest.raises(AttributeError, match='no field "p_NB"; there are: p_NS, q_NS'):
        reading.p_NB  # noqa: B018
    with pytest.raises(KeyError):
        reading["p_NB"]


def test_a_reading_equals_its_sample(world):
    reading = world.read("bluerov2/depth")
    assert reading == reading.sample
    assert reading == world.read("bluerov2/depth")
    assert reading != world.read("bluerov2/mocap")
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


def test_what_a_world_and_a_vehicle_say_of_themselves(world):
    assert repr(world) == "<World bluerov2_pool at 1.000 s (tick 240): bluerov2; 10 sensors, 4 actuators>"
    assert repr(world.vehicles["bluerov2"]).startswith("<bluerov2 (bluerov2_heavy): p_NB = (0.000, 0.000, 1.0")
    assert repr(world.read("bluerov2/depth")).startswith("<bluerov2/depth at 0.9")


@pytest.mark.parametrize("n", [0, -1])
def test_less_than_a_tick_is_refused_and_changes_nothing(world, n):
    before = world.tick
    with pytest.raises(Refused, match=f"step takes 1 tick or more, not {n}"):
        world.step(n)
    assert world.tick == before
