"""Recorded samples into the estimator alone: the same as in the run, bit for bit, and with something changed another."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from recording_rig import recorded

from uwserver.cli.recordings.replay import replay as command
from uwserver.ports import Call, Command
from uwserver.recording.changes import BadChange, Changes, setting
from uwserver.recording.compare import compare
from uwserver.recording.estimation import estimate
from uwserver.recording.reading import NotReplayable
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import replay
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation, Timing

SECOND = 240
AHEAD = Command("rov/autopilot/pilot", ((0.6, 0.1, 0.0, 0.0, 0.0, 0.3),), "me")
HERE = Call("rov/autopilot/set_position", {"position_ned_m": [0.5, -0.2, 2.0]}, "me")


def tank(**vehicle: object):
    dvl = {
        "kind": "dvl",
        "rate_hz": 8,
        "modifiers": {"drift": {"kind": "bias", "field": "v_S", "value": [0.05, 0.0, 0.0]}},
    }
    rov = {
        "model": "bluerov2_heavy", "position_ned_m": [0.0, 0.0, 2.0], "truth": {}, "sensors": {"dvl": dvl},
        "autopilot": {"armed": True, "mode": "depth_hold"}, **vehicle,
    }  # fmt: skip
    raw = {"schema": 1, "seabed": {"kind": "flat", "depth_m": 12.0}, "vehicles": {"rov": rov}}
    return load(msgspec.convert(raw, Scenario), adapters={})


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds of steering, with a DVL that is 5 cm/s too fast."""
    path = tmp_path_factory.mktemp("dive") / "dive.mcap"
    return recorded(path, tank(), 8 * SECOND, {tick: [AHEAD] for tick in range(SECOND, 8 * SECOND, 60)} | {500: [HERE]})


def bodies(path: Path, topic: str) -> list[dict]:
    with path.open("rb") as file:
        return [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=[topic])]


def test_without_a_change_it_gives_what_it_gave_bit_for_bit(dive: Path, tmp_path: Path):
    done = estimate(dive, "rov", record=tmp_path / "e.mcap")
    old, new = bodies(tmp_path / "e.mcap", "rov/autopilot/state"), bodies(tmp_path / "e.mcap", done.port)
    assert len(old) == len(new) == 80
    for one, other in zip(old, new, strict=True):
        assert one["t_ns"] == other["t_ns"]
        for name, value in other["value"].items():
            assert one["value"][name] == value, (name, one["t_ns"])
    assert old == bodies(dive, "rov/autopilot/state")
    assert bodies(tmp_path / "e.mcap", "rov/truth/pose") == bodies(dive, "rov/truth/pose")
    for name, before in done.before.items():
        assert before.rms == done.after[name].rms


@pytest.fixture(scope="module")
def midst(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The last four of seven seconds, as a client records them; a gain was set and a place was told before."""
    path = tmp_path_factory.mktemp("midst") / "midst.mcap"
    resolved = tank()
    world = build(resolved, 5)
    simulation = Simulation(world, Timing("freerun"), SystemTime(), Bus(lambda call: None), Mailbox())
    world.submit(HERE)
    world.submit(Call("rov/autopilot/set_gain", {"name": "velocity_timeout_s", "value": 0.06}, "me"))
    for _ in range(12):
        world.submit(AHEAD)
        world.step(60)
    recorder = Recorder(path, world, resolved)
    recorder.open(simulation.timing)
    recorder.write_from(recorder.begin(simulation))
    for tick in range(4 * SECOND):
        if tick % 60 == 0:
            recorder.requested(AHEAD, world.tick, tick)
            world.submit(AHEAD)
        output = world.advance()
        recorder.ticked(world)
        recorder.put_samples(output.samples)
    recorder.end()
    recorder.close()
    return path


def test_in_the_midst_of_a_run_it_begins_with_what_was_believed_there(midst: Path, tmp_path: Path):
    assert replay(midst).difference is None
    done = estimate(midst, "rov", record=tmp_path / "e.mcap")
    old, new = bodies(midst, "rov/autopilot/state"), bodies(tmp_path / "e.mcap", done.port)
    assert len(old) == len(new) == 40
    for one, other in zip(old, new, strict=True):
        assert {name: one["value"][name] for name in other["value"]} == other["value"], one["t_ns"]
    estimate(midst, "rov", [setting("vehicles.rov.sensors.dvl.enabled=false")], record=tmp_path / "changed.mcap")
    changed = bodies(tmp_path / "changed.mcap", done.port)
    assert math.dist(changed[0]["value"]["p_N"], old[0]["value"]["p_N"]) < 0.1, "without a sensor, too"
    assert changed[-1]["value"]["v_N"] != old[-1]["value"]["v_N"]


def test_the_world_of_a_run_that_had_begun_is_not_changed_at_its_start(midst: Path, tmp_path: Path):
    """Its state is one of the world as it was: that was told as a state of another scenario."""
    current = Changes((setting("environment.current.velocity_ned_mps=[0.3,0,0]"),))
    with pytest.raises(BadChange, match="give a --from after its begin"):
        replay(midst, changes=current, record=tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()
    assert replay(midst, changes=replace(current, from_s=4.0)).changed_ns == 4 * 10**9


def test_with_another_dvl_the_estimate_is_another_and_measured_by_the_truth(dive: Path):
    done = estimate(dive, "rov", [setting("vehicles.rov.sensors.dvl.enabled=false")])
    assert (done.samples > 1000, done.end_ns, done.remarks) == (True, 8 * 10**9, ())
    before, after = done.before["v_N"], done.after["v_N"]
    assert before.count == after.count == 80
    assert 0.02 < before.rms < 0.15, "the bias of the DVL and nothing worse"
    assert after.rms != before.rms
    assert done.after["depth"].rms < 0.05, "the depth is measured still"


def test_where_it_begins_moves_all_of_it(dive: Path):
    moved = estimate(dive, "rov", [setting("vehicles.rov.autopilot.start_position_ned_m=[3,4,2]")])
    assert moved.after["p_N"].largest == pytest.approx(5.0, abs=0.5)
    assert moved.before["p_N"].largest < 2.0


def test_the_truth_is_as_far_as_geometry_says(dive: Path, tmp_path: Path):
    """By hand, from the messages themselves."""
    done = estimate(dive, "rov", record=tmp_path / "e.mcap")
    truth = {b["t_ns"]: b["value"]["p_NB"] for b in bodies(dive, "rov/truth/pose")}
    told = [(b["value"]["p_N"], truth[b["t_ns"]]) for b in bodies(dive, "rov/autopilot/state") if b["t_ns"] in truth]
    squares = [math.dist(one, other) ** 2 for one, other in told]
    assert done.before["p_N"].rms == pytest.approx(math.sqrt(sum(squares) / len(squares)), rel=1e-12)


def test_the_new_recording_is_no_run(dive: Path, tmp_path: Path):
    estimate(dive, "rov", record=tmp_path / "e.mcap")
    with pytest.raises(NotReplayable, match=r"an estimator made it from dive\.mcap: replay that"):
        replay(tmp_path / "e.mcap")
    assert set(compare(dive, tmp_path / "e.mcap").only[1]) == {"rov/estimate/state"}


@pytest.mark.parametrize(
    ("vehicle", "given", "told"),
    [
        ("rv", "seed=3", r'"rv" has no built-in autopilot \(did you mean "rov"'),
        ("rov", "vehicles.rov.autopilot.gains.depth_q=3", 'unknown gain "depth_q"'),
        ("rov", "vehicles.rov.autopilot.estimator.gain=3", 'unknown key "estimator"'),
        ("rov", "vehicles.rov.sensors.dvl.rate_hz=much", "expected a number"),
    ],
)
def test_what_cannot_be_is_refused(dive: Path, tmp_path: Path, vehicle: str, given: str, told: str):
    with pytest.raises(BadChange, match=told):
        estimate(dive, vehicle, [setting(given)], record=tmp_path / "e.mcap")
    assert not (tmp_path / "e.mcap").exists()


def test_without_truth_there_is_nothing_to_measure_it_by(tmp_path: Path):
    resolved = tank()
    plain = msgspec.structs.replace(resolved.scenario.vehicles["rov"], truth=msgspec.UNSET)
    from dataclasses import replace

    vehicle = replace(resolved.vehicles["rov"], entry=plain)
    scenario = msgspec.structs.replace(resolved.scenario, vehicles={"rov": plain})
    path = recorded(tmp_path / "a.mcap", replace(resolved, scenario=scenario, vehicles={"rov": vehicle}), SECOND)
    done = estimate(path, "rov")
    assert done.after["p_N"].count == 0
    assert any("no truth was recorded" in text for text in done.remarks)


def test_behind_a_reset_nothing_is_heard(tmp_path: Path):
    path = recorded(tmp_path / "a.mcap", tank(), SECOND, {SECOND // 2: [Call("world/reset", {}, "me")]})
    done = estimate(path, "rov")
    assert done.end_ns == 500_000_000
    assert any("0.5 s, where a reset" in text for text in done.remarks)


def test_the_command_line_prints_both(dive: Path, tmp_path: Path):
    new = str(tmp_path / "e.mcap")
    given = [str(dive), "--estimate", "rov", "--set", "vehicles.rov.sensors.dvl.enabled=false"]
    done = CliRunner().invoke(command, [*given, "--record", new])
    assert done.exit_code == 0, done.output
    rows = {
        line.split()[0]: line.split()[1:] for line in done.output.splitlines() if line.endswith(("m", "m/s", "rad"))
    }
    assert set(rows) == {"p_N", "v_N", "q_NB", "depth"}
    assert rows["v_N"][0] != rows["v_N"][1]
    assert "rov/estimate/state is the new estimate" in done.output
    whole = json.loads(CliRunner().invoke(command, [*given, "--json"]).output)
    assert whole["fields"]["q_NB"]["unit"] == "rad"
    assert f"{whole['fields']['v_N']['rms_after']:.4g}" == rows["v_N"][1]
    refused = CliRunner().invoke(command, [*given, "--from", "3"])
    assert (refused.exit_code, "hears the whole recording" in refused.output) == (2, True)


def test_what_the_operator_said_is_heard_too(dive: Path, tmp_path: Path):
    """The position that was set moves both estimates alike; without it they part."""
    done = estimate(dive, "rov", record=tmp_path / "e.mcap")
    values = {b["t_ns"]: b["value"]["p_N"] for b in bodies(tmp_path / "e.mcap", done.port)}
    assert math.dist(values[2_000_000_000], values[2_100_000_000]) > 0.1, "at 2.083 s the operator said where it is"
