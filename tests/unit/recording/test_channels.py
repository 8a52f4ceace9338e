"""Ports as a recording's schemas tell them."""

from __future__ import annotations

import json

import pytest

from uwserver.ports import Field, Layout, Port
from uwserver.recording.channels import Column, described, port_schema

FIELDS = (
    Field("heading", "rad", "which way"),
    Field("q_NB", "1", "attitude", "NB", (4,)),
    Field("name", "1", "of it", type="str"),
    Field("on", "1", "switch", type="bool"),
    Field("picture", "1", "picture", type="buffer", buffer=Layout("uint8", (-1, 2))),
    Field("n", "1", "count", type="int"),
)


def test_a_port_comes_back_from_its_schema():
    schema = json.dumps(port_schema(Port("rov/x", "sensor", "x", FIELDS, "X."))).encode()
    found = described("rov/x", {"direction": "sensor"}, schema)
    assert found is not None
    assert found.columns == (
        Column("heading", "rad", "number"), Column("q_NB", "1", "number", 4), Column("name", "1", "string"),
        Column("on", "1", "boolean"), Column("picture", "1", "object"), Column("n", "1", "integer"),
    )  # fmt: skip
    assert [c.is_quaternion for c in found.columns] == [False, True, False, False, False, False]
    assert [c.is_word for c in found.columns] == [False, False, True, True, True, False]


@pytest.mark.parametrize(
    "schema", [b"", b"{", b"[]", b'{"properties": {"value": {"properties": {"x": {}}}}}', b'{"properties": 3}']
)
def test_another_schema_is_none_of_a_port(schema: bytes):
    assert described("rov/x", {"direction": "sensor"}, schema) is None


def test_a_channel_of_no_port_is_none():
    assert described("uwserver/hashes", {}, b"{}") is None


SENSOR = Port(
    "rov/eye", "sensor", "eye",
    (
        Field("range", "m", "distance"),
        Field("w_S", "rad/s", "rate", "S", (3,)),
        Field("matrix", "1", "matrix", shape=(2, 3)),
        Field("name", "1", "of what is seen", type="str"),
        Field("picture", "1", "picture", type="buffer", buffer=Layout("uint8", (-1, 2))),
    ),
    "Eye.", 10.0,
)  # fmt: skip
ACTUATOR = Port("rov/arm", "actuator", "arm", (Field("angle", "rad", "of the joint"),), "Arm.")


def test_the_schema_of_a_port_names_units_frames_and_shapes():
    schema = port_schema(SENSOR)["properties"]["value"]["properties"]
    assert schema["range"]["description"] == "distance; unit m"
    assert schema["w_S"]["description"] == "rate; unit rad/s; frame S"
    assert (schema["w_S"]["minItems"], schema["w_S"]["maxItems"]) == (3, 3)
    assert schema["matrix"]["description"].endswith("row-major, shape 2x3")
    assert schema["name"]["type"] == ["string", "null"]
    assert schema["picture"]["properties"]["dtype"] == {"const": "uint8"}
    assert set(port_schema(ACTUATOR)["properties"]) == {"tick", "source", "value"}


def test_the_schema_of_a_matrix_and_of_a_scalar() -> None:
    fields = (Field("m", "T", "a matrix", "S", (2, 3)), Field("ok", "1", "a flag", type="bool"))
    value = port_schema(Port("rov/x", "sensor", "x", fields, "doc"))["properties"]["value"]["properties"]
    assert value["m"]["description"] == "a matrix; unit T; frame S; row-major, shape 2x3"
    assert value["m"]["maxItems"] == 6
    assert value["ok"] == {"type": ["boolean", "null"], "description": "a flag; unit 1"}
