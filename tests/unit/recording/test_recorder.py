"""The recorder alone: its file, its queue, and what it does when it cannot write."""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.records import Message

from uwserver.adapter import AdapterTable
from uwserver.ports import Call, Command, Event, Field, Port, Sample
from uwserver.recording import output as output_module
from uwserver.recording import recorder as recorder_module
from uwserver.recording import writer as writer_module
from uwserver.recording.format import EVENTS, HASHES, METADATA, REQUESTS, head_of, metadata
from uwserver.recording.parts import Rotation
from uwserver.recording.reading import NotReplayable, Reading, head_record, parts_of
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import replay
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.build.world import build
from uwserver.scenario.load.export import engine_named
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation, Timing
from uwserver.world.state.snapshot import take

WAIT_S = 30.0
SAMPLE = Sample("rov/depth", 2**32 + 7, 10, 20, True, (1.5, None))


class RadioConfig(AdapterTable, tag="radio", kw_only=True, frozen=True):
    port: int = 1
    token: str = ""
    api_secret: str = ""


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 1.0))
    adapters = {"gcs": RadioConfig(port=5, token="sesame-1", api_secret="sesame-2")}
    scenario = Scenario(schema=1, title="test", seed=3, vehicles={"rov": vehicle}, adapters=adapters)
    return load(scenario, adapters={"radio": RadioConfig})


class Bench:
    """A recorder with a simulation that does not run: the test plays loop and simulation thread."""

    def __init__(self, path: Path, resolved: Resolved, timing: Timing) -> None:
        self.world = build(resolved)
        self.bus = Bus(lambda function: None)
        self.simulation = Simulation(self.world, timing, SystemTime(), self.bus, Mailbox())
        self.recorder = Recorder(path, self.world, resolved)

    def running(self) -> Any:
        return self.recorder.running(self.simulation, self.bus)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


@pytest.fixture
def bench(path: Path, resolved: Resolved) -> Bench:
    return Bench(path, resolved, Timing("realtime"))


@pytest.fixture
def stalled(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """A disk that does not answer until the event is set."""
    goes_on = threading.Event()
    sample, request = RecordingWriter.sample, RecordingWriter.request

    def slow_sample(self: RecordingWriter, *args: Any) -> None:
        goes_on.wait(WAIT_S)
        sample(self, *args)

    def slow_request(self: RecordingWriter, *args: Any) -> None:
        goes_on.wait(WAIT_S)
        request(self, *args)

    monkeypatch.setattr(RecordingWriter, "sample", slow_sample)
    monkeypatch.setattr(RecordingWriter, "request", slow_request)
    return goes_on


def messages(path: Path, topic: str) -> list[Message]:
    with path.open("rb") as file:
        return [message for _, _, message in make_reader(file).iter_messages(topics=[topic], log_time_order=False)]


def bodies(path: Path, topic: str) -> list[Any]:
    return [json.loads(message.data) for message in messages(path, topic)]


def test_samples_events_and_the_last_state_are_written(bench: Bench, path: Path) -> None:
    with bench.running():
        assert bench.recorder.status()["recording"] is True
        bench.recorder.put_samples([SAMPLE])
        bench.recorder.put_event(Event("paused", 4, 30, "why"))
    body = bodies(path, "rov/depth")[0]
    assert body == {
        "seq": 2**32 + 7,
        "t_ns": 10,
        "t_sent_ns": 20,
        "valid": True,
        "value": {"depth": 1.5, "temperature": None},
    }
    assert messages(path, "rov/depth")[0].sequence == 7
    assert bodies(path, EVENTS) == [{"event": "paused", "tick": 4, "t_ns": 30, "text": "why"}]
    assert bodies(path, HASHES) == [{"index": 0, "tick": 0, "hash": take(bench.world).hash()}]
    status = bench.recorder.status()
    assert status == {
        "path": str(path),
        "recording": False,
        "since_ns": 0,
        "samples": 1,
        "requests": 0,
        "bytes": path.stat().st_size,
        "parts": 1,
        "dropped": 0,
        "error": "",
    }


def test_requests_are_written_in_order_with_their_batch(bench: Bench, path: Path) -> None:
    with bench.running():
        bench.recorder.requested(Command("rov/thrusters", ((0.5,) * 8,), "a"), 7, 4)
        bench.recorder.requested(Call("world/state_hash", {"x": [1, 2.0, None]}, "b"), 7, 4)
        bench.recorder.requested(Command("rov/force_torque", (None, (1.0, 2.0, 3.0)), "a"), 7, 5)
    assert bodies(path, REQUESTS) == [
        {"index": 0, "batch": 4, "tick": 7, "source": "a", "port": "rov/thrusters", "value": [[0.5] * 8]},
        {
            "index": 1,
            "batch": 4,
            "tick": 7,
            "source": "b",
            "service": "world/state_hash",
            "args": {"x": [1, 2.0, None]},
        },
        {
            "index": 2,
            "batch": 5,
            "tick": 7,
            "source": "a",
            "port": "rov/force_torque",
            "value": [None, [1.0, 2.0, 3.0]],
        },
    ]
    assert messages(path, REQUESTS)[0].log_time == bench.world.ticks.time_of(7)


def test_the_scenario_comes_back_whole(bench: Bench, path: Path, resolved: Resolved) -> None:
    with bench.running():
        pass
    with path.open("rb") as file:
        record = next(record for record in make_reader(file).iter_metadata() if record.name == METADATA)
    head = head_of(record.metadata)
    assert head.seed == 3
    assert head.timing["mode"] == "realtime"
    assert head.versions.numba
    # What was off is not needed to run it again.
    assert head.resolved.vehicles == {name: replace(each, off=()) for name, each in resolved.vehicles.items()}
    assert msgspec.structs.replace(head.resolved.scenario, adapters={}) == msgspec.structs.replace(
        engine_named(resolved.scenario), adapters={}
    )
    assert head.resolved.scenario.adapters == {"gcs": {"kind": "radio", "port": 5, "truth": False, "required": True}}
    assert take(build(head.resolved, head.seed)).hash() == take(bench.world).hash()


def test_defaults_are_written_out(resolved: Resolved) -> None:
    whole = json.loads(metadata(resolved, 3, Timing())["scenario"])
    assert whole["scenario"]["world"]["rate_hz"] == 240.0
    assert whole["scenario"]["environment"]["gravity_mps2"] == 9.81


def test_no_secret_reaches_the_file(bench: Bench, path: Path) -> None:
    with bench.running():
        pass
    assert b"sesame" not in path.read_bytes()
    assert b"gcs" in path.read_bytes()


def test_an_existing_file_is_never_overwritten(bench: Bench, path: Path) -> None:
    path.write_text("precious")
    with (
        pytest.raises(FileExistsError, match="it exists already; give --record another name") as caught,
        bench.running(),
    ):
        pass
    assert str(path) in str(caught.value)
    assert path.read_text() == "precious"


def test_a_folder_that_is_missing_is_told(tmp_path: Path, resolved: Resolved) -> None:
    bench = Bench(tmp_path / "missing" / "run.mcap", resolved, Timing())
    with (
        pytest.raises(OSError, match=r"cannot record to .*missing/run\.mcap: No such file or directory"),
        bench.running(),
    ):
        pass


def test_a_disk_that_is_full_at_the_start_is_told(bench: Bench, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: RecordingWriter) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RecordingWriter, "flush", full)
    with pytest.raises(OSError, match=r"run\.mcap: No space left on device"), bench.running():
        pass
    assert not path.exists()


def test_a_start_that_fails_leaves_no_file_behind(bench: Bench, path: Path) -> None:
    with contextlib.suppress(KeyError), bench.running():
        assert path.exists()
        raise KeyError("an adapter cannot start")
    assert not path.exists()


def test_a_run_that_fails_keeps_its_file(bench: Bench, path: Path) -> None:
    with contextlib.suppress(KeyError), bench.running():
        bench.recorder.put_samples([SAMPLE])
        raise KeyError("later")
    assert len(messages(path, "rov/depth")) == 1


def test_real_time_drops_samples_but_no_request_when_the_disk_is_slow(
    bench: Bench,
    path: Path,
    stalled: threading.Event,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_SAMPLES", 10)
    with bench.running():
        for _ in range(15):
            bench.recorder.put_samples([SAMPLE, SAMPLE])
            bench.recorder.requested(Call("world/state_hash", {}, "a"), 1, 0)
        bench.world.tick = 240
        bench.recorder.ticked(bench.world)  # returns although the queue is full
        assert bench.recorder.status()["dropped"] == 20
        stalled.set()
    assert len(messages(path, "rov/depth")) == 10
    assert len(messages(path, REQUESTS)) == 15
    assert len(messages(path, HASHES)) == 2
    assert any("20 of 30 samples are missing" in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize("timing", [Timing("freerun"), Timing("lockstep"), Timing("realtime", paused=True)])
def test_without_a_wall_clock_the_tick_waits_and_nothing_is_lost(
    path: Path, resolved: Resolved, stalled: threading.Event, monkeypatch: pytest.MonkeyPatch, timing: Timing
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_SAMPLES", 10)
    bench = Bench(path, resolved, timing)
    with bench.running():
        for _ in range(15):
            bench.recorder.put_samples([SAMPLE, SAMPLE])
        bench.world.tick = 1
        tick = threading.Thread(target=bench.recorder.ticked, args=(bench.world,), daemon=True)
        tick.start()
        tick.join(0.05)
        assert tick.is_alive()
        stalled.set()
        tick.join(WAIT_S)
        assert not tick.is_alive()
    assert bench.recorder.status()["dropped"] == 0
    assert len(messages(path, "rov/depth")) == 30


def test_samples_and_commands_of_a_body_that_is_gone_are_written(
    bench: Bench, path: Path, stalled: threading.Event
) -> None:
    with bench.running():
        bench.recorder.put_samples([SAMPLE])  # at which the writer waits
        bench.world.call("world/spawn", name="guest", like="rov", p_NB=[5.0, 0.0, 2.0])
        bench.recorder.requested(Command("guest/thrusters", ((0.1,) * 8,), "a"), 1, 0)
        bench.recorder.ticked(bench.world)
        bench.recorder.put_samples([msgspec.structs.replace(SAMPLE, port="guest/depth")])
        bench.world.call("world/remove", name="guest")
        bench.recorder.ticked(bench.world)
        bench.recorder.put_samples([SAMPLE])
        stalled.set()
    assert bench.recorder.status()["error"] == ""
    assert [len(messages(path, topic)) for topic in ("rov/depth", "guest/depth", "guest/thrusters")] == [2, 1, 1]


def test_a_name_may_go_to_another_kind_with_other_fields(bench: Bench, path: Path, stalled: threading.Event) -> None:
    """Each kind has a channel of its own, also for what comes late, and the first goes on when it is there again."""
    eye = Port("guest/eye", "sensor", "eye", (Field("range", "m", "distance"),), "Eye.", 10.0)
    ear = Port("guest/eye", "sensor", "ear", (Field("level", "1", "sound"), Field("pitch", "Hz", "tone")), "Ear.", 10.0)
    arm = Port("guest/eye", "actuator", "arm", (Field("angle", "rad", "of it"),), "Arm.")
    seen, heard = (msgspec.structs.replace(SAMPLE, port="guest/eye", value=value) for value in ((1.5,), (0.2, 440.0)))

    def now(port: Port) -> None:
        bench.world.ports = bench.world.ports | {port.path: port}
        bench.recorder.ticked(bench.world)

    with bench.running():
        bench.recorder.put_samples([SAMPLE])  # at which the writer waits
        now(eye)
        now(ear)
        bench.recorder.put_samples([seen])  # of a tick before
        bench.recorder.put_samples([heard])
        now(msgspec.structs.replace(eye, rate_hz=5.0))
        bench.recorder.put_samples([seen])
        now(arm)
        bench.recorder.requested(Command("guest/eye", ((0.5,),), "a"), 1, 0)
        bench.recorder.requested(Command("guest/eye", ((0.5,), (0.5,)), "a"), 1, 0)  # was checked for another kind
        stalled.set()
    assert bench.recorder.status()["error"] == ""
    with path.open("rb") as file:
        reader = make_reader(file)
        kinds = {c.id: c.metadata["kind"] for c in reader.get_summary().channels.values() if c.topic == "guest/eye"}
        told = [
            (kinds[c.id], json.loads(m.data)["value"])
            for _, c, m in reader.iter_messages(["guest/eye"], log_time_order=False)
        ]
    assert told == [
        ("eye", {"range": 1.5}), ("ear", {"level": 0.2, "pitch": 440.0}), ("eye", {"range": 1.5}), ("arm", {"angle": 0.5}),
    ]  # fmt: skip
    assert len(messages(path, REQUESTS)) == 2


def test_more_channels_than_the_format_has_end_the_recording_with_a_reason(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, path: Path
) -> None:
    monkeypatch.setattr(writer_module, "MAX_CHANNELS", len(bench.world.ports) + 8)
    with bench.running():
        for n in range(4):
            port = Port(f"guest{n}/eye", "sensor", "eye", (Field("range", "m", "distance"),), "Eye.", 10.0)
            bench.world.ports = bench.world.ports | {port.path: port}
            bench.recorder.ticked(bench.world)
            bench.recorder.put_samples([msgspec.structs.replace(SAMPLE, port=port.path, value=(1.0,))])
    assert "reuse the names of removed bodies" in str(bench.recorder.status()["error"])
    assert not bench.recorder.is_complete
    assert sum("the world continues without it" in record.getMessage() for record in caplog.records) == 1
    assert not any(record.exc_info for record in caplog.records), "it is no fault of ours"


def test_a_flood_of_requests_ends_the_recording_with_a_reason(
    bench: Bench, stalled: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_REQUESTS", 5)
    with bench.running():
        for _ in range(7):
            bench.recorder.requested(Call("world/state_hash", {}, "a"), 1, 0)
        assert "5 commands and calls wait" in str(bench.recorder.status()["error"])
        assert bench.recorder.status()["recording"] is False
        stalled.set()


def test_a_disk_that_fails_later_ends_the_recording_once(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    failed = threading.Event()

    def fail(self: RecordingWriter, *args: Any) -> None:
        failed.set()
        raise OSError(5, "Input/output error")

    with bench.running():
        monkeypatch.setattr(RecordingWriter, "sample", fail)
        bench.recorder.put_samples([SAMPLE])
        assert failed.wait(WAIT_S)
        for thread in threading.enumerate():
            if thread.name == "recorder":
                thread.join(WAIT_S)
        bench.recorder.put_samples([SAMPLE])
        bench.recorder.requested(Call("world/state_hash", {}, "a"), 1, 0)
        bench.recorder.ticked(bench.world)
        assert bench.recorder.status()["recording"] is False
    errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert len(errors) == 1
    assert "ended: Input/output error; the world continues" in errors[0]


def test_no_thread_is_left(bench: Bench) -> None:
    with bench.running():
        assert "recorder" in [thread.name for thread in threading.enumerate()]
    assert "recorder" not in [thread.name for thread in threading.enumerate()]


def in_parts(path: Path, resolved: Resolved, rotation: Rotation, seconds: int) -> Recorder:
    """A run of so many seconds, stepped by the test, with a push in each; each state is written before the next second begins."""
    world = build(resolved)
    bus = Bus(lambda function: None)
    simulation = Simulation(world, Timing("freerun"), SystemTime(), bus, Mailbox())
    recorder = Recorder(path, world, resolved, rotation)
    with recorder.running(simulation, bus):
        for second in range(seconds):
            push = Command("rov/thrusters", ((0.1 * second,) * 8,), "me")
            recorder.requested(push, world.tick, second)
            world.submit(push)
            for _ in range(240):
                output = world.advance()
                recorder.ticked(world)
                recorder.put_samples(output.samples)
    assert recorder.is_complete
    return recorder


def test_a_recording_goes_on_in_parts_of_which_each_is_whole(path: Path, resolved: Resolved) -> None:
    recorder = in_parts(path, resolved, Rotation(most_s=2.0), 5)
    parts = [path, path.with_name("run.0002.mcap"), path.with_name("run.0003.mcap")]
    assert sorted(path.parent.iterdir()) == sorted(parts)
    assert recorder.status()["parts"] == 3
    assert recorder.status()["bytes"] == sum(part.stat().st_size for part in parts)
    for part, ticks in zip(parts, (480, 480, 240), strict=True):
        with part.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
            assert summary is not None
            assert summary.statistics is not None
        alone = replay(part) if part != path else None
        assert alone is None or (alone.difference, alone.ticks, alone.truncated) == (None, ticks, False)
    together = replay(path)
    assert (together.difference, together.ticks, together.hashes, together.requests) == (None, 1200, 6, 5)
    with Reading(path) as reading:
        indices = [entry.index for entry in reading.entries()]
    assert indices == list(range(11))


def test_parts_grow_to_their_size(path: Path, resolved: Resolved) -> None:
    in_parts(path, resolved, Rotation(most_bytes=1), 4)
    assert len(list(path.parent.iterdir())) == 5, "a new one each second, the smallest there can be"
    assert replay(path).difference is None


def test_a_part_that_is_missing_is_told_and_one_of_another_run_is_not_taken(path: Path, resolved: Resolved) -> None:
    in_parts(path, resolved, Rotation(most_s=1.0), 3)
    second, third = path.with_name("run.0002.mcap"), path.with_name("run.0003.mcap")
    kept = second.read_bytes()
    second.unlink()
    with pytest.raises(NotReplayable, match=r"its part run\.0002\.mcap is missing, but run\.0003\.mcap exists"):
        replay(path)
    assert replay(third).difference is None
    second.write_bytes(kept)
    other = path.with_name("other.mcap")
    in_parts(other, resolved, Rotation(most_s=1.0), 1)
    (path.parent / "run.0004.mcap").unlink()
    (path.parent / "other.0002.mcap").rename(path.parent / "run.0004.mcap")
    assert parts_of(path) == (path, second, third)


def test_files_of_an_older_run_in_parts_are_not_overwritten(path: Path, resolved: Resolved) -> None:
    path.with_name("run.0007.mcap").write_text("dive")
    with pytest.raises(FileExistsError, match=r"run\.0007\.mcap: it exists already"):
        in_parts(path, resolved, Rotation(most_s=1.0), 1)
    assert not path.exists()


def test_a_disk_that_is_full_at_the_next_part_ends_the_recording(
    path: Path, resolved: Resolved, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Path:
        return path.parent / "gone" / "run.0002.mcap"

    monkeypatch.setattr(output_module, "part_path", full)
    with pytest.raises(AssertionError):
        in_parts(path, resolved, Rotation(most_s=1.0), 2)
    done = replay(path)
    assert (done.difference, done.truncated, done.hashes) == (None, True, 1)


def test_a_world_that_is_stepped_is_recorded_without_a_thread(path: Path, resolved: Resolved) -> None:
    world = build(resolved, 1)
    recorder = Recorder(path, world, resolved)
    call = Call(
        "world/set_fault", {"name": "f", "kind": "thruster_dead", "target": "rov/thrusters", "parameters": {}}, "me"
    )
    push = Command("rov/thrusters", ((0.5,) * 8,), "me")
    threads = threading.active_count()
    with recorder.stepped(Timing("freerun"), {"replay_of": "x.mcap"}):
        for tick in range(241):
            for item in (call, push) if tick == 3 else ():
                recorder.requested(item, tick, 0)
                world.submit(item)
            output = world.advance()
            recorder.ticked(world)
            for event in output.events:
                recorder.put_event(event)
            recorder.put_samples(output.samples)
            recorder.drain()
            assert threading.active_count() == threads
    assert recorder.is_complete
    assert [(r["index"], r["tick"]) for r in bodies(path, REQUESTS)] == [(0, 3), (1, 3)]
    assert [(h["index"], h["tick"]) for h in bodies(path, HASHES)] == [(2, 240), (3, 241)]
    assert [e["event"] for e in bodies(path, EVENTS)] == ["fault"]
    assert len(bodies(path, "rov/imu")) == 120
    assert head_record(path)["replay_of"] == "x.mcap"
    assert replay(path).difference is None


def test_ports_that_come_while_it_is_made_have_their_samples_written(
    resolved: Resolved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who records in the midst of a run makes it beside the simulation thread, which goes on."""
    world = build(resolved)

    class Slow(output_module.Output):
        def __init__(self, *args: Any, **more: Any) -> None:
            super().__init__(*args, **more)
            world.call("world/spawn", name="second", like="rov", p_NB=[3.0, 0.0, 2.0])

    monkeypatch.setattr(recorder_module, "Output", Slow)
    recorder = Recorder(tmp_path / "run.mcap", world, resolved)
    simulation = Simulation(world, Timing("freerun"), SystemTime(), Bus(lambda call: None), Mailbox())
    recorder.open(simulation.timing)
    state = recorder.begin(simulation)
    recorder.write_from(state)
    recorder.put_samples((Sample("second/depth", 7, 10, 20, True, SAMPLE.value),))
    recorder.end()
    recorder.close()
    assert (recorder.status()["error"], recorder.status()["samples"]) == ("", 1)


def test_a_world_that_nothing_paces_makes_ticks_in_one_go_while_it_is_recorded(
    tmp_path: Path, resolved: Resolved, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is that of single ticks: all samples, where the bodies are each few ticks, and the state of each second."""
    files, lengths = [], []
    for name in ("single", "free"):
        if name == "single":
            monkeypatch.setattr(Recorder, "next_tick", lambda recorder, tick: tick + 1)
        else:
            monkeypatch.undo()
        bench = Bench(tmp_path / f"{name}.mcap", resolved, Timing("freerun"))
        calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
        bench.bus._wake_loop = calls.put
        bench.simulation.until_tick = 600
        made, advance = [], bench.world.advance

        def counted(*given: Any, made: Any = made, advance: Any = advance, **named: Any) -> Any:
            output = advance(*given, **named)
            made.append(output.ticks)
            return output

        monkeypatch.setattr(bench.world, "advance", counted)
        with bench.running():
            thread = threading.Thread(target=bench.simulation.run)
            thread.start()
            while thread.is_alive():
                with contextlib.suppress(queue.Empty):
                    calls.get(timeout=0.01)()
            bench.bus.drain()
        assert sum(made) == 600
        lengths.append(max(made))
        with bench.recorder.path.open("rb") as file:
            found = make_reader(file).iter_messages(log_time_order=False)
            files.append(sorted((channel.topic, message.sequence, message.data) for _, channel, message in found))
    assert lengths[0] == 1 < lengths[1]
    assert files[0] == files[1]
    topics = [topic for topic, _, _ in files[0]]
    assert (topics.count("rov/imu"), topics.count(HASHES)) == (299, 3), "the last is under way yet"
