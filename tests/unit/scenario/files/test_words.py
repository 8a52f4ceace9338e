"""Words of other simulators: each is known in any spelling, and every word that is given for it exists here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec.inspect as mi
import pytest

from uwserver.actuators import ActuatorConfig
from uwserver.adapter import installed_adapters
from uwserver.cli import main
from uwserver.modifiers import ModifierConfig
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.files.words import WORDS, foreign, translation, word_here
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.sensors import SensorConfig


def words_of(node: mi.Type, seen: set[type]) -> Iterator[str]:
    """All keys, kinds and choices in a type and below it."""
    if isinstance(node, mi.StructType):
        if node.cls not in seen:
            seen.add(node.cls)
            yield from (word for word in (node.tag_field, node.tag) if isinstance(word, str))
            for field in node.fields:
                yield field.encode_name
                yield from words_of(field.type, seen)
    elif isinstance(node, mi.LiteralType):
        yield from map(str, node.values)
    else:
        inner = [getattr(node, name) for name in ("type", "item_type", "value_type") if hasattr(node, name)]
        for each in (*inner, *getattr(node, "types", ()), *getattr(node, "item_types", ())):
            yield from words_of(each, seen)


@pytest.fixture(scope="module")
def ours() -> set[str]:
    """Every word that a file of ours can have, the shipped vehicles, and the commands."""
    seen: set[type] = set()
    types: tuple[Any, ...] = (Scenario, VehicleFile, ThrusterDevice, *installed_adapters().values())
    words = {word for type_ in types for word in words_of(mi.type_info(type_), seen)}
    for union in (SensorConfig, ActuatorConfig, ModifierConfig):
        words |= kinds_of(union).keys()
    return words | shipped("vehicles").keys() | set(main.list_commands(None))  # type: ignore[arg-type]


def test_the_words_are_many_and_of_every_simulator():
    count = Counter(word.origin for word in WORDS.values())
    assert sum(count.values()) >= 60
    assert min(count.values()) >= 10
    assert set(count) == {"gz", "uuv", "stonefish", "holoocean", "morse", "any"}


def test_every_word_leads_somewhere_that_exists(ours):
    for word, meaning in WORDS.items():
        assert meaning.here or meaning.elsewhere, word
        assert meaning.here.keys() <= ours, word


def test_no_two_words_are_the_same_in_other_letters():
    for word, meaning in WORDS.items():
        assert foreign(word) is meaning, word
        assert foreign(word.title().replace("_", "")) is meaning, word


def test_a_word_of_ours_is_not_in_the_table_where_it_is_right():
    """Only unknown words are looked up; one that is also ours must not be told as itself."""
    for word, meaning in WORDS.items():
        assert word not in meaning.here, word


@pytest.mark.parametrize(
    ("word", "allowed", "hint"),
    [
        ("update_rate", ["rate_hz", "mount"], ' (did you mean "rate_hz"?)'),
        ("updateRate", ["rate_hz", "mount"], ' (did you mean "rate_hz"?)'),
        ("HorizontalFOV", ["field_deg"], ' (did you mean "field_deg", in degrees?)'),
        ("pose", ["position_frd_m", "rpy_deg"], ' (did you mean "position_frd_m", forward, right, down, with rpy_deg?)'),
        ("max_step_size", ["seed"], ": [world] rate_hz is the rate of the physics"),
        ("fls", ["dvl", "multibeam"], ' (did you mean "multibeam"?)'),
        ("fls", ["dvl"], ""),
        ("xyzzy", ["dvl"], ""),
        ("", [""], ""),
    ],
)  # fmt: skip
def test_what_a_word_is_here(word, allowed, hint):
    assert translation(word, allowed) == hint


def test_the_first_word_that_is_allowed_is_given():
    assert word_here("frequency", ["rate_hz", "frequency_hz"]) == "frequency_hz"
    assert word_here("frequency", ["rate_hz"]) == "rate_hz"
    assert word_here("frequency", ["width"]) is None


@pytest.mark.parametrize(
    ("table", "line", "says"),
    [
        ("[vehicles.rov]", "position_lla = [1, 2, 3]", 'key "position_lla": [world] origin_lat_deg and origin_lon_deg'),
        ("[vehicles.rov.sensors.x]", 'kind = "camera"\nrate_hz = 4\nfov_deg = 80', '(did you mean "field_of_view_deg"'),
        ("[vehicles.rov.sensors.x]", 'kind = "DVLSensor"\nrate_hz = 4', 'kind "DVLSensor" (did you mean "dvl"?)'),
        ("[vehicles.rov.sensors.x]", 'type = "dvl"\nrate_hz = 4', 'unknown key "type" (did you mean "kind"?)'),
        (
            "[environment]",
            'water_type = "coastal"',
            '(did you mean "1C", the clearest of the coastal waters 1C to 9C?)',
        ),
        ("[structures.p]", 'kind = "cylinder"\ndiameter_m = 1\nlength_m = 1', '(did you mean "radius_m", half of it?)'),
        ("[vehicles.b]", 'model = "HoveringAUV"', 'vehicle "HoveringAUV" (did you mean "bluerov2_heavy"'),
        ("[world]", "max_step_size = 0.01", '(did you mean "rate_hz", 1 over the step?)'),
        ("[agents.b]", 'model = "otter"', 'unknown key "agents" (did you mean "vehicles"'),
    ],
)
def test_a_file_with_a_foreign_word_says_the_right_one_once(table, line, says, tmp_path: Path):
    path = tmp_path / "tank.toml"
    rov = '[vehicles.rov]\nmodel = "bluerov2"\n'
    path.write_text(f"schema = 1\n{rov}{line if table == '[vehicles.rov]' else f'{table}{chr(10)}{line}'}\n")
    with pytest.raises(ScenarioError) as caught:
        load(path, adapters={})
    (problem,) = caught.value.problems
    assert says in problem.text
