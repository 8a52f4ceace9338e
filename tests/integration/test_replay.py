"""A recorded run, replayed: whole, with resets and pauses, killed, and tampered with."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from uwserver.cli.recordings.replay import replay as replay_command
from uwserver.physics import PHYSICS
from uwserver.ports import Call, Command, Event, Sample
from uwserver.ports.checks import checked_args
from uwserver.recording.format import HASHES, REQUESTS
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import NotReplayable, replay
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors.truth import Truth
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation, Timing

U = (0.1, -0.2, 0.3, 0.1, 0.4, 0.4, -0.4, 0.4)
TIMEOUT_S = 60.0


def resolved_scenario() -> Resolved:
    entry = VehicleEntry(
        model="bluerov2_heavy",
        position_ned_m=(0.0, 0.0, 2.0),
        truth=Truth(),
        override={"actuators": {"teleport": {"kind": "teleport"}}},
    )
    return load(Scenario(schema=1, title="test", seed=5, vehicles={"rov": entry}), adapters={})


class Rig:
    """A simulation in its thread, with the test as its loop."""

    def __init__(self, timing: Timing, seed: int | None = None) -> None:
        self.resolved = resolved_scenario()
        self.world = build(self.resolved, seed)
        self._calls: queue.Queue[Callable[[], None]] = queue.Queue()
        self.bus, self.mailbox = Bus(self._calls.put), Mailbox()
        self.simulation = Simulation(self.world, timing, SystemTime(), self.bus, self.mailbox)
        self.samples: list[Sample] = []
        self.bus.attach(self)

    def put_samples(self, samples: Sequence[Sample]) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None:
        pass

    @contextmanager
    def recording(self, path: Path) -> Iterator[Recorder]:
        recorder = Recorder(path, self.world, self.resolved)
        with recorder.running(self.simulation, self.bus):
            thread = threading.Thread(target=self.simulation.run, daemon=True)
            thread.start()
            try:
                yield recorder
            finally:
                self.simulation.stop()
                thread.join(TIMEOUT_S)
                self.bus.drain()

    def pump(self, done: Callable[[], object]) -> None:
        while not done():
            self._calls.get(timeout=TIMEOUT_S)()

    def post(self, *items: Command | Call) -> None:
        """Post and wait until all are carried out."""
        replies: list[object] = []
        for item in items:
            self.mailbox.post(item, replies.append)
        self.pump(lambda: len(replies) == len(items))

    def call(self, service: str, **args: Any) -> None:
        checked = checked_args(self.world.services[service], args)
        self.post(Call(service, checked, "test:1"))

    def clock(self, service: str, **args: Any) -> None:
        replies: list[object] = []
        self.simulation.call(service, args, "test:1", replies.append)
        self.pump(lambda: any(hasattr(reply, "fault") for reply in replies))


def thrust(u: tuple[float, ...] = U) -> Command:
    return Command("rov/thrusters", (u,), "test:1")


def drive(rig: Rig) -> None:
    """Paused and running, with commands in each."""
    rig.post(thrust())
    rig.clock("world/run_until", t_s=1.3)
    rig.call("world/set_current", velocity_N=[0.1, 0.0, 0.0])
    rig.post(thrust(tuple(-u for u in U)))
    rig.clock("world/run_until", t_s=2.6)
    rig.clock("world/resume")
    for _ in range(5):
        rig.post(thrust())
    rig.clock("world/pause")


def messages(path: Path) -> list[tuple[str, Message]]:
    with path.open("rb") as file:
        return [
            (channel.topic, message) for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig]:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    rig = Rig(Timing("freerun", paused=True), seed=9)
    with rig.recording(path) as recorder:
        drive(rig)
    assert recorder.status()["error"] == ""
    assert recorder.status()["samples"] == len(rig.samples)
    return path, rig


def test_the_recording_holds_every_sample_as_it_was_delivered(run: tuple[Path, Rig]) -> None:
    path, rig = run
    found = [(topic, message) for topic, message in messages(path) if topic in rig.world.sensors]
    assert len(found) == len(rig.samples) > 500
    for sample, (topic, message) in zip(rig.samples, found, strict=True):
        body = json.loads(message.data)
        names = [field.name for field in rig.world.ports[topic].fields]
        value = [list(part) if isinstance(part, tuple) else part for part in sample.value]
        assert topic == sample.port
        assert (message.sequence, message.log_time, message.publish_time) == (sample.seq, sample.t_sent_ns, sample.t_ns)
        assert body == {
            "seq": sample.seq,
            "t_ns": sample.t_ns,
            "t_sent_ns": sample.t_sent_ns,
            "valid": sample.valid,
            "value": dict(zip(names, value, strict=True)),
        }


def test_schemas_name_units_and_frames(run: tuple[Path, Rig]) -> None:
    path, rig = run
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic: channel for channel in summary.channels.values()}
    assert set(rig.world.ports) <= set(topics)
    schema = summary.schemas[topics["rov/imu"].schema_id]
    assert schema.encoding == "jsonschema"
    field = json.loads(schema.data)["properties"]["value"]["properties"]["f_S"]
    assert "unit m/s^2" in field["description"]
    assert "frame S" in field["description"]
    assert field["maxItems"] == 3


def test_commands_are_recorded_with_their_ticks(run: tuple[Path, Rig]) -> None:
    path, rig = run
    found = [json.loads(message.data) for topic, message in messages(path) if topic == "rov/thrusters"]
    assert found[0] == {"tick": 0, "source": "test:1", "value": {"u": list(U)}}
    assert found[1]["tick"] == round(1.3 * rig.world.rate_hz)
    assert len(found) == 7


def test_a_replay_gives_the_same_states(run: tuple[Path, Rig]) -> None:
    path, rig = run
    result = replay(path)
    assert result.difference is None
    assert not result.truncated
    assert result.ticks == rig.world.tick
    assert result.requests == 8
    assert result.hashes == rig.world.tick // rig.world.rate_hz + 1
    assert result.changed_versions == {}


def test_the_command_line_says_so(run: tuple[Path, Rig]) -> None:
    path, rig = run
    outcome = CliRunner().invoke(replay_command, [str(path)])
    assert outcome.exit_code == 0
    assert f"{rig.world.tick} ticks, 8 requests" in outcome.output
    as_json = json.loads(CliRunner().invoke(replay_command, [str(path), "--json"]).output)
    assert as_json["equal"] is True
    assert as_json["truncated"] is False


def test_reset_and_restore_are_replayed(tmp_path: Path) -> None:
    rig = Rig(Timing("freerun", paused=True))
    with rig.recording(tmp_path / "run.mcap"):
        rig.post(thrust())
        rig.clock("world/run_until", t_s=1.5)
        rig.call("world/snapshot", name="a")
        rig.clock("world/run_until", t_s=2.2)
        rig.call("world/restore", name="a")
        rig.post(thrust(tuple(-u for u in U)))
        rig.clock("world/run_until", t_s=2.5)
        rig.call("world/reset")
        rig.clock("world/run_until", t_s=1.1)
        rig.call("world/restore", name="a")  # forward in time
        rig.clock("world/resume")
        rig.call("world/reset")  # while it runs
        rig.clock("world/pause")
    result = replay(tmp_path / "run.mcap")
    assert result.difference is None
    assert result.hashes >= 1 + 2 + 1 + 1
    assert result.ticks >= 240 * (1.5 + 0.7 + 1.0 + 1.1)


def test_commands_of_one_pause_act_in_the_batches_in_which_they_came(tmp_path: Path) -> None:
    moved = Command("rov/teleport", ((1.0, 2.0, 3.0), None, None, None), "test:1")
    turned = Command("rov/teleport", (None, (0.0, 1.0, 0.0, 0.0), None, None), "test:1")
    places = []
    for name, batches in {"apart": [(moved,), (turned,)], "together": [(moved, turned)]}.items():
        rig = Rig(Timing("freerun", paused=True))
        with rig.recording(tmp_path / name):
            if len(batches) == 1:
                # Held back, so that both are taken at once.
                both_are_there = threading.Event()
                rig.simulation.steer(lambda there=both_are_there: there.wait(TIMEOUT_S))  # type: ignore[misc]
                for command in batches[0]:
                    rig.mailbox.post(command, None)
                both_are_there.set()
            else:
                for batch in batches:
                    rig.post(*batch)
            rig.call("world/state_hash")
        places.append(rig.world.vehicles["rov"].p_NB)
        assert replay(tmp_path / name).difference is None
    assert places[0] == pytest.approx((1.0, 2.0, 3.0))
    assert places[1] == pytest.approx((0.0, 0.0, 2.0))  # of several commands in one tick only the last acts


def test_a_crowd_in_real_time_is_replayed_in_the_ticks_in_which_each_was_carried_out(tmp_path: Path) -> None:
    """More than fits into the budget of a tick, and of everything that goes to another time."""
    rig = Rig(Timing(speed=20.0))
    replies: list[Any] = []
    with rig.recording(tmp_path / "run.mcap"):
        rig.call("world/snapshot", name="here")
        for n in range(120):
            for call in (Call("world/state_hash", {}, f"a:{n % 3}"), Call("world/restore", {"name": "here"}, "b:1")):
                rig.mailbox.post(call, replies.append)
            rig.mailbox.post(Command("rov/thrusters", ((n / 120,) * 8,), f"c:{n % 2}"), replies.append)
        rig.pump(lambda: len(replies) == 360)
        rig.clock("world/pause")
    assert not [reply.fault for reply in replies if reply.fault is not None]
    result = replay(tmp_path / "run.mcap")
    assert (result.difference, result.requests) == (None, 361)


def test_a_world_that_diverged_is_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "uwserver.world.stepping.commands.check_given", lambda *_: None
    )  # the port refuses such a speed
    rig = Rig(Timing("freerun", paused=True))
    with rig.recording(tmp_path / "run.mcap"):
        rig.clock("world/run_until", t_s=0.5)
        rig.post(Command("rov/teleport", (None, None, (1e200, 0.0, 0.0), None), "test:1"))
        rig.clock("world/run_until", t_s=1.0)
        assert "diverged" in rig.simulation.failure
        rig.call("world/reset")
        rig.clock("world/run_until", t_s=1.1)
    result = replay(tmp_path / "run.mcap")
    assert result.difference is None
    assert result.hashes == 2


def rewritten(source: Path, target: Path, change: Callable[[str, dict[str, Any]], dict[str, Any] | None]) -> None:
    """A copy of a recording, each entry changed, or left out for None."""
    with source.open("rb") as file, target.open("wb") as output:
        writer: Any = Writer(output)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, tuple[str, int]] = {}
        for record in StreamReader(file).records:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.message_encoding == "json" and record.id not in channels:
                channel = writer.register_channel(record.topic, record.message_encoding, schemas[record.schema_id])
                channels[record.id] = record.topic, channel
            elif isinstance(record, Message) and record.channel_id in channels:
                topic, channel = channels[record.channel_id]
                body = change(topic, json.loads(record.data))
                if body is not None:
                    writer.add_message(channel, record.log_time, json.dumps(body).encode(), record.publish_time)
        writer.finish()


def test_a_changed_command_is_found_at_the_next_hash(run: tuple[Path, Rig], tmp_path: Path) -> None:
    def change(topic: str, body: dict[str, Any]) -> dict[str, Any]:
        if topic == REQUESTS and body["tick"] == 312 and "value" in body:
            body["value"][0][0] += 1e-9
        return body

    rewritten(run[0], tmp_path / "changed.mcap", change)
    outcome = CliRunner().invoke(replay_command, [str(tmp_path / "changed.mcap")])
    assert outcome.exit_code == 1
    assert "differs in tick 480 (t = 2 s" in outcome.output
    assert "1 hashes equal" in outcome.output
    assert "expected" in outcome.output
    assert "the file was changed" in outcome.output


def test_a_changed_hash_is_found(run: tuple[Path, Rig], tmp_path: Path) -> None:
    def change(topic: str, body: dict[str, Any]) -> dict[str, Any]:
        return {**body, "hash": "0" * 64} if topic == HASHES and body["tick"] == 240 else body

    rewritten(run[0], tmp_path / "changed.mcap", change)
    difference = replay(tmp_path / "changed.mcap").difference
    assert difference is not None
    assert (difference.tick, difference.t_ns, difference.expected) == (240, 10**9, "0" * 64)


def test_a_missing_request_is_told(run: tuple[Path, Rig], tmp_path: Path) -> None:
    rewritten(
        run[0], tmp_path / "c.mcap", lambda topic, body: None if topic == REQUESTS and body["tick"] == 0 else body
    )
    with pytest.raises(NotReplayable, match="entry 0 is missing"):
        replay(tmp_path / "c.mcap")


def test_a_copy_without_changes_is_equal(run: tuple[Path, Rig], tmp_path: Path) -> None:
    rewritten(run[0], tmp_path / "copy.mcap", lambda topic, body: body)
    assert replay(tmp_path / "copy.mcap").difference is None


def test_a_damaged_file_is_told(run: tuple[Path, Rig], tmp_path: Path) -> None:
    content = bytearray(run[0].read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "damaged.mcap").write_bytes(content)
    outcome = CliRunner().invoke(replay_command, [str(tmp_path / "damaged.mcap")])
    assert outcome.exit_code == 1
    assert "damaged before byte" in outcome.output


@pytest.mark.parametrize("part", [0.5, 0.7, 0.9])
def test_a_cut_file_is_replayed_as_far_as_it_goes(run: tuple[Path, Rig], tmp_path: Path, part: float) -> None:
    """Of so short a file the first four tenths are the scenario with its files and the schemas: without them there is nothing to replay."""
    content = run[0].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: int(part * len(content))])
    outcome = CliRunner().invoke(replay_command, [str(tmp_path / "cut.mcap")])
    assert outcome.exit_code == 0, outcome.output
    assert "The recording has no end" in outcome.output


@pytest.mark.parametrize(
    ("content", "text"),
    [(b"", "this is an empty file"), (b"hello, this is no recording", "not an MCAP file"), (None, "No such file")],
)
def test_another_file_is_refused(tmp_path: Path, content: bytes | None, text: str) -> None:
    path = tmp_path / "other"
    if content is not None:
        path.write_bytes(content)
    outcome = CliRunner().invoke(replay_command, [str(path)])
    assert outcome.exit_code == 1
    assert text in outcome.output
    assert str(path) in outcome.output


def test_a_foreign_mcap_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(NotReplayable, match="not written by `uwserver run --record FILE`"):
        replay(tmp_path / "other.mcap")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"format": "uwserver-recording-9"}, "whose format is uwserver-recording-9; here it is uwserver-recording-3"),
        ({"physics": "1"}, f"whose physics is 1; here it is {PHYSICS}"),
        ({"scenario": '{"name": "x", "scenario": {"schema": 1, "colour": 3}, "vehicles": {}}'}, "does not fit"),
    ],
)
def test_another_format_or_schema_is_told(
    run: tuple[Path, Rig], tmp_path: Path, change: Mapping[str, str], text: str
) -> None:
    with run[0].open("rb") as file, (tmp_path / "x.mcap").open("wb") as output:
        head = next(record for record in StreamReader(file).records if isinstance(record, Metadata))
        writer: Any = Writer(output)
        writer.start()
        writer.add_metadata(head.name, {**head.metadata, **change})
        writer.finish()
    with pytest.raises(NotReplayable, match=text):
        replay(tmp_path / "x.mcap")


_SCRIPT = """
import importlib.util, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("recording_rig", {source!r})
rig_module = importlib.util.module_from_spec(spec)
sys.modules["recording_rig"] = rig_module
spec.loader.exec_module(rig_module)
rig_module.{function}(Path({path!r}))
"""


def until_killed(path: Path) -> None:
    """Body of the process that is killed."""
    rig = Rig(Timing("realtime", speed=20.0))
    with rig.recording(path) as recorder:
        rig.post(thrust())
        start = recorder.status()["bytes"]
        rig.pump(lambda: recorder.status()["bytes"] > start and rig.world.tick > 1000)  # type: ignore[operator]
        rig.post(thrust(tuple(-u for u in U)))
        seen = recorder.status()["bytes"]
        rig.pump(lambda: recorder.status()["bytes"] > seen)  # type: ignore[operator]
        print(msgspec.json.encode(recorder.status()).decode(), flush=True)
        rig.pump(lambda: False)


def until_full(path: Path) -> None:
    """Body of the process whose file may not grow."""
    import resource

    rig = Rig(Timing("freerun"))
    with rig.recording(path) as recorder:
        rig.post(thrust())
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
        rig.pump(lambda: recorder.status()["error"])
        tick = rig.world.tick
        rig.pump(lambda: rig.world.tick > tick + 1000)
    print(msgspec.json.encode(recorder.status()).decode(), flush=True)


def process(function: str, path: Path) -> subprocess.Popen[str]:
    script = _SCRIPT.format(source=__file__, function=function, path=str(path))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_a_killed_run_reads_and_replays_to_its_last_chunk(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with process("until_killed", path) as child:
        assert child.stdout is not None
        line = child.stdout.readline()
        child.kill()
        assert line, child.communicate()[1]
    told = json.loads(line)
    size = path.stat().st_size
    assert size >= told["bytes"]
    result = replay(path)
    assert result.truncated
    assert result.difference is None
    assert result.requests == 2
    assert result.hashes >= 4


def test_a_full_disk_ends_the_recording_and_not_the_world(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with process("until_full", path) as child:
        out, err = child.communicate(timeout=TIMEOUT_S)
    assert child.returncode == 0, err
    status = json.loads(out)
    assert status["recording"] is False
    assert "File too large" in status["error"]
    assert err.count(f"recording to {path} ended") == 1
    result = replay(path)
    assert result.truncated
    assert result.difference is None
    assert result.hashes > 0
