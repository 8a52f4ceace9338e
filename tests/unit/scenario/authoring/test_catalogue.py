"""The kinds that `uwserver list` and the reference pages show, and the JSON Schemas of all files.

The schemas fit the shipped files and see faults. Git does not keep them.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Annotated, Any

import jsonschema
import pytest
from msgspec import UNSET, Meta, Struct, UnsetType, field

from uwserver.modifiers import ModifierConfig
from uwserver.scenario.authoring.catalogue import (
    FILES,
    FileKind,
    first_sentence,
    json_schema,
    keys_of,
    modifier_kinds,
    sensor_kinds,
)
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.sensors import DvlConfig, PressureConfig, SensorConfig, SensorTable
from uwserver.table import Table


@pytest.fixture(scope="module")
def kinds():
    return sensor_kinds()


def test_all_kinds_are_there_in_the_order_of_the_union(kinds) -> None:
    assert list(kinds) == list(kinds_of(SensorConfig))
    assert all(kind.kind == name for name, kind in kinds.items())
    assert kinds["dvl"].table is DvlConfig
    assert modifier_kinds() == kinds_of(ModifierConfig)


def test_each_kind_has_an_example_with_fields_and_a_sentence(kinds) -> None:
    for kind in kinds.values():
        assert kind.outputs, f'"{kind.kind}" is missing in one_of_everything'
        for output in kind.outputs:
            assert output.fields
            assert output.doc
            assert output.example


def test_a_kind_that_a_key_turns_into_another_has_two_outputs(kinds) -> None:
    names = {tuple(f.name for f in output.fields) for output in kinds["pressure"].outputs}
    assert {"pressure", "depth"} <= {name for fields in names for name in fields}
    assert len(kinds["pressure"].outputs) == 2


def test_settings_are_those_of_the_service(kinds) -> None:
    (output,) = kinds["ctd"].outputs
    assert isinstance(output.settings, tuple)
    assert any(output.settings for kind in kinds.values() for output in kind.outputs)


# -- device files -----------------------------------------------------------------------------------------------------------------------


def test_all_device_files_of_sensors_are_listed_with_their_kind(kinds) -> None:
    listed = {device.name: kind.kind for kind in kinds.values() for device in kind.devices}
    files = {name: read(path).raw for name, path in shipped("devices").items()}
    assert listed == {name: raw["kind"] for name, raw in files.items() if "properties" in raw}
    assert "a50" in listed
    assert "t200" not in listed


def test_values_of_a_device_have_their_provenance(kinds) -> None:
    (a50,) = [device for device in kinds["dvl"].devices if device.name == "a50"]
    assert a50.title == "Water Linked DVL A50"
    values = {value.key: value for value in a50.values}
    assert values["beam_angle_deg"].value == 22.5
    assert all(value.source and value.status for value in a50.values)
    assert not {"source", "status"} & set(values)


def test_keys_of_tables_in_a_device_are_dotted(kinds) -> None:
    dotted = [
        value for kind in kinds.values() for device in kind.devices for value in device.values if "." in value.key
    ]
    assert dotted
    assert not any(isinstance(value.value, dict) for value in dotted)


# -- keys -------------------------------------------------------------------------------------------------------------------------------


class Part(Table, kw_only=True, frozen=True):
    """A table."""


class Own(SensorTable, tag="own", kw_only=True, frozen=True):
    """A kind with a key of each sort. And a second sentence."""

    needed: float
    size: float = 2.0
    many: int = 3
    on: bool = False
    mode: str = "fast"
    vector: tuple[float, ...] = (1.0, 0.5)
    matrix: tuple[tuple[float, float], ...] = ((1.0, 0.0), (0.0, 1.0))
    maybe: Annotated[float, Meta(gt=0)] | UnsetType = UNSET
    part: Part = Part()
    more: dict[str, float] = field(default_factory=dict)


def test_own_keys_with_their_defaults_as_a_file_writes_them() -> None:
    assert keys_of(Own) == {
        "needed": "required",
        "size": "2",
        "many": "3",
        "on": "false",
        "mode": "fast",
        "vector": "[1, 0.5]",
        "matrix": "[[1, 0], [0, 1]]",
        "maybe": "none",
        "part": "its own",
        "more": "none",
    }


def test_keys_that_every_sensor_has_are_left_out() -> None:
    assert not {"rate_hz", "mount", "modifiers"} & set(keys_of(PressureConfig))
    assert "output" in keys_of(PressureConfig)


def test_a_modifier_has_all_its_keys() -> None:
    assert keys_of(modifier_kinds()["random_walk"]) == {"field": "required", "density": "required"}


# -- sentences --------------------------------------------------------------------------------------------------------------------------


def test_the_first_sentence_without_its_stop() -> None:
    assert first_sentence(Own) == "A kind with a key of each sort"
    assert first_sentence(Part) == "A table"


def test_where_a_table_only_lists_its_keys_the_module_speaks() -> None:
    class Bare(Struct):
        """Attributes:
        x: something.
        """

    assert (
        first_sentence(Bare)
        == "The kinds that `uwserver list` and the reference pages show, and the JSON Schemas of all files"
    )


def test_a_sentence_over_two_lines_is_one() -> None:
    class Long(Struct):
        """A sentence that
        goes on.

        Attributes:
            x: something.
        """

    assert first_sentence(Long) == "A sentence that goes on"


def test_every_kind_says_what_it_is() -> None:
    for kind in [*kinds_of(SensorConfig).values(), *modifier_kinds().values()]:
        sentence = first_sentence(kind)
        assert sentence, kind
        assert not sentence.startswith("Attributes"), kind


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
