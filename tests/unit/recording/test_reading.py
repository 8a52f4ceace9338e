"""A recording read back: entries and messages in their order, over all parts; what stops, what is damaged, what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from recording_rig import recorded

from uwserver.ports import Command
from uwserver.recording.format import HASHES, Request
from uwserver.recording.reading import NotReplayable, Reading, head_record, parts_of

PUSH = Command("rov/thrusters", ((0.5,) * 8,), "me")


@pytest.fixture
def run(resolved, tmp_path: Path) -> Path:
    return recorded(tmp_path / "run.mcap", resolved, 245, {5: [PUSH]})


def test_entries_come_in_their_order(run: Path):
    with Reading(run) as reading:
        found = list(reading.entries())
        assert (reading.truncated, reading.state, reading.paths) == (False, b"", (run,))
    assert [entry.index for entry in found] == [0, 1, 2]
    assert isinstance(found[0], Request)
    assert found[0].item == PUSH


def test_messages_of_some_topics_or_of_all(run: Path):
    with Reading(run) as reading:
        assert {topic for topic, _ in reading.messages({HASHES: None})} == {HASHES}
    with Reading(run) as reading:
        assert {"rov/imu", "rov/thrusters", HASHES} <= {topic for topic, _ in reading.messages()}


def test_one_without_its_end_is_read_as_far_as_it_goes(run: Path):
    run.write_bytes(run.read_bytes()[:-20])
    with Reading(run) as reading:
        assert len(list(reading.entries())) == 3
        assert reading.truncated


def test_a_damaged_one_is_told_with_its_place(run: Path):
    content = bytearray(run.read_bytes())
    content[len(content) * 3 // 4] ^= 0xFF
    run.write_bytes(content)
    with Reading(run) as reading, pytest.raises(NotReplayable, match="damaged before byte"):
        list(reading.entries())


def test_another_file_is_refused(tmp_path: Path):
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(NotReplayable, match="not an MCAP file"):
        Reading(tmp_path / "a.txt")
    with pytest.raises(OSError, match="No such file"):
        head_record(tmp_path / "b")
    with pytest.raises(OSError, match="No such file"):
        parts_of(tmp_path / "b")
