"""A recording that opens elsewhere: read back with the packages of the schemas, and replayed as if they were not there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from run_rig import recorded_run

from uwserver.recording import writer as foxglove
from uwserver.recording.replay import replay
from uwserver.recording.writer import FoxgloveChannels
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry

SCENARIO = """\
schema = 1
[world]
origin_lat_deg = 60.0
origin_lon_deg = 5.0
[seabed]
kind = "flat"
depth_m = 8
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, 4]
[vehicles.rov.sensors.gps]
kind = "gps"
ideal = true
rate_hz = 5
position_frd_m = [0, 0, -6]
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
rate_hz = 40
range_m = 10
bins = 50
[vehicles.rov.sensors.lasers]
kind = "range_array"
rate_hz = 10
beams = 3
field_of_view_deg = 40
max_range_m = 8
rpy_deg = [0, -90, 0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foxglove")
    (folder / "x.toml").write_text(SCENARIO)
    recorded_run(folder / "x.toml", folder / "with.mcap", 2.0)
    recorded_run(folder / "x.toml", folder / "without.mcap", 0.1, foxglove=False)
    return folder


def messages(file: Path, topic: str) -> list[Any]:
    factory = pytest.importorskip("mcap_protobuf.decoder").DecoderFactory
    with file.open("rb") as stream:
        return [
            m.decoded_message
            for m in make_reader(stream, decoder_factories=[factory()]).iter_decoded_messages(topics=[topic])
        ]


def test_their_packages_read_it(folder: Path) -> None:
    file = folder / "with.mcap"
    tf = messages(file, "/tf")
    assert 58 <= len(tf) <= 64  # 30 a second
    assert {t.child_frame_id for t in tf[-1].transforms} == {"N", "rov", "rov/gps", "rov/sonar", "rov/lasers"}
    with file.open("rb") as stream:
        truth = [json.loads(m.data) for _, _, m in make_reader(stream).iter_messages(topics=["rov/gps"])]
    fixes = messages(file, "/rov/gps")
    assert len(fixes) == len([t for t in truth if t["valid"]]) > 5
    assert fixes[0].latitude == pytest.approx(60.0, abs=1e-3)
    (scene,) = messages(file, "/scene")
    assert {entity.id for entity in scene.entities} == {"seabed", "rov"}
    down = messages(file, "/rov/lasers")[-1].ranges
    assert down[1] == pytest.approx(4.0, abs=0.3)
    assert len(messages(file, "/rov/sonar")) > 30
    assert messages(file, "/log")[-1].name == "shutdown"
    assert len(messages(file, "/rov/pose")) == len(tf)


def test_without_it_none_of_this_is_there(folder: Path) -> None:
    with (folder / "without.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert not [channel.topic for channel in summary.channels.values() if channel.topic.startswith("/")]


def test_a_replay_does_not_see_it(folder: Path) -> None:
    result = replay(folder / "with.mcap")
    assert result.difference is None
    assert result.hashes == 3


def test_a_fault_of_ours_ends_these_channels_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 1.0))
    resolved = load(Scenario(schema=1, title="test", seed=3, vehicles={"rov": vehicle}), adapters={})
    world = build(resolved)
    channels = FoxgloveChannels(world, resolved)

    def broken(*_: object) -> None:
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr(foxglove.SceneChannels, "event", broken)
    event = foxglove.Event("paused", 0, 0, "x")
    assert list(channels.of(event)) == []
    assert list(channels.of(event)) == []
    assert caplog.text.count("the recording itself continues") == 1
