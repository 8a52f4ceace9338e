"""The JSON Schemas of scenario, vehicle and device files: they are schemas, fit the shipped files and see faults. Git does not keep them."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import jsonschema
import pytest

from uwserver.scenario.authoring.json_schema import FILES, FileKind, json_schema
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.sensors import SensorConfig


@cache
def schema_of(kind: FileKind) -> Any:
    return json.loads(json_schema(kind))


@pytest.mark.parametrize("kind", FILES)
def test_each_kind_of_file_has_a_schema(kind: FileKind) -> None:
    schema = schema_of(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert len(schema["$defs"]) > 10


@pytest.mark.parametrize(("kind", "folder"), [("scenario", ""), ("vehicle", "vehicles")])
def test_shipped_files_fit_their_schema(kind: FileKind, folder: str) -> None:
    validator = jsonschema.Draft202012Validator(schema_of(kind))
    for name, path in shipped(folder).items():
        assert [error.message for error in validator.iter_errors(read(path).raw)] == [], name
    assert not validator.is_valid({**read(path).raw, "shcema": 1})


@pytest.fixture(scope="module")
def devices() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema_of("device"))


@pytest.mark.parametrize("name", shipped("devices"))
def test_device_files_fit_their_schema(name, devices):
    assert [error.message for error in devices.iter_errors(read(shipped("devices")[name]).raw)] == []


def test_the_schema_of_devices_knows_the_keys_of_each_kind_of_sensor(devices):
    for kind, struct in kinds_of(SensorConfig).items():
        for key in ("rate_hz", struct.__struct_fields__[0], struct.__struct_fields__[-1]):
            group = {"source": "a data sheet", "status": "datasheet", f"{key}s_": 1.0}
            device = {"schema": 1, "kind": kind, "name": "x", "title": "X", "properties": {"a": group}}
            assert not devices.is_valid(device), (kind, key)
        assert devices.is_valid({**device, "properties": {}})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('kind = "dvl"', 'kind = "dwl"'),
        ('status = "datasheet"', 'status = "sure"'),
        ("beam_angle_deg = 22.5", 'beam_angle_deg = "22.5"'),
        ("source = ", "sauce = "),
        ("schema = 1", "schema = 2"),
    ],
)
def test_the_schema_of_devices_sees_faults(old, new, devices, tmp_path):
    text = shipped("devices")["a50"].read_text()
    assert old in text
    path = tmp_path / "a50.toml"
    path.write_text(text.replace(old, new, 1))
    assert not devices.is_valid(read(path).raw)
