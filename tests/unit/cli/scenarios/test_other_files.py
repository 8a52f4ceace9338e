"""`uwserver check` of files that are no scenarios."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from uwserver.cli import main
from uwserver.scenario.files.documents import shipped

PLACE = {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, 47, 8, -5]}


def plan(*items: object) -> str:
    return json.dumps({"fileType": "Plan", "mission": {"items": items}})


def check(*args: str) -> Result:
    return CliRunner().invoke(main, ["check", *args])


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_vehicle_is_checked_by_name_and_by_file():
    by_name = check("remus100")
    assert by_name.exit_code == 0
    assert by_name.stdout.startswith("ok: remus100: vehicle remus100: REMUS 100: torpedo-shaped")
    assert "  fins: rudder, stern_planes\n" in by_name.stdout
    Path("crab.toml").write_text(shipped("vehicles")["bluerov2"].read_text().replace("mass_kg =", "mas_kg ="))
    by_file = check("crab.toml")
    assert by_file.exit_code == 1
    assert 'rigid_body: unknown key "mas_kg" (did you mean "mass_kg"?)' in by_file.stderr


def test_a_vehicle_is_explained_as_a_scenario_with_it():
    explained = check("--explain", "otter")
    assert explained.exit_code == 0
    assert "[vehicles.vehicle]" in explained.stdout
    assert explained.stderr.startswith("ok: otter: vehicle otter")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("t200", 'ok: t200: device file of a thruster: t200; use it by device = "t200"\n'),
        ("a50", 'ok: a50: device file of a sensor of kind dvl: Water Linked DVL A50; use it by profile = "a50"\n'),
    ],
)
def test_a_shipped_device(name: str, text: str):
    assert check(name).stdout == text


@pytest.mark.parametrize("name", ["t200", "a50"])
def test_a_device_with_a_fault(name: str):
    text = shipped("devices")[name].read_text()
    Path("mine.toml").write_text(text.replace("source =", "sauce =", 1))
    result = check("mine.toml")
    assert result.exit_code == 1
    assert "sauce" in result.stderr


@pytest.mark.parametrize(
    ("name", "text", "code", "says"),
    [
        ("a.plan", plan(PLACE), 0, "ok: a.plan: a plan of QGroundControl: 1 item: 1 waypoint\n"),
        ("a.plan", plan({**PLACE, "command": 9}), 1, "a.plan: item 1: command 9 is not supported in a mission\n"),
        ("a.plan", plan(9), 1, "a.plan: this is no plan: AttributeError: 'int' object has no attribute 'get'\n"),
        ("a.plan", plan({**PLACE, "params": [0, 0, 0, 0, 47, 8, 5]}), 0, "a.plan: warning: item 1: 5 m is above"),
        ("a.txt", "QGC WPL 110\n0 1 0 16 0 0 0 0 0 0 0 1\n", 0, "ok: a.txt: a waypoint file: 0 items\n"),
        ("m.json", '[{"kind": "surface"}]', 0, "ok: m.json: a mission: 1 item: 1 surface\n"),
        ("m.json", '[{"kind": "swim"}]', 1, 'm.json: item 0: unknown kind "swim"'),
        ("map.toml", 'format = "uwserver-log-mapping-1"', 0, "a mapping for logs: tracks: none; ports: none\n"),
        ("map.toml", 'format = "uwserver-log-mapping-1"\ntracks = 1', 1, "map.toml: Expected `object`"),
        ("a.urdf", "<robot/>", 1, "a.urdf: this is a URDF file of ROS, which uwserver cannot read: `uwserver new"),
    ],
)  # fmt: skip
def test_missions_mappings_and_files_of_others(name: str, text: str, code: int, says: str):
    Path(name).write_text(text)
    result = check(name)
    assert result.exit_code == code
    assert says in result.output


def test_one_wrong_file_of_several_gives_status_1():
    Path("a.yaml").write_text("a: 1")
    result = check("otter", "a.yaml")
    assert result.exit_code == 1
    assert "ok: otter" in result.stdout
