"""The newest sample of a sensor by the names of its fields."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.ports import Buffer, Field, Layout, Port, Sample
from uwserver.world.sensing.reading import Reading, as_array


@pytest.fixture
def stepped(world):
    world.step(240)
    return world


def test_fields_are_attributes_and_items(stepped):
    reading = stepped.read("rov/truth/pose")
    np.testing.assert_array_equal(reading.p_NB, reading.value[0])
    np.testing.assert_array_equal(reading["q_NB"], reading.value[1])
    assert list(reading) == ["p_NB", "q_NB"]
    assert {"p_NB", "q_NB", "valid"} < set(dir(reading))
    np.testing.assert_array_equal(reading.array("p_NB"), reading.value[0])
    assert reading.t_s == reading.t_ns / 1e9
    with pytest.raises(ValueError, match="read-only"):
        reading.p_NB[0] = 1.0
    with pytest.raises(AttributeError, match='no field "p_NS"; there are: p_NB, q_NB'):
        reading.p_NS  # noqa: B018
    with pytest.raises(KeyError):
        reading["p_NS"]


def test_a_reading_equals_its_sample(stepped):
    reading = stepped.read("rov/truth/pose")
    assert reading == reading.sample
    assert reading == stepped.read("rov/truth/pose")
    assert reading != stepped.read("rov/truth/velocity")
    assert hash(reading) == hash(reading.sample)
    assert (reading.port, reading.valid, reading.seq) == ("rov/truth/pose", True, reading.sample.seq)
    assert stepped.read("rov/late_imu").t_sent_ns > stepped.read("rov/late_imu").t_ns
    assert repr(reading).startswith("<rov/truth/pose at 1.000000 s, p_NB = (")


def test_a_missing_number_is_nan_and_a_picture_is_itself():
    fields = (
        Field("range", "m", "range"), Field("ok", "1", "fine", type="bool"), Field("v_S", "m/s", "velocity", "S", (3,)),
        Field("picture", "1", "echoes", type="buffer", buffer=Layout("uint8", (-1, 2))), Field("to", "1", "name", type="str"),
        Field("count", "1", "echoes", type="int"), Field("part", "m", "some", shape=(2,)),
    )  # fmt: skip
    picture = Buffer.of(np.array([[1, 2], [3, 4]], dtype=np.uint8))
    value = (None, True, None, picture, "x", None, (1.0, None))
    reading = Reading(Port("a/b", "sensor", "x", fields, "x"), Sample("a/b", 0, 0, 0, False, value))
    assert math.isnan(reading.range)
    assert np.isnan(reading.array("range"))
    assert reading.ok is True
    assert np.isnan(reading.v_S).tolist() == [True] * 3
    assert reading.picture is picture
    assert reading.array("picture").tolist() == [[1, 2], [3, 4]]
    assert reading.to == reading.array("to").item() == "x"
    assert reading.count is None
    np.testing.assert_array_equal(reading.part, [1.0, np.nan])
    assert reading.value == value
    assert "invalid, range = None" in repr(reading)
    assert as_array(fields[2], (1, 2, 3)).dtype == float
