"""What things looked like is in a recording, so that who plays it needs no file; bounded, and checked when it is read."""

from __future__ import annotations

import base64
import json
import logging
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard

from uwserver.recording import format as format_module
from uwserver.recording.format import MODEL_FILES, head_of, metadata, pack_model_files, unpack_model_files
from uwserver.recording.player.track import Track
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.scenery import Scenery
from uwserver.simulation.clock import Timing

SCENARIO = """
schema = 1
adapters = {}
[structures.post]
kind = "box"
size_m = [1, 1, 4]
position_ned_m = [5, 0, 8]
looks = "a.glb"
[objects.crate]
kind = "box"
size_m = [1, 1, 1]
mass_kg = 100
position_ned_m = [9, 0, 5]
looks = "b.glb"
[vehicles.rov]
model = "bluerov2"
override.looks = "a.glb"
"""


def glb(name: str) -> bytes:
    text = json.dumps({"asset": {"version": "2.0", "generator": name}}).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


@pytest.fixture
def dressed(tmp_path: Path) -> Resolved:
    for name in "ab":
        (tmp_path / f"{name}.glb").write_bytes(glb(name))
    (tmp_path / "s.toml").write_text(SCENARIO)
    return load(tmp_path / "s.toml", adapters={})


def test_who_plays_a_recording_sees_the_looks_without_the_files(dressed: Resolved, tmp_path: Path) -> None:
    world = build(dressed)
    recorder = Recorder(tmp_path / "x.mcap", world, dressed)
    with recorder.stepped(Timing("freerun")):
        for _ in range(30):
            output = world.advance()
            recorder.ticked(world)
            recorder.put_samples(output.samples)
            recorder.drain()
    for name in "ab":
        (tmp_path / f"{name}.glb").unlink()
    track = Track(tmp_path / "x.mcap")
    track.close()
    played = track.head.resolved
    scenery = Scenery(played, build(played))
    scene = scenery.scene(track.scenes[0].entities)
    assert sorted(scenery.model_files.values()) == [glb("a"), glb("b")]
    (post,), (rov,), (crate,) = scene.structures, scene.vehicles, scene.objects
    assert post.looks is not None
    assert rov.looks is not None
    assert crate.looks is not None
    assert post.looks.sha256 == rov.looks.sha256 != crate.looks.sha256


def test_a_scenario_without_looks_has_a_head_without_them(dressed: Resolved) -> None:
    bare = replace(
        dressed,
        looks={},
        vehicles={name: replace(each, looks=b"") for name, each in dressed.vehicles.items()},
        objects={name: replace(each, looks=b"") for name, each in dressed.objects.items()},
    )
    record = metadata(bare, 1, Timing())
    assert MODEL_FILES not in record
    assert head_of(record).resolved.looks == {}


def test_all_together_are_bounded_and_the_largest_is_left_out(
    dressed: Resolved, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    large = glb("b" * 400)
    crate = replace(dressed.objects["crate"], looks=large)
    monkeypatch.setattr(format_module, "MOST_MODEL_BYTES", len(glb("a")) + len(large) - 1)
    with caplog.at_level(logging.WARNING):
        kept = unpack_model_files(pack_model_files(replace(dressed, objects={"crate": crate})))
    assert kept == {"vehicles/rov": glb("a"), "static/post": glb("a")}
    assert "the looks of objects/crate are left out" in caplog.text


def packed(content: Any) -> dict[str, str]:
    return {MODEL_FILES: base64.b64encode(zstandard.compress(msgspec.msgpack.encode(content))).decode()}


def test_what_is_no_looks_is_left_out() -> None:
    told = {
        "files": {"x": b"no glb", "y": glb("y")},
        "owners": {"vehicles/a": "x", "vehicles/b": "y", "vehicles/c": "z"},
    }
    assert unpack_model_files(packed(told)) == {"vehicles/b": glb("y")}


@pytest.mark.parametrize(
    "record",
    [
        {MODEL_FILES: "~~~~"},
        {MODEL_FILES: "abcde"},
        {MODEL_FILES: "YWJj"},
        packed([1]),
        packed({"files": {"x": b"\0" * (65 << 20)}, "owners": {}}),
    ],
)
def test_a_record_that_is_none_is_told(record: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="looks"):
        unpack_model_files(record)


def test_large_looks_cost_little_to_pack_and_to_read(monkeypatch: pytest.MonkeyPatch, dressed: Resolved) -> None:
    """As text that the interpreter itself need not make: some copies of them, not fifty times their size."""
    monkeypatch.setattr(format_module, "check_glb", lambda data: None)
    large = np.random.default_rng(1).bytes(2 << 20)
    tracemalloc.start()
    try:
        record = pack_model_files(replace(dressed, looks={"post": large}, vehicles={}, objects={}))
        assert unpack_model_files(record) == {"static/post": large}
        assert tracemalloc.get_traced_memory()[1] < 10 * len(large)
    finally:
        tracemalloc.stop()
