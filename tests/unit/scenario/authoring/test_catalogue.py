"""What kinds there are, as `uwserver list` and the reference pages tell it."""

from __future__ import annotations

from typing import Annotated

import pytest
from msgspec import UNSET, Meta, Struct, UnsetType, field

from uwserver.modifiers import ModifierConfig
from uwserver.scenario.authoring.catalogue import first_sentence, keys_of, modifier_kinds, sensor_kinds
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
        "vector": "[1.0, 0.5]",
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

    assert first_sentence(Bare) == "What kinds there are, as `uwserver list` and the reference pages tell it"


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
