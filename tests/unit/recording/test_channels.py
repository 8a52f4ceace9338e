"""Ports as a recording's schemas tell them."""

from __future__ import annotations

import json

import pytest

from uwserver.ports import Field, Layout, Port
from uwserver.recording.channels import Column, described
from uwserver.recording.schemas import port_schema

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
