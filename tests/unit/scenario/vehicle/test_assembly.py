"""A vehicle from its parts: what overrides what, in which file each key stands, and what can be read beside a fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from uwserver.scenario.files.documents import Document, parse
from uwserver.scenario.vehicle.assembly import MergedFile, merged_file

FILE = """\
name = "tiny"
[rigid_body]
mass_kg = 10.0
[thrusters.left]
device = "./motor.toml"
[sensors.imu]
kind = "imu"
rate_hz = 120
"""
SCENARIO = """\
schema = 1
[vehicles.rov]
model = "tiny.toml"
[vehicles.rov.override.rigid_body]
mass_kg = 11.0
[vehicles.rov.override.thrusters.right]
device = "other.toml"
[vehicles.rov.sensors.imu]
kind = "imu"
[vehicles.rov.sensors.depth]
kind = "pressure"
[vehicles.other]
model = "tiny.toml"
"""


@pytest.fixture
def scenario() -> Document:
    return parse(SCENARIO, "tank.toml", Path("/here/tank.toml"))


@pytest.fixture
def file() -> Document:
    return parse(FILE, "tiny.toml", Path("/there/tiny.toml"))


@pytest.fixture
def merged(scenario: Document, file: Document) -> MergedFile:
    return merged_file(scenario, "rov", scenario.raw["vehicles"]["rov"], file)


# -- merging ----------------------------------------------------------------------------------------------------------------------------


def test_overrides_go_in_key_by_key_and_sensors_replace_whole(merged: MergedFile) -> None:
    assert merged.raw["rigid_body"] == {"mass_kg": 11.0}
    assert list(merged.raw["thrusters"]) == ["left", "right"]
    assert merged.raw["sensors"] == {"imu": {"kind": "imu"}, "depth": {"kind": "pressure"}}
    assert merged.raw["name"] == "tiny"


def test_the_file_is_left_as_it_was(merged: MergedFile, file: Document) -> None:
    assert merged.raw is not file.raw
    assert file.raw["rigid_body"] == {"mass_kg": 10.0}
    assert list(file.raw["sensors"]) == ["imu"]


@pytest.mark.parametrize("entry", [{}, {"override": 3, "sensors": 4}, {"override": {}, "sensors": {}}])
def test_without_overrides_the_file_comes_out(entry: dict[str, Any], scenario: Document, file: Document) -> None:
    raw = merged_file(scenario, "other", entry, file).raw
    assert raw == file.raw
    assert raw["rigid_body"] is file.raw["rigid_body"]


def test_sensors_of_the_scenario_stand_where_the_file_has_something_else(scenario: Document, file: Document) -> None:
    odd = Document(file.label, {**file.raw, "sensors": 3}, file.locations, file.path)
    entry = {"sensors": {"x": {"kind": "imu"}}}
    assert merged_file(scenario, "rov", entry, odd).raw["sensors"] == {"x": {"kind": "imu"}}


# -- places -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "place"),
    [
        (("rigid_body", "mass_kg"), "tank.toml:5:1: vehicles.rov.override.rigid_body.mass_kg"),
        (("rigid_body", "inertia_kgm2"), "tank.toml:4:24: vehicles.rov.override.rigid_body.inertia_kgm2"),
        (("thrusters", "left", "device"), "tiny.toml:5:1: thrusters.left.device"),
        (("thrusters", "left", "axis_frd"), "tiny.toml:4:12: thrusters.left.axis_frd"),
        (("thrusters", "right", "device"), "tank.toml:7:1: vehicles.rov.override.thrusters.right.device"),
        (("sensors", "imu", "kind"), "tank.toml:9:1: vehicles.rov.sensors.imu.kind"),
        (("sensors", "depth", "rate_hz"), "tank.toml:10:23: vehicles.rov.sensors.depth.rate_hz"),
        (("name",), "tiny.toml:1:1: name"),
        (("damping",), "tiny.toml:1:1: damping"),
    ],
)
def test_a_problem_stands_in_the_file_that_holds_the_key(path: tuple[str, ...], place: str, merged: MergedFile) -> None:
    assert str(merged.problem(path, "bad")) == f"{place}: bad"


def test_another_vehicle_of_the_same_file_has_its_own_places(scenario: Document, file: Document) -> None:
    other = merged_file(scenario, "other", scenario.raw["vehicles"]["other"], file)
    assert str(other.problem(("rigid_body", "mass_kg"), "bad")).startswith("tiny.toml:3:1: rigid_body.mass_kg")


def test_a_problem_can_point_at_another_key(merged: MergedFile) -> None:
    problem = merged.problem(("sensors", "depth"), "odd", ("sensors", "depth", "kind"), "warning")
    assert str(problem) == "tank.toml:11:1: vehicles.rov.sensors.depth: warning: odd"


@pytest.mark.parametrize(
    ("path", "folder"),
    [
        (("thrusters", "left", "device"), "/there"),
        (("thrusters", "right", "device"), "/here"),
        (("rigid_body", "mass_kg"), "/here"),
        (("collision", "hull", "file"), "/there"),
    ],
)
def test_a_file_name_starts_beside_the_file_that_gives_it(
    path: tuple[str, ...], folder: str, merged: MergedFile
) -> None:
    assert merged.folder_of(path) == Path(folder)


def test_a_file_name_of_a_built_scenario_starts_in_the_working_folder(
    file: Document, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    built = parse(SCENARIO, "built", Path("x"))
    built = Document(built.label, built.raw, built.locations, None)
    merged = merged_file(built, "rov", built.raw["vehicles"]["rov"], file)
    assert merged.folder_of(("thrusters", "right", "device")) == tmp_path
