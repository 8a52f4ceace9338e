"""A later part of a recording says by itself who is there: it can be played, and opened by viewers of others, without the parts before it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from playback_rig import Dive, pool

from uwserver.adapter import installed_adapters
from uwserver.ports import Call
from uwserver.recording.parts import Rotation
from uwserver.recording.player.track import Track
from uwserver.recording.recorder import Recorder
from uwserver.recording.states import ENTITY_LISTS, EntityListRecord
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.simulation.clock import Timing


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Of a run in which time is set once, and somebody comes in the second second, before the part that begins with the third."""
    path = tmp_path_factory.mktemp("parts") / "run.mcap"
    with Dive(path, pool(), rotation=Rotation(most_s=1.0)) as dive:
        dive.go(100)
        dive.call("world/reset")
        dive.go(300)
        dive.call("world/spawn", name="guest", like="rov", p_NB=[3.0, 0.0, 2.0])
        dive.go(340)
    return [path, *(path.with_name(f"run.000{k}.mcap") for k in (2, 3))]


def entity_lists(path: Path) -> list[EntityListRecord]:
    with path.open("rb") as file:
        return [
            msgspec.json.decode(m.data, type=EntityListRecord)
            for _, _, m in make_reader(file).iter_messages(topics=[ENTITY_LISTS])
        ]


def test_a_later_part_tells_all_who_are_there(parts: list[Path]) -> None:
    first = entity_lists(parts[0])[0]
    came = entity_lists(parts[1])[-1]
    (told,) = entity_lists(parts[2])
    assert [body.name for body in told.vehicles] == ["rov", "guest"]
    assert (told.t_ns, told.tick, told.jumps) == (2_000_000_000, 480, 1)
    assert told.revision == came.revision, "by which the states of this part name it"
    assert {port.path for port in told.ports} == {p.path for p in first.ports} | {p.path for p in came.ports}
    assert {s.path for s in told.services} == {s.path for s in first.services} | {s.path for s in came.services}
    assert told.water == first.water, "though it was told long before"
    assert told.water


def test_a_later_part_alone_is_played(parts: list[Path]) -> None:
    track = Track(parts[2])
    track.seek(0, 2_500_000_000)
    assert track.state is not None
    assert [body.name for body in track.state.entities.vehicles] == ["rov", "guest"]
    assert track.newest("guest/imu", track.scenes[0].ports) is not None
    assert track.messages.damaged == 0
    track.close()


def test_a_later_part_alone_opens_in_foxglove(parts: list[Path]) -> None:
    from mcap_protobuf.decoder import DecoderFactory

    with parts[2].open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(c.topic, m.log_time, d) for _, c, m, d in reader.iter_decoded_messages(topics=["/scene", "/tf"])]
    scenes = [(t_ns, scene) for topic, t_ns, scene in found if topic == "/scene"]
    assert scenes[0][0] == 2_000_000_000
    assert {entity.id for entity in scenes[0][1].entities} >= {"rov", "guest"}
    assert any(topic == "/tf" for topic, _, _ in found)


SENSORS = """
schema = 1
seed = 2
[world]
origin_lat_deg = 54.0
origin_lon_deg = 10.0
[seabed]
kind = "flat"
depth_m = 6
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 0.05]
[vehicles.rov.sensors.gps]
kind = "gps"
profile = "m8_gps"
rate_hz = 10
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
profile = "ping360"
rate_hz = 20
[vehicles.rov.sensors.altimeter]
kind = "altimeter"
profile = "ping1d"
rate_hz = 10
[vehicles.rov.sensors.training]
kind = "training"
rate_hz = 20
collision_points = 0
[vehicles.rov.sensors.training.tasks.away]
kind = "reach"
position_ned_m = [1.4, 0.0, 2.0]
size_m = [2.0, 20.0, 20.0]
"""


def test_samples_that_are_encoded_in_one_go_are_those_that_are_encoded_one_by_one(tmp_path: Path) -> None:
    (tmp_path / "dive.toml").write_text(SENSORS)
    resolved = load(str(tmp_path / "dive.toml"), adapters=installed_adapters())
    world = build(resolved)
    world.subscribe(None)
    one, other = (Recorder(tmp_path / f"{name}.mcap", world, resolved) for name in ("one", "other"))
    rows = 0
    with one.stepped(Timing("freerun")), other.stepped(Timing("freerun")):
        for tick in range(500):
            if tick == 240:  # whose ports get their channels later
                where = {"p_NB": [4.0, 0.0, 2.0], "q_NB": [1.0, 0.0, 0.0, 0.0]}
                world.submit(Call("world/spawn", {"name": "second", "like": "rov", **where}, "me"))
            output = world.advance()
            batch = output.batch
            for recorder in (one, other):
                recorder.ticked(world)
            if batch is not None and not output.made:
                rows += len(batch)
                one.put_batch(batch)
                other.put_samples(list(batch))
            else:
                for recorder in (one, other):
                    recorder.put_samples(output.samples)
            for recorder in (one, other):
                recorder.drain()
    found = [contents(tmp_path / f"{name}.mcap") for name in ("one", "other")]
    assert found[0] == found[1]
    topics = {message[0] for message in found[0]}
    assert {"rov/imu", "rov/training", "rov/sonar", "/rov/sonar", "rov/gps", "second/imu"} <= topics
    assert rows > 500


def contents(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """All messages in the order in which they were written."""
    with path.open("rb") as file:
        return [
            (channel.topic, m.sequence, m.log_time, m.publish_time, m.data)
            for _, channel, m in make_reader(file).iter_messages(log_time_order=False)
        ]
