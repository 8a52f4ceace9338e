"""A recording as a track: the same samples at the same times, from any instant, over jumps of time. Also of uwserver.recording.player.messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playback_rig import Dive, recorded

from uwserver.ports import Buffer, Field, Layout, Port, Sample
from uwserver.recording import writer as writer_module
from uwserver.recording.player import track as track_module
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.messages import _decoder
from uwserver.recording.player.track import Track


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dive]:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    return path, recorded(path)


def script(dive: Dive) -> None:
    dive.go(300)
    dive.call("world/reset")
    dive.push(0.3)
    dive.go(200)
    dive.call("world/snapshot", name="here")
    dive.go(50)
    dive.call("world/restore", name="here")
    dive.go(100)


@pytest.fixture(scope="module", params=[0, 70])
def jumping(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> tuple[Path, Dive]:
    path = tmp_path_factory.mktemp("jumping") / "run.mcap"
    return path, recorded(path, script=script, lag=request.param)


def played(track: Track) -> list[Sample]:
    found = []
    while track.head_item is not None:
        item = track.pop()
        if item.type == "sample":
            sample = track.messages.sample(item.message, track.scenes[-1].ports)
            if sample is not None:
                found.append(sample)
    return found


def test_all_samples_come_as_they_were(run: tuple[Path, Dive]) -> None:
    track = Track(run[0])
    assert played(track) == run[1].samples[0]
    assert len(run[1].samples[0]) > 400
    assert track.messages.damaged == 0
    assert track.remarks == ()
    track.close()


@pytest.mark.parametrize("t_s", [0.0, 0.005, 0.5, 1.0, 1.9999, 2.0])
def test_a_seek_gives_the_last_of_each_port_and_then_what_is_later(run: tuple[Path, Dive], t_s: float) -> None:
    track, t_ns = Track(run[0]), round(t_s * 1e9)
    before = [s for s in run[1].samples[0] if s.t_sent_ns <= t_ns]
    messages = track.seek(0, t_ns)
    found = [s for s in (track.messages.sample(m, track.scenes[0].ports) for m in messages) if s is not None]
    assert {s.port: s for s in found} == {s.port: s for s in before}
    state = track.state
    if t_s > 0.01:
        assert state is not None
        assert 0 <= t_ns - state.t_ns < 40_000_000
        np.testing.assert_array_equal(state.poses, run[1].poses[0, state.t_ns])
    assert played(track) == [s for s in run[1].samples[0] if s.t_sent_ns > t_ns]
    track.close()


def test_states_come_in_the_order_of_time_with_the_samples(run: tuple[Path, Dive]) -> None:
    track, last, states = Track(run[0]), -1, 0
    while (item := track.head_item) is not None:
        assert item.t_ns >= last
        last = track.pop().t_ns
        states += item.type == "state"
    assert 58 <= states <= 64
    track.close()


def test_runs_between_jumps_are_told_and_can_each_be_sought(jumping: tuple[Path, Dive]) -> None:
    track, dive = Track(jumping[0]), jumping[1]
    assert len(track.runs) == len(dive.samples) == 3
    for k, (run, samples) in enumerate(zip(track.runs, dive.samples, strict=True)):
        assert abs(run.to_ns - samples[-1].t_sent_ns) < 10_000_000, k
        middle = (run.from_ns + run.to_ns) // 2
        messages = track.seek(k, middle)
        found = [s for s in (track.messages.sample(m, track.scenes[0].ports) for m in messages) if s is not None]
        assert {s.port: s for s in found} == {s.port: s for s in samples if s.t_sent_ns <= middle}
        rest = [s for s in samples if s.t_sent_ns > middle] + [s for later in dive.samples[k + 1 :] for s in later]
        assert track.state is not None
        np.testing.assert_array_equal(track.state.poses, dive.poses[k, track.state.t_ns])
        assert played(track) == rest
        assert track.run == 2
    marks = [mark for mark in track.marks() if mark.event.event == "reset"]
    assert [mark.run for mark in marks] == [1, 2]
    track.close()


def test_all_states_of_a_run_come_after_its_begin(jumping: tuple[Path, Dive]) -> None:
    """Also those that stand in the file before the jump with which it begins."""
    track = Track(jumping[0])
    track.seek(1, track.runs[1].from_ns)
    states = []
    while (item := track.head_item) is not None and item.type != "jump":
        if track.pop().type == "state":
            assert track.state is not None
            states.append(track.state.t_ns)
    assert states == sorted(states)
    assert len(states) >= 30 * (track.runs[1].to_ns * 1e-9) - 2
    track.close()


def test_commands_that_the_file_has_early_do_not_move_time(tmp_path: Path) -> None:
    def script(dive: Dive) -> None:
        for _ in range(4):
            dive.go(60)
            dive.push(0.2)

    recorded(tmp_path / "x.mcap", script=script, lag=70)
    track = Track(tmp_path / "x.mcap")
    while track.head_item is not None:
        item = track.pop()
        if item.type == "sample":
            assert item.t_ns == item.message.t_ns
    track.close()


def test_a_seek_unpacks_a_handful_of_chunks_of_a_long_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 2000)
    recorded(tmp_path / "x.mcap", ticks=960)
    track = Track(tmp_path / "x.mcap")
    chunks = track._chunks._parts[0].file
    assert len(chunks.chunks) > 80
    unpacked: list[int] = []
    whole = chunks._unpacked
    monkeypatch.setattr(chunks, "_unpacked", lambda chunk: (unpacked.append(chunk.offset), whole(chunk))[1])
    track.seek(0, 3_000_000_000)
    assert 0 < len(unpacked) < 12
    track.close()


def test_a_file_that_was_cut_is_played_as_far_as_it_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4000)
    dive = recorded(tmp_path / "x.mcap")
    whole = Track(tmp_path / "x.mcap")
    end = whole._chunks.chunks[-5].offset + 30
    whole.close()
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "x.mcap").read_bytes()[:end])
    track = Track(tmp_path / "cut.mcap")
    found = played(track)
    assert len(found) > 100
    assert found == dive.samples[0][: len(found)]
    assert "no index" in track.remarks[0]
    track.close()


def test_names_are_changed_everywhere(run: tuple[Path, Dive]) -> None:
    track = Track(run[0], {"rov": "ghost"})
    scene = track.scenes[0]
    assert {path.partition("/")[0] for path in scene.ports} == {"ghost"}
    assert [body.name for body in scene.bodies] == ["ghost"]
    assert scene.entities.vehicles[0].like == "rov"
    assert any(path.startswith("ghost/") for path in scene.services)
    assert not any(path.startswith("rov/") for path in scene.services)
    assert len(played(track)) == len(run[1].samples[0])
    track.close()


def test_names_of_nobody_are_refused(run: tuple[Path, Dive]) -> None:
    with pytest.raises(NotPlayable, match='no body has the name "auv"; there are: rov'):
        Track(run[0], {"auv": "ghost"})


def test_damaged_messages_are_left_out_and_counted(run: tuple[Path, Dive], monkeypatch: pytest.MonkeyPatch) -> None:
    track = Track(run[0])
    ports = track.scenes[0].ports
    first = next(iter(track._chunks.messages(0)))
    imu = next(n for n, c in track._chunks.channels.items() if c.topic == "rov/imu")
    for data in (b"", b"{", b'{"seq": 1}', b"[" * 100_000, b'{"seq":1,"t_ns":1,"t_sent_ns":1,"valid":true,"value":{}}'):
        assert track.messages.sample(first._replace(channel=imu, data=data), ports) is None
    assert track.messages.damaged == 5
    track.show(first._replace(data=b"x"))
    assert track.messages.damaged == 6
    track.close()


def test_an_empty_recording_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(NotPlayable, match="not written by"):
        Track(path)


def test_fields_of_all_types_come_back() -> None:
    fields = (
        Field("class", "1", "a word of Python"), Field("v", "m", "vector", "B", (2,)), Field("n", "1", "count", type="int"),
        Field("text", "1", "text", type="str"), Field("raw", "1", "bytes", type="bytes"),
        Field("pic", "1", "picture", type="buffer", buffer=Layout("uint8", (2, 1))),
    )  # fmt: skip
    import msgspec

    value = (1.5, (1.0, None), 3, "é", Buffer(data=b"ab"), Buffer(dtype="uint8", shape=(2, 1), data=b"\0\1"))
    message = {
        "seq": 1, "t_ns": 2, "t_sent_ns": 3, "valid": True,
        "value": dict(zip([f.name for f in fields], value, strict=True)),
    }  # fmt: skip
    said = _decoder(fields).decode(msgspec.json.encode(message))
    assert msgspec.structs.astuple(said.value) == value
    nothing = {**message, "value": dict.fromkeys([f.name for f in fields])}
    assert msgspec.structs.astuple(_decoder(fields).decode(msgspec.json.encode(nothing)).value) == (None,) * 6


def test_a_port_of_the_same_name_with_other_fields_is_another(run: tuple[Path, Dive]) -> None:
    track = Track(run[0])
    ports = {"rov/imu": Port("rov/imu", "sensor", "imu", (Field("other", "1", "field"),), "Imu.", 1.0)}
    message = next(m for m in track._chunks.messages(0) if track.messages.topic(m) == "rov/imu")
    assert track.messages.sample(message, ports) is None
    assert track.messages.sample(message, track.scenes[0].ports) is not None
    track.close()


def test_events_of_a_flood_are_bounded(run: tuple[Path, Dive], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(track_module, "MOST_MARKS", 0)
    track = Track(run[0])
    assert track.marks() == []
    track.close()


def test_right_after_a_jump_nobody_is_where_the_run_before_had_them(jumping: tuple[Path, Dive]) -> None:
    track = Track(jumping[0])
    assert len(track.runs) == 3
    track.seek(2, track.runs[2].from_ns)
    assert track.runs[2].from_ns > 500_000_000, "a time that the run before had, too"
    assert track.state is None
    track.close()
