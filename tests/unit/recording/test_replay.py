"""Replay of small recordings made here: the same run, the first place at which another differs, and files that cannot be followed."""

from __future__ import annotations

import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import zstandard

from uwserver.physics.collision.engine import chosen_engine
from uwserver.ports import Call, Command
from uwserver.recording import replay as replay_module
from uwserver.recording.format import Request, StateHash, metadata, versions_here
from uwserver.recording.replay import NotReplayable, Replayed, replay
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.simulation.clock import Timing
from uwserver.world.sensing import sensing
from uwserver.world.state import snapshot

PUSH = Command("rov/thrusters", ((0.5,) * 8,), "me")
SEED = 5


def entries(resolved) -> list[Request | StateHash]:
    """A run of 20 ticks: a push at tick 3, two requests of one batch at tick 10, hashes at 5 and 20."""
    world = build(resolved, SEED)
    found: list[Request | StateHash] = []
    for tick in range(20):
        if tick == 3:
            found.append(Request.of(PUSH, len(found), 0, tick))
            world.submit(PUSH)
        if tick == 10:
            for item in (Command(PUSH.port, ((-0.5,) * 8,), "me"), PUSH):
                found.append(Request.of(item, len(found), 1, tick))
                world.submit(item)
        world.step()
        if world.tick in (5, 20):
            found.append(StateHash(len(found), world.tick, snapshot.take(world).hash()))
    return found


def recorded(path: Path, resolved, run: list[Request | StateHash], end: bool = True) -> Path:
    with path.open("wb") as file:
        writer = RecordingWriter(file, metadata(resolved, SEED, Timing()), {})
        for entry in run:
            if isinstance(entry, Request):
                writer.request(entry, entry.tick, {})
            else:
                writer.hash(entry, entry.tick)
        if end:
            writer.finish()
        else:
            writer.flush()
    return path


def test_the_same_run_gives_the_same_states(resolved, tmp_path: Path):
    done = replay(recorded(tmp_path / "run.mcap", resolved, entries(resolved)))
    assert (done.ticks, done.requests, done.hashes) == (20, 3, 2)
    assert (done.difference, done.truncated, done.changed_versions) == (None, False, {})


def test_what_nobody_reads_is_not_made(resolved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = recorded(tmp_path / "run.mcap", resolved, entries(resolved))
    made: list[object] = []
    monkeypatch.setattr(sensing, "SampleBatch", lambda *parts: made.append(parts))
    assert replay(path).difference is None
    assert made == []


def test_a_recording_without_an_end_is_followed_as_far_as_it_goes(resolved, tmp_path: Path):
    done = replay(recorded(tmp_path / "run.mcap", resolved, entries(resolved), end=False))
    assert (done.hashes, done.difference, done.truncated) == (2, None, True)


def test_the_first_difference_is_told_and_ends_the_replay(resolved, tmp_path: Path):
    run = entries(resolved)
    run[0] = Request.of(Command(PUSH.port, ((0.4,) * 8,), "me"), 0, 0, 3)
    done = replay(recorded(tmp_path / "run.mcap", resolved, run))
    assert done.difference is not None
    assert (done.difference.tick, done.difference.index, done.hashes) == (5, 1, 0)
    assert done.difference.expected == run[1].hash
    assert done.difference.found != run[1].hash
    assert done.ticks == 5


def test_a_hash_of_a_tick_that_is_past_is_a_difference(resolved, tmp_path: Path):
    run = [*entries(resolved), StateHash(5, 7, "0")]
    done = replay(recorded(tmp_path / "run.mcap", resolved, run))
    assert done.difference is not None
    assert (done.difference.expected, done.difference.found) == ("a world at tick 7", "a world at tick 20")


def test_a_missing_entry_is_not_passed_over(resolved, tmp_path: Path):
    run = entries(resolved)
    del run[1]
    with pytest.raises(NotReplayable, match="entry 1 is missing before tick 10"):
        replay(recorded(tmp_path / "run.mcap", resolved, run))


def test_a_recording_whose_engine_is_not_installed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of what touches nothing none is needed."""
    text = 'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\nposition_ned_m = [0, 0, 2]\n'
    for name, seabed in (("bare", ""), ("solid", '[seabed]\nkind = "flat"\ndepth_m = 20.0\n')):
        (tmp_path / f"{name}.toml").write_text(text + seabed)
    bare, solid = (
        recorded(tmp_path / f"{name}.mcap", load(tmp_path / f"{name}.toml", adapters={}), [])
        for name in ("bare", "solid")
    )
    engine = chosen_engine()
    monkeypatch.setattr("uwserver.physics.collision.engine.find_spec", lambda name: None)
    assert replay(bare).difference is None
    with pytest.raises(
        NotReplayable, match=f'solid.mcap: its contacts cannot .*: the engine "{engine}" needs .*: .* -m pip'
    ):
        replay(solid)


def test_a_service_that_is_no_more_is_told(resolved, tmp_path: Path):
    run = [Request.of(Call("world/dance", {}, "me"), 0, 0, 3)]
    with pytest.raises(NotReplayable, match='tick 3 calls "world/dance", which this version'):
        replay(recorded(tmp_path / "run.mcap", resolved, run))


@pytest.mark.parametrize(
    ("content", "told"),
    [(b"", "not an MCAP file"), (b"hello world", "not an MCAP file"), (b"\x89MCAP0\r\n", "not written by")],
)
def test_another_file_is_named(content: bytes, told: str, tmp_path: Path):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(NotReplayable, match=told) as refused:
        replay(path)
    assert str(path) in str(refused.value)


def test_what_changed_since_is_named(resolved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = recorded(tmp_path / "run.mcap", resolved, entries(resolved)[:1])
    later = msgspec.structs.replace(versions_here(), numba="99", started_utc="later")
    monkeypatch.setattr(replay_module, "versions_here", lambda: later)
    done: Replayed = replay(path)
    assert done.changed_versions == {"numba": (versions_here().numba, "99")}
    assert (done.requests, done.hashes) == (1, 0), "requests at the end are carried out too"


def test_a_hash_of_a_tick_far_ahead_is_not_waited_for(resolved, tmp_path: Path):
    path = recorded(tmp_path / "run.mcap", resolved, [StateHash(0, 10**12, "")])
    with pytest.raises(NotReplayable, match="no entry between the ticks 0 and 1000000000000"):
        replay(path)


@pytest.mark.parametrize("claimed", [1 << 40, 0])
def test_a_chunk_that_grows_without_end_is_not_unpacked(claimed: int, resolved, tmp_path: Path):
    """A gigabyte of zeros in a chunk of 30 kB: what the chunk says of its size, and what its frame says."""
    path = recorded(tmp_path / "run.mcap", resolved, entries(resolved)[:1], end=False)
    packed = zstandard.ZstdCompressor().compress(bytes(1 << 30))
    body = struct.pack("<QQQII", 0, 0, claimed, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    with path.open("ab") as file:
        file.write(b"\x06" + struct.pack("<Q", len(body)) + body)
    tracemalloc.start()
    try:
        with pytest.raises(NotReplayable, match=r"a chunk of .* bytes, at most 268435456"):
            replay(path)
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("make", "told"), [(os.mkfifo, "not a regular file"), (Path.mkdir, "not a regular file"), (lambda p: p.symlink_to(p), "Too many")]
)  # fmt: skip
def test_what_is_no_file_is_told_and_not_waited_for(make: Callable[[Path], object], told: str, tmp_path: Path):
    make(tmp_path / "run.mcap")
    with pytest.raises(OSError, match=told):
        replay(tmp_path / "run.mcap")
