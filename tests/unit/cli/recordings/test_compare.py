"""`uwserver compare`: table, JSON, limits and exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from logs_rig import telemetry, tlog
from recording_rig import recorded

from uwserver.cli.recordings.compare import compare
from uwserver.ports import Command
from uwserver.recording.changes import Changes, setting
from uwserver.recording.replay import replay

PUSH = Command("rov/thrusters", ((0.3,) * 8,), "me")


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    from uwserver.scenario.load.scenario import load
    from uwserver.scenario.load.tables import Scenario
    from uwserver.scenario.vehicle.entry import VehicleEntry

    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 2.0))
    folder = tmp_path_factory.mktemp("compare")
    resolved = load(Scenario(schema=1, vehicles={"rov": vehicle}), adapters={})
    a = recorded(folder / "a.mcap", resolved, 480, {100: [PUSH]})
    replay(a, changes=Changes((setting("vehicles.rov.rigid_body.mass_kg=14"),)), record=folder / "b.mcap")
    return str(a), str(folder / "b.mcap")


def told(*args: str) -> Result:
    return CliRunner().invoke(compare, args)


def test_the_same_run_gives_0_and_another_1(pair: tuple[str, str]):
    same = told(pair[0], pair[0])
    assert (same.exit_code, "3 hashes equal" in same.output) == (0, True)
    other = told(*pair)
    assert other.exit_code == 1
    assert "first sample that differs: rov/" in other.output
    assert "rov/imu" in other.output
    assert "rad/s" in other.output


def test_limits_decide(pair: tuple[str, str]):
    kept = told(*pair, "--max", "rov/pressure.pressure=1e6")
    assert (kept.exit_code, "within 1e+06: max of rov/pressure.pressure: " in kept.output) == (0, True)
    beyond = told(*pair, "--rms", "rov/*.pressure=1e-9")
    assert (beyond.exit_code, "BEYOND 1e-09: rms of rov/pressure.pressure: " in beyond.output) == (1, True)


def test_json_has_all_of_it(pair: tuple[str, str]):
    done = told(*pair, "--json", "--max", "rov/pressure.pressure=1e6")
    whole = json.loads(done.output)
    field = whole["ports"]["rov/pressure"]["fields"]["pressure"]
    assert (field["unit"], field["count"] > 50, field["rms"] < field["max"]) == ("Pa", True, True)
    assert (whole["within"], whole["same"], whole["limits"][0]["kept"]) == (True, False, True)
    assert whole["first_difference"]["t_ns"] > 0
    assert whole["states"]["first_difference_ns"] == 10**9


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("--rms", "rov/presure.pressure=1"), 'no port "rov/presure" (did you mean "rov/pressure"'),
        (("--rms", "rov/pressure.presure=1"), 'no field "presure" (did you mean "pressure"'),
        (("--max", "rov/pressure.pressure=much"), "is no PORT.FIELD=LIMIT"),
        (("--max", "rov/pressure=1"), "is no PORT.FIELD=LIMIT"),
        (("--max", "rov/pressure.pressure=-1"), "is no PORT.FIELD=LIMIT"),
        (("--max", "rov/pressure.pressure=nan"), "is no PORT.FIELD=LIMIT"),
    ],
)
def test_bad_limits_give_2(pair: tuple[str, str], args: tuple[str, ...], text: str):
    done = told(*pair, *args)
    assert (done.exit_code, text in done.output) == (2, True), done.output


def test_bad_files_give_2(pair: tuple[str, str], tmp_path: Path):
    (tmp_path / "x").write_text("hello")
    assert told(pair[0], str(tmp_path / "x")).exit_code == 2
    missing = told(pair[0], str(tmp_path / "y"))
    assert (missing.exit_code, "No such file" in missing.output) == (2, True)


def test_a_log_of_another_origin_is_told_what_compare_takes(pair: tuple[str, str], tmp_path: Path):
    (tmp_path / "dive.tlog").write_bytes(tlog(telemetry(1.0)))
    done = told(pair[0], str(tmp_path / "dive.tlog"))
    assert done.exit_code == 2
    assert "dive.tlog: not an MCAP file" in done.output
    assert "compare takes what `uwserver run --record FILE`" in done.output
    assert "`uwserver play LOG --port 0 --paused`" in done.output
    assert "replay takes" not in done.output


def test_a_port_that_only_one_has_is_beyond_any_limit(pair: tuple[str, str], tmp_path: Path):
    without = tmp_path / "c.mcap"
    replay(Path(pair[0]), changes=Changes((setting("vehicles.rov.sensors.imu.enabled=false"),)), record=without)
    done = told(pair[0], str(without), "--max", "rov/imu.f_S=100")
    assert (done.exit_code, "only one of them has it" in done.output) == (1, True)
