"""One vehicle of a scenario: its table, its copies, and its merge with the vehicle file."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET

from uwserver.scenario.build.world import build
from uwserver.scenario.files.documents import Document, parse
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load import solids as solid_files
from uwserver.scenario.load.export import to_toml
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import Copies, MergedFile, VehicleEntry, merged_file


@pytest.fixture
def entry(tree_of, report):
    """The entry of a raw table, and what is told of it."""

    def make(**keys: Any) -> tuple[VehicleEntry | None, list[str]]:
        report.lines.clear()
        tree = tree_of({"schema": 1, "vehicles": {"rov": {"model": "x", **keys}}}, Scenario)
        value: VehicleEntry | None = tree.at("vehicles", "rov").value
        return value, report.lines

    return make


def test_a_model_is_enough(entry) -> None:
    found, told = entry()
    assert told == []
    assert found == VehicleEntry(model="x")
    assert (found.position_ned_m, found.attitude_rpy_deg, found.present) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True)
    assert found.copies is found.truth is found.autopilot is UNSET
    assert found.sensors == found.override == {}


def test_whole_numbers_become_numbers(entry) -> None:
    found, _ = entry(position_ned_m=[1, 2, 3])
    assert found.position_ned_m == (1.0, 2.0, 3.0)
    assert all(type(x) is float for x in found.position_ned_m)


def test_what_is_overridden_is_not_looked_at_here(entry) -> None:
    found, told = entry(override={"anything": {"at": ["all"]}})
    assert told == []
    assert found.override == {"anything": {"at": ["all"]}}


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"model": ""}, "vehicles.rov.model: expected a string that is not empty, found the string \"\""),
        ({"model": 3}, "vehicles.rov.model: expected a string that is not empty, found 3"),
        ({"position_ned_m": [0, 0]}, "vehicles.rov.position_ned_m: expected an array of 3 (a number each), found an array of 2"),
        ({"position_ned_m": [0, 0, "deep"]}, 'vehicles.rov.position_ned_m[2]: expected a number, found the string "deep"'),
        ({"present": 1}, "vehicles.rov.present: expected true or false, found 1"),
        ({"poition_ned_m": [0, 0, 0]}, 'vehicles.rov [vehicles.rov.poition_ned_m]: unknown key "poition_ned_m" (did you mean "position_ned_m"?)'),
        ({"copies": {"count": 0}}, "vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 0"),
        ({"copies": {"count": 1001}}, "vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 1001"),
        ({"copies": {}}, 'vehicles.rov.copies: missing key "count"'),
        ({"copies": {"count": 2, "spacing_m": [0, 1]}}, "vehicles.rov.copies.spacing_m[0]: expected a number greater than 0, found 0"),
        ({"copies": {"count": 2, "columns": 0}}, "vehicles.rov.copies.columns: expected a whole number of at least 1, found 0"),
        ({"truth": {"rate_hz": 0}}, "vehicles.rov.truth.rate_hz: expected a number greater than 0, found 0"),
        ({"sensors": {"1": {"kind": "imu", "rate_hz": 1}}}, 'vehicles.rov.sensors.1: "1" cannot be a name: begin with a letter or _, then use letters, digits, _ and - (it is part of a path)'),
        ({"sensors": {"s": {"kind": "imu"}}}, 'vehicles.rov.sensors.s: missing key "rate_hz"'),
        ({"autopilot": {"mode": "dance"}}, "vehicles.rov.autopilot.mode: expected one of"),
    ],
)  # fmt: skip
def test_what_it_refuses(keys: dict[str, Any], line: str, entry) -> None:
    found, told = entry(**keys)
    assert found is None
    (only,) = told
    assert only.startswith(line)


def test_copies_stand_five_metres_apart_by_default() -> None:
    assert Copies(count=3) == Copies(count=3, columns=UNSET, spacing_m=(5.0, 5.0))


ROV = 'schema = 1\n[vehicles.rov]\nmodel = "./tiny.toml"\nposition_ned_m = [1.0, 2.0, 5.0]\n'
HULL = '[collision.hull]\nkind = "sphere"\nradius_m = 0.2\n'


@pytest.fixture
def loaded(write, files, adapters):
    """Loads a scenario with a tiny vehicle; more text for either file."""
    return lambda text, vehicle="": load(write(ROV + text, files["tiny"] + vehicle), adapters=adapters)


@pytest.fixture
def told(loaded):
    """All that is told of a scenario that does not load."""

    def run(text, vehicle=""):
        with pytest.raises(ScenarioError) as caught:
            loaded(text, vehicle)
        return "\n".join(str(problem) for problem in caught.value.problems)

    return run


def test_copies_stand_in_rows_and_columns(loaded):
    resolved = loaded("copies = { count = 5, columns = 2, spacing_m = [3.0, 4.0] }")
    places = {name: vehicle.entry.position_ned_m for name, vehicle in resolved.vehicles.items()}
    assert places == {
        "rov_1": (1.0, 2.0, 5.0),
        "rov_2": (1.0, 6.0, 5.0),
        "rov_3": (4.0, 2.0, 5.0),
        "rov_4": (4.0, 6.0, 5.0),
        "rov_5": (7.0, 2.0, 5.0),
    }
    world = build(resolved)
    assert {name: vehicle.p_NB for name, vehicle in world.vehicles.items()} == places
    assert {f"{name}/imu" for name in places} <= set(world.ports)
    world.step(240)
    assert len({world.read(f"{name}/imu").seq for name in places}) == 1


def test_a_square_is_the_default(loaded):
    resolved = loaded("copies = { count = 7 }")
    assert [vehicle.entry.position_ned_m[:2] for vehicle in resolved.vehicles.values()][2:5] == [
        (1.0, 12.0),
        (6.0, 2.0),
        (6.0, 7.0),
    ]


def test_each_copy_has_its_own_noise_and_one_file(loaded):
    noise = (
        '[vehicles.rov.sensors.imu]\nkind = "imu"\nrate_hz = 120\n'
        '[vehicles.rov.sensors.imu.modifiers.n]\nkind = "white_noise"\nfield = "f_S"\nsigma = 0.1\n'
    )
    resolved = loaded(f"copies = {{ count = 3 }}\n{noise}")
    assert len({id(vehicle.vehicle) for vehicle in resolved.vehicles.values()}) == 1
    world = build(resolved)
    world.step(10)
    assert len({world.read(f"rov_{k}/imu").value for k in (1, 2, 3)}) == 3


def test_written_out_it_is_the_same_scenario(loaded, tmp_path, adapters):
    resolved = loaded("copies = { count = 3 }")
    again = tmp_path / "again.toml"
    again.write_text(to_toml(resolved.scenario))
    assert load(again, adapters=adapters).scenario == resolved.scenario


def test_a_fault_names_one_of_them(loaded, told):
    fault = '[faults.weak]\nkind = "thruster_weak"\ntarget = "{}/thrusters"\nfactor = 0.5\n'
    assert loaded("copies = { count = 3 }\n" + fault.format("rov_2"))
    assert "rov_1/thrusters, rov_2/thrusters" in told("copies = { count = 2 }\n" + fault.format("rov"))


def test_bad_copies_are_told_once_and_where(told):
    assert told("copies = { count = 0 }").splitlines() == [
        "tank.toml:5:12: vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 0"
    ]
    assert "missing key" in told("copies = { spacing_m = [1, 1] }")
    assert "spacing_m" in told("copies = { count = 2, spacing_m = [0, 1] }")
    assert 'vehicles.rov_2: "rov_2" is already the name of a vehicle or object of the table "rov"' in told(
        'copies = { count = 2 }\n[vehicles.rov_2]\nmodel = "./tiny.toml"\n'
    )


def test_a_copy_inside_the_seabed_is_told(told):
    seabed = '[seabed]\nkind = "flat"\ndepth_m = 20\n[structures.rock]\nkind = "sphere"\nradius_m = 1.0\nposition_ned_m = [1, 7, 5]\n'
    assert 'starts inside "rock"' in told("copies = { count = 2 }\n" + seabed)


def test_without_the_engines_one_vehicle_runs_and_two_are_told_what_to_install(loaded, told, monkeypatch):
    monkeypatch.setattr(solid_files, "missing_engines", lambda _: "install them")
    world = build(loaded("", HULL))
    assert world.scene is None
    world.step(10)
    assert "vehicles: install them" in told("copies = { count = 2 }", HULL)


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
