"""A recording in several files that is played as one: every sample once, over the seams, from any instant, and while it is still written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playback_rig import Deck, Dive, pool, recorded

from uwserver.recording.parts import Rotation
from uwserver.recording.player.chunks import NotPlayable, PartChunks
from uwserver.recording.player.track import Track


def script(dive: Dive) -> None:
    dive.push(0.4)
    dive.go(500)
    dive.call("world/reset")
    dive.go(500)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dive]:
    path = tmp_path_factory.mktemp("parts") / "run.mcap"
    return path, recorded(path, script=script, rotation=Rotation(most_s=1.0))


def part(path: Path, number: int) -> Path:
    return path.with_name(f"run.{number:04d}.mcap")


def test_all_samples_come_once_and_nobody_leaves_at_a_seam(run: tuple[Path, Dive]) -> None:
    path, dive = run
    assert part(path, 4).exists()
    deck = Deck(path)
    assert len(deck.track.runs) == 2
    deck.play()
    assert deck.samples == dive.samples[0] + dive.samples[1]
    assert [event.event for event in deck.events] == ["watchdog", "reset", "paused"]
    assert len(deck.track.scenes) == 1
    assert deck.track.messages.damaged == 0
    deck.close()


@pytest.mark.parametrize(("number", "t_s"), [(0, 0.5), (0, 1.0), (0, 1.5), (0, 2.05), (1, 0.5), (1, 1.0), (1, 2.0)])
def test_a_seek_finds_its_part(run: tuple[Path, Dive], number: int, t_s: float) -> None:
    path, dive = run
    track, t_ns = Track(path), round(t_s * 1e9)
    before = {s.port: s for s in dive.samples[number] if s.t_sent_ns <= t_ns}
    messages = track.seek(number, t_ns)
    found = [s for s in (track.messages.sample(m, track.scenes[0].ports) for m in messages) if s is not None]
    assert {s.port: s for s in found} == before
    assert len(found) == len(before), "one of each port, not one of each part"
    assert track.state is not None
    pose = dive.poses[number, track.state.t_ns]
    assert t_ns - 40_000_000 < track.state.t_ns <= t_ns
    np.testing.assert_array_equal(track.state.poses, pose)
    track.close()


def test_a_later_part_alone_plays_where_its_bodies_were(run: tuple[Path, Dive]) -> None:
    path, dive = run
    track = Track(part(path, 4))
    assert len(track.runs) == 1, "the reset was in a part before"
    track.seek(0, 1_500_000_000)
    assert track.state is not None
    np.testing.assert_array_equal(track.state.poses, dive.poses[1, track.state.t_ns])
    assert 1_460_000_000 < track.state.t_ns <= 1_500_000_000
    track.close()


def test_it_goes_on_in_a_part_that_comes_while_it_is_played(run: tuple[Path, Dive], tmp_path: Path) -> None:
    path = run[0]
    (tmp_path / "run.mcap").write_bytes(path.read_bytes())
    track = Track(tmp_path / "run.mcap")
    assert not track.is_growing
    (tmp_path / "run.0002.mcap").write_bytes(b"")
    assert track.is_growing, "its head is not written yet"
    assert not track.refresh()
    (tmp_path / "run.0002.mcap").write_bytes(part(path, 2).read_bytes())
    assert track.is_growing
    assert track.refresh()
    assert not track.is_growing
    assert track.runs[0].to_ns > 1_900_000_000
    track.close()
    recorded(tmp_path / "other.mcap", 250, rotation=Rotation(most_s=1.0))
    (tmp_path / "other.0002.mcap").rename(tmp_path / "run.0003.mcap")
    track = Track(tmp_path / "run.mcap")
    assert not track.is_growing, "that one is of another run"
    track.close()


def test_a_part_that_is_missing_is_told(run: tuple[Path, Dive], tmp_path: Path) -> None:
    for file in (run[0], part(run[0], 3)):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(NotPlayable, match=r"its part run\.0002\.mcap is missing"):
        Track(tmp_path / "run.mcap")


def test_of_files_that_are_not_read_none_is_open(run: tuple[Path, Dive]) -> None:
    chunks = PartChunks(run[0])
    for chunk in range(len(chunks.chunks)):
        assert chunks.messages(chunk)
    assert len(chunks._parts) == 5
    assert [part.file._file.closed for part in chunks._parts] == [True, True, True, True, False]
    chunks.close()


def test_a_recording_in_one_file_has_its_channels_as_written(tmp_path: Path) -> None:
    with Dive(tmp_path / "run.mcap", pool()) as dive:
        dive.go(20)
    chunks = PartChunks(tmp_path / "run.mcap")
    assert chunks.channels == chunks._parts[0].file.channels
    chunks.close()
