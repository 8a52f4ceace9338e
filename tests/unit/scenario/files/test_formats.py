"""What kind of file something is, and that each is answered with a command that exists."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from uwserver.cli import main
from uwserver.scenario.files.documents import SHIPPED, shipped
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.files.formats import FORMATS, Kind, format_of, kind_of_tables, told
from uwserver.scenario.load.scenario import load

FILES = {
    "a.urdf": ("<?xml version='1.0'?>\n<robot name='crab'/>", "urdf"),
    "a.xacro": ("<robot xmlns:xacro='http://ros.org/wiki/xacro'/>", "xacro"),
    "b.urdf": ("<!-- hull -->\n<robot name='x' xmlns:xacro='http://ros.org/wiki/xacro'/>", "xacro"),
    "a.sdf": ("<?xml version='1.0'?>\n<sdf version='1.9'><world name='w'/></sdf>", "sdf"),
    "a.world": ("<sdf version='1.6'/>", "sdf"),
    "a.scn": ("<scenario>\n<environment/></scenario>", "stonefish"),
    "a.launch": ("<launch/>", "launch"),
    "a.launch.py": ("from launch import LaunchDescription", "launch"),
    "a.xml": ("<mujoco/>", "mujoco"),
    "b.xml": ("<note/>", "xml"),
    "a.yaml": ("a: 1", "yaml"),
    "b.yml": ("- 1", "yaml"),
    "a.plan": ('{"fileType": "Plan", "mission": {"items": []}}', "plan"),
    "a.waypoints": ("QGC WPL 110\n", "waypoints"),
    "b.txt": ("QGC WPL 110\n", "waypoints"),
    "mission.json": ('[{"kind": "waypoint", "position_ned_m": [1, 2, 3]}]', "mission"),
    "holoocean.json": ('{"name": "x", "world": "Dam", "agents": []}', "holoocean"),
    "oracle.json": ('{"format": "uwserver-oracle-1"}', "oracle"),
    "other.json": ('{"a": 1}', "json"),
    "list.json": ("[1, 2]", "json"),
    "default.py": ("from morse.builder import *\n", "morse"),
    "mine.py": ("import uwserver\n", "python"),
    "hull.stl": ("solid hull", "mesh"),
    "bottom.npy": ("x", "grid"),
    "nothing.toml": ("", "empty"),
    "tank.toml": ("schema = 1\n[vehicles.rov]\n", "scenario"),
    "crab.toml": ('schema = 1\nname = "crab"\n[rigid_body]\n[buoyancy]\n', "vehicle"),
    "motor.toml": ('schema = 1\nkind = "thruster"\n[propeller]\n', "device"),
    "dvl.toml": ('schema = 1\nkind = "dvl"\n[properties.beams]\n', "device"),
    "map.toml": ('format = "uwserver-log-mapping-1"\n[tracks.a]\n', "mapping"),
    "table.csv": ("t,x\n0,1\n", "log"),
    "dive.mcap": ("\x89MCAP0\r\n", "log"),
    "broken.toml": ("= 1", None),
    "notes.md": ("# Dive", None),
    "notes.txt": ("Dive", None),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_recognised(name: str, tmp_path: Path) -> None:
    text, kind = FILES[name]
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    assert format_of(tmp_path / name) == kind


def test_every_shipped_file_is_recognised() -> None:
    for folder, kind in SHIPPED.items():
        assert {format_of(path) for path in shipped(folder).values()} == {kind}
    assert format_of(shipped()["slope"].parent / "assets" / "filter_review.mcap") == "recording"


def test_a_folder_and_nothing(tmp_path: Path) -> None:
    assert format_of(tmp_path) == "folder"
    assert format_of(tmp_path / "nothing.toml") is None
    assert format_of(Path("a\0b")) is None
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    assert format_of(tmp_path) == "log"


def test_tables_that_do_not_tell_have_no_kind() -> None:
    assert kind_of_tables({"schema": 1, "title": "x"}) is None
    assert kind_of_tables({"world": {}, "rigid_body": {}}) is None


def test_each_kind_has_a_text_with_commands_that_exist() -> None:
    assert FORMATS.keys() == set(get_args(Kind))
    commands = main.list_commands(None)  # type: ignore[arg-type]
    for kind in FORMATS:
        named = re.findall(r"`uwserver (\S+)", told("FILE.x", kind))
        assert set(named) <= set(commands)


def test_the_file_is_named_so_that_a_shell_and_toml_take_it() -> None:
    assert told("my crab.toml", "scenario") == "this is a scenario: `uwserver run 'my crab.toml'` runs it"
    assert 'device = "my motor.toml"' in told("my motor.toml", "device")


@pytest.mark.parametrize("name", ["a.urdf", "a.yaml", "crab.toml", "motor.toml", "map.toml", "dive.mcap", "a.plan"])
def test_loading_it_as_a_scenario_says_what_it_is_in_one_line(name: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    text, kind = FILES[name]
    Path(name).write_bytes(text.encode("latin-1"))
    with pytest.raises(ScenarioError) as caught:
        load(name, adapters={})
    assert str(caught.value) == f"{name}: {told(name, kind)}"


def test_a_scenario_is_no_vehicle_and_no_device(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tank.toml").write_text("schema = 1\n[vehicles.rov]\nmodel = 'tank.toml'\n")
    with pytest.raises(ScenarioError) as caught:
        load("tank.toml", adapters={})
    (problem,) = caught.value.problems
    assert problem.text == "a vehicle file is needed, and this is a scenario: `uwserver run tank.toml` runs it"


@pytest.mark.parametrize(
    ("model", "text"),
    [
        ("t200", '"t200" is not a vehicle: this is a device file: '),
        ("slope", '"slope" is not a vehicle: this is a scenario: `uwserver run slope` runs it'),
        ("crab", 'unknown vehicle "crab" (did you mean the file "crab.toml"?)'),
    ],
)
def test_a_name_of_something_else_is_answered_with_what_it_is(
    model: str, text: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("crab.toml").write_text(FILES["crab.toml"][0])
    Path("tank.toml").write_text(f"schema = 1\n[vehicles.rov]\nmodel = '{model}'\n")
    with pytest.raises(ScenarioError) as caught:
        load("tank.toml", adapters={})
    assert text in caught.value.problems[0].text
