"""What the schemas of a recording's channels say."""

from __future__ import annotations

from uwserver.ports import Field, Layout, Port
from uwserver.recording.schemas import port_schema

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
