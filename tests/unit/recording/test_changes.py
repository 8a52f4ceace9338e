"""A recorded run in another world: equal up to the change, recorded anew, and what cannot be changed refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from recording_rig import recorded

from uwserver.cli.recordings.replay import replay as command
from uwserver.ports import Call, Command
from uwserver.recording.changes import BadChange, Changes, Setting, asked, setting
from uwserver.recording.format import HASHES, REQUESTS, head_of
from uwserver.recording.reading import NotReplayable, Reading
from uwserver.recording.replay import replay
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario

PUSH = Command("rov/thrusters", ((0.3,) * 8,), "me")
SECOND = 240
CURRENT = "environment.current.velocity_ned_mps=[0.3,0,0]"


@pytest.fixture(scope="module")
def piloted() -> Resolved:
    raw = {
        "schema": 1,
        "environment": {"currents": {"tide": {"kind": "uniform", "velocity_ned_mps": [0.0, 0.1, 0.0]}}},
        "vehicles": {
            "rov": {"model": "bluerov2_heavy", "position_ned_m": [0.0, 0.0, 2.0], "truth": {}, "autopilot": {}}
        },
    }
    return load(msgspec.convert(raw, Scenario), adapters={})


@pytest.fixture(scope="module")
def run(piloted: Resolved, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds with a push at 0.5 s and one at 2.5 s."""
    path = tmp_path_factory.mktemp("changes") / "run.mcap"
    return recorded(path, piloted, 3 * SECOND, {SECOND // 2: [PUSH], 5 * SECOND // 2: [PUSH]})


def changed(
    run: Path, new: Path, *settings: str, from_s: float = 0.0, calls: tuple[str, ...] = (), to_s: float | None = None
):
    changes = Changes(tuple(map(setting, settings)), tuple(map(asked, calls)), from_s)
    return replay(run, changes=changes, to_s=to_s, record=new)


def bodies(path: Path, topic: str) -> list[dict]:
    with path.open("rb") as file:
        return [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=[topic])]


def test_values_are_those_of_toml():
    assert setting("a.b=[1, 2.5]") == Setting(("a", "b"), [1, 2.5])
    assert setting('a."b.c"={x = "y"}') == Setting(("a", "b.c"), {"x": "y"})
    assert setting("vehicles.rov.autopilot.mode=depth_hold").value == "depth_hold"
    for bad in ("a", "=3", "a=[1", "a b=3", "a="):
        with pytest.raises(BadChange):
            setting(bad)
    with pytest.raises(BadChange, match="are not valid JSON"):
        asked("world/reset={")
    with pytest.raises(BadChange, match="an object"):
        asked("world/reset=3")


def test_up_to_the_change_the_run_is_the_recorded_one_and_after_it_another(run: Path, tmp_path: Path):
    done = changed(run, tmp_path / "new.mcap", CURRENT, from_s=1.5)
    assert (done.difference, done.hashes, done.changed_ns, done.end_ns) == (None, 1, 1_500_000_000, 3_000_000_000)
    old, new = bodies(run, "rov/truth/pose"), bodies(tmp_path / "new.mcap", "rov/truth/pose")
    assert [b for b in new if b["t_ns"] <= 1_500_000_000] == [b for b in old if b["t_ns"] <= 1_500_000_000]
    drift = new[-1]["value"]["p_NB"][0] - old[-1]["value"]["p_NB"][0]
    assert 0.01 < drift < 0.45, "the current takes the vehicle along"
    # The uniform currents add up: the tide is still there.
    requests = bodies(tmp_path / "new.mcap", REQUESTS)
    assert [(r["tick"], r.get("service", r.get("port"))) for r in requests] == [
        (120, "rov/thrusters"), (360, "world/set_current"), (600, "rov/thrusters"),
    ]  # fmt: skip
    assert requests[1]["args"] == {"velocity_N": [0.3, 0.1, 0.0]}


def test_a_request_of_the_same_tick_meets_the_changed_world(run: Path, tmp_path: Path):
    changed(run, tmp_path / "n.mcap", CURRENT, from_s=0.5, to_s=1.0)
    requests = bodies(tmp_path / "n.mcap", REQUESTS)
    assert [(r["tick"], r.get("service", r.get("port"))) for r in requests] == [
        (120, "world/set_current"),
        (120, "rov/thrusters"),
    ]


def test_the_new_recording_is_replayed_bit_for_bit(run: Path, tmp_path: Path):
    changed(run, tmp_path / "late.mcap", CURRENT, from_s=1.5)
    changed(run, tmp_path / "early.mcap", CURRENT)
    for name, requests in (("late", 3), ("early", 2)):
        again = replay(tmp_path / f"{name}.mcap")
        assert (again.difference, again.hashes, again.requests) == (None, 4, requests)
    assert bodies(run, HASHES) != bodies(tmp_path / "early.mcap", HASHES)


def test_without_a_change_the_new_recording_is_the_old_one(run: Path, tmp_path: Path):
    replay(run, record=tmp_path / "same.mcap")
    for topic in (HASHES, REQUESTS, "rov/imu"):
        assert bodies(tmp_path / "same.mcap", topic) == bodies(run, topic)


def test_from_the_start_the_scenario_of_the_new_recording_is_another(run: Path, tmp_path: Path):
    done = changed(run, tmp_path / "n.mcap", CURRENT, "vehicles.rov.rigid_body.mass_kg=20", "seed=9", to_s=1.0)
    assert (done.hashes, done.changed_ns, done.end_ns) == (0, 0, 1_000_000_000)
    with Reading(tmp_path / "n.mcap") as reading:
        head = head_of(reading.record)
        assert (reading.record["replay_of"], reading.record["changed_from_s"]) == ("run.mcap", "0")
    assert head.seed == 9
    assert head.resolved.scenario.environment.current.velocity_ned_mps == (0.3, 0.0, 0.0)
    assert head.resolved.vehicles["rov"].vehicle.rigid_body.mass_kg == 20


def test_with_another_rate_requests_come_at_their_times(run: Path, tmp_path: Path):
    done = changed(run, tmp_path / "fast.mcap", "world.rate_hz=480")
    assert (done.ticks, done.end_ns) == (6 * SECOND, 3_000_000_000)
    assert [r["tick"] for r in bodies(tmp_path / "fast.mcap", REQUESTS)] == [SECOND, 5 * SECOND]
    assert replay(tmp_path / "fast.mcap").difference is None


@pytest.mark.parametrize(
    ("given", "service", "args"),
    [
        ("environment.currents.tide.velocity_ned_mps=[0,0.5,0]", "world/set_current", {"velocity_N": [0.0, 0.5, 0.0]}),
        ('faults.f={kind="thruster_weak", target="rov/thrusters", factor=0.5}', "world/set_fault",
         {"name": "f", "kind": "thruster_weak", "target": "rov/thrusters", "parameters": {"factor": 0.5}}),
        ("vehicles.rov.sensors.imu.rate_hz=60", "rov/imu/set", {"rate_hz": 60.0}),
        ("vehicles.rov.sensors.imu.enabled=false", "rov/imu/deactivate", {}),
        ("vehicles.rov.autopilot.gains.depth_p=0.5", "rov/autopilot/set_gain", {"name": "depth_p", "value": 0.5}),
        ("vehicles.rov.autopilot.mode=stabilise", "rov/autopilot/set_mode", {"mode": "stabilise"}),
        ("vehicles.rov.actuators.thrusters.timeout_s=0.5", "rov/thrusters/set", {"timeout_s": 0.5}),
    ],
)  # fmt: skip
def test_what_a_service_can_change_changes_at_any_time(run: Path, tmp_path: Path, given: str, service: str, args: dict):
    done = changed(run, tmp_path / "n.mcap", given, from_s=1.0, to_s=1.5)
    assert done.changed_ns == 1_000_000_000
    (found,) = [r for r in bodies(tmp_path / "n.mcap", REQUESTS) if r["tick"] == SECOND]
    assert (found["service"], found["source"]) == (service, "replay")
    assert args.items() <= found.get("args", {}).items()
    for key, value in args.get("parameters", {}).items():
        assert found["args"]["parameters"][key] == value
    assert replay(tmp_path / "n.mcap").difference is None


def test_any_service_is_called(run: Path, tmp_path: Path):
    changed(run, tmp_path / "n.mcap", from_s=1.0, calls=('world/set_current={"velocity_N": [0, 1, 0]}',), to_s=2.0)
    found = [r for r in bodies(tmp_path / "n.mcap", REQUESTS) if r["tick"] == SECOND]
    assert [(r["service"], r["args"]) for r in found] == [("world/set_current", {"velocity_N": [0.0, 1.0, 0.0]})]


@pytest.mark.parametrize(
    ("given", "from_s", "told"),
    [
        ("environment.curent.velocity_ned_mps=[1,0,0]", 0.0, r'environment: unknown key "curent" \(did you mean "current"'),
        ("enviroment.current.velocity_ned_mps=[1,0,0]", 1.0, r'unknown key "enviroment" \(did you mean "environment"'),
        ("environment.current.velocity_ned_mps=fast", 1.0, 'expected an array of 3 .*, found the string "fast"'),
        ("environment.current.velocity_ned_mps=[100,0,0]", 1.0, "world/set_current: .*20"),
        ("vehicles.rv.position_ned_m=[0,0,1]", 0.0, r'no vehicle "rv" \(did you mean "rov"'),
        ("vehicles.rov.sensor.imu.rate_hz=60", 0.0, r'unknown key "sensor" \(did you mean "sensors"'),
        ("vehicles.rov.sensors.imu.rate_hz=7", 1.0, "7 Hz does not divide the physics rate"),
        ("vehicles.rov.sensors.imu.modifiers={}", 1.0, "cannot change while the world runs, only with --from 0"),
        ("vehicles.rov.position_ned_m=[0,0,1]", 1.0, "cannot change while the world runs"),
        ('seabed={kind="flat", depth_m=9}', 1.0, "seabed cannot change while the world runs, only with --from 0"),
        ("vehicles.rov.collision.hull.radius_m=1", 0.0, "contains the shape of the vehicle as built"),
        ("vehicles.rov={}", 0.0, "cannot be replaced as a whole"),
        ("vehicles.rov.sensors.imu.rpy_deg=[0,0,9]", 0.0, r'on the mount "imu": change vehicles\.rov\.mounts\.imu\.rpy_deg'),
        ("structures.wall.friction=1", 0.0, "the recording contains the structures as built"),
        ("adapters.tcp.port=1", 0.0, "a replay has no adapters"),
        ("vehicles.rov.autopilot.gains.depth_p.x=1", 0.0, "depth_p"),
        ('faults.f={kind="thruster_dead", target="rov/thruster"}', 1.0, "thruster"),
    ],
)  # fmt: skip
def test_what_cannot_be_changed_is_refused_by_name(run: Path, tmp_path: Path, given: str, from_s: float, told: str):
    with pytest.raises(BadChange, match=told):
        changed(run, tmp_path / "n.mcap", given, from_s=from_s)
    assert not (tmp_path / "n.mcap").exists()


def test_a_service_that_is_not_there_or_refuses_is_told(run: Path, tmp_path: Path):
    with pytest.raises(BadChange, match='did you mean "world/set_current"'):
        changed(run, tmp_path / "n.mcap", calls=("world/set_curent={}",), from_s=1.0)
    with pytest.raises(BadChange, match=r'world/restore at 1 s: no snapshot "a"'):
        changed(run, tmp_path / "n.mcap", calls=('world/restore={"name": "a"}',), from_s=1.0)
    assert list(tmp_path.iterdir()) == []


def test_a_flat_seabed_can_be_laid_from_the_start(run: Path, tmp_path: Path):
    changed(run, tmp_path / "n.mcap", 'seabed={kind="flat", depth_m=2.2}')
    assert replay(tmp_path / "n.mcap").difference is None
    with Reading(tmp_path / "n.mcap") as reading:
        assert set(head_of(reading.record).resolved.static) == {"seabed"}
    depths = [b["value"]["p_NB"][2] for b in bodies(tmp_path / "n.mcap", "rov/truth/pose")]
    assert max(depths) < 2.2, "it lies on it, and not in it"


def test_requests_that_the_other_world_refuses_are_counted(piloted: Resolved, tmp_path: Path):
    requests = {SECOND // 2: [Call("world/state_hash", {}, "me")], 300: [PUSH]}
    path = recorded(tmp_path / "run.mcap", piloted, SECOND + SECOND // 2, requests)
    done = changed(path, tmp_path / "n.mcap", "vehicles.rov.autopilot.armed=true")
    assert done.refused[0] == 1
    assert done.refused[1].startswith("1.25 s: ")
    assert "is held by the autopilot" in done.refused[1]
    assert replay(tmp_path / "n.mcap").difference is None


def test_a_recording_that_differs_before_the_change_is_told_and_leaves_no_file(
    piloted: Resolved, run: Path, tmp_path: Path
):
    content = run.read_bytes()
    with Reading(run) as reading:
        first = next(entry for entry in reading.entries() if hasattr(entry, "hash"))
    raw = tmp_path / "raw.mcap"
    _rewritten(run, raw, first.hash, "0" * 64)
    assert raw.read_bytes() != content
    done = CliRunner().invoke(
        command, [str(raw), "--set", CURRENT, "--from", "2", "--record", str(tmp_path / "n.mcap")]
    )
    assert done.exit_code == 1, done.output
    assert "differs in tick 240" in done.output
    assert "n.mcap was not written" in done.output
    assert not (tmp_path / "n.mcap").exists()


def _rewritten(source: Path, target: Path, old: str, new: str) -> None:
    """A copy with one text for another in its messages."""
    from mcap.records import Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    with source.open("rb") as file, target.open("wb") as output:
        writer = Writer(output)
        writer.start()
        schemas, channels = {}, {}
        for record in StreamReader(file).records:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Schema):
                schemas[record.id] = schemas.get(record.id) or writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id]
                )
            elif isinstance(record, Message):
                data = record.data.replace(old.encode(), new.encode())
                writer.add_message(channels[record.channel_id], record.log_time, data, record.publish_time)
        writer.finish()


def test_a_change_after_the_end_is_told(run: Path, tmp_path: Path):
    with pytest.raises(NotReplayable, match="ends at 3 s, before --from 30"):
        changed(run, tmp_path / "n.mcap", CURRENT, from_s=30.0)
    assert not (tmp_path / "n.mcap").exists()


def test_a_cut_recording_is_changed_as_far_as_it_goes(run: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes(run.read_bytes()[:-200])
    done = changed(tmp_path / "cut.mcap", tmp_path / "n.mcap", CURRENT, from_s=1.0)
    assert done.truncated
    assert replay(tmp_path / "n.mcap").difference is None


def test_the_command_line_says_what_was_done(run: Path, tmp_path: Path):
    new = str(tmp_path / "n.mcap")
    done = CliRunner().invoke(command, [str(run), "--set", CURRENT, "--from", "1.5", "--record", new])
    assert done.exit_code == 0, done.output
    assert "1 hashes equal; another world from 1.5 s to 3 s" in done.output
    assert f"wrote {new}" in done.output
    again = CliRunner().invoke(command, [str(run), "--set", CURRENT, "--record", new])
    assert again.exit_code == 1
    assert "exists already" in again.output
    wrong = CliRunner().invoke(command, [str(run), "--set", "environment.curent=3"])
    assert wrong.exit_code == 2
    assert 'did you mean "current"' in wrong.output
    told = json.loads(CliRunner().invoke(command, [str(run), "--set", CURRENT, "--json"]).output)
    assert (told["changed_ns"], told["end_ns"], told["refused"]) == (0, 3_000_000_000, 0)


def test_a_disk_that_fills_leaves_no_half_a_file(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from uwserver.recording.writer import RecordingWriter

    def full(self: RecordingWriter, *_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RecordingWriter, "hash", full)
    with pytest.raises(OSError, match=r"cannot record to .*n\.mcap: No space left on device"):
        changed(run, tmp_path / "n.mcap", CURRENT)
    assert not (tmp_path / "n.mcap").exists()
