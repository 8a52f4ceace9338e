"""What a replay writes: as a recorder would have, at once and without loss."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from uwserver.ports import Call, Command
from uwserver.recording.format import EVENTS, HASHES, REQUESTS, Request
from uwserver.recording.transcript import Transcript, new_file
from uwserver.scenario.build.world import build


def test_samples_requests_hashes_and_events_are_written(resolved):
    world, file = build(resolved, 1), io.BytesIO()
    transcript = Transcript(file, world, resolved, {"mode": "freerun"}, {"replay_of": "x.mcap"})
    call = Call(
        "world/set_fault", {"name": "f", "kind": "thruster_dead", "target": "rov/thrusters", "parameters": {}}, "me"
    )
    push = Command("rov/thrusters", ((0.5,) * 8,), "me")
    count = 0
    for tick in range(241):
        if tick == 3:
            transcript.requested([Request.of(item, 9, 9, 9) for item in (call, push)])
            world.submit(call)
            world.submit(push)
        output = world.advance()
        count += len(output.samples)
        transcript.ticked(output)
    transcript.finish()
    found: dict[str, list] = {}
    reader = make_reader(io.BytesIO(file.getvalue()), validate_crcs=True)
    for _, channel, message in reader.iter_messages(log_time_order=False):
        found.setdefault(channel.topic, []).append(json.loads(message.data))
    assert [(r["index"], r["batch"], r["tick"]) for r in found[REQUESTS]] == [(0, 0, 3), (1, 0, 3)]
    assert [(h["index"], h["tick"]) for h in found[HASHES]] == [(2, 240), (3, 241)]
    assert [e["event"] for e in found[EVENTS]] == ["fault"]
    assert sum(len(found[path]) for path in world.sensors if path in found) == count > 100
    (record,) = [m.metadata for m in reader.iter_metadata()]
    assert record["replay_of"] == "x.mcap"


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path):
    (tmp_path / "a").write_text("dive")
    with pytest.raises(FileExistsError, match="give --record another name"):
        new_file(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "dive"
    with pytest.raises(OSError, match="a place that can be written"):
        new_file(tmp_path / "no" / "a")
