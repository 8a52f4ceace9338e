"""What `uwserver record` wrote, played: ports, samples and times as they were served, vehicles where the ports say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from served_rig import LATER, PAUSE_NS, POSE, TOLD, dive, served

from uwserver.ports import Buffer, Field, Port, Sample
from uwserver.recording.format import EVENTS, METADATA
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.served import import_served, is_served
from uwserver.recording.player.track import Track


def test_samples_ports_services_and_times_are_those_that_were_served(tmp_path: Path) -> None:
    path = served(tmp_path / "a.mcap", dive())
    assert is_served(path)
    remarks = import_served(path, tmp_path / "b.mcap")
    assert remarks[0].startswith(
        "`uwserver record` took it from the server at 127.0.0.1:7600: its scenario is not in it"
    )
    track = Track(tmp_path / "b.mcap")
    try:
        scene = track.scenes[0]
        assert scene.ports[POSE.path] == POSE
        assert scene.ports[TOLD.path] == TOLD
        assert [(f.name, f.unit, f.shape, f.type) for f in scene.ports[LATER.path].fields] == [
            ("angle", "rad", (2,), "float")
        ]
        assert [argument.name for argument in scene.services["rov/grip"].arguments] == ["on"]
        assert len(track.runs) == 1
        samples, events = [], []
        while track.head_item is not None:
            item = track.pop()
            if item.type == "sample":
                samples.append(track.messages.sample(item.message, scene.ports))
            elif item.type == "event":
                events.append(track.messages.event(item.message))
        assert samples == dive()
        assert [event.text for event in events if event is not None] == ["a leak"]
    finally:
        track.close()


def test_the_vehicle_stands_where_its_port_says(tmp_path: Path) -> None:
    import_served(served(tmp_path / "a.mcap", dive()), tmp_path / "b.mcap")
    track = Track(tmp_path / "b.mcap")
    try:
        assert [body.name for body in track.scenes[0].bodies] == ["rov"]
        assert track.head.resolved.scenario.world.rate_hz == 50.0
        track.seek(0, 10 * PAUSE_NS + PAUSE_NS // 2)
        assert track.state is not None
        np.testing.assert_allclose(track.state.poses[0, :3], [10.4, 0.0, 2.0], atol=0.3)
    finally:
        track.close()


def test_what_cannot_be_played_is_told(tmp_path: Path) -> None:
    with pytest.raises(NotPlayable, match=r"a\.mcap: the file contains no sample"):
        import_served(served(tmp_path / "a.mcap", []), tmp_path / "x.mcap")
    with pytest.raises(NotPlayable, match=r"b\.mcap: the head of the recording is damaged"):
        import_served(served(tmp_path / "b.mcap", dive(), {"describe": "[]"}), tmp_path / "y.mcap")
    (tmp_path / "c.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert not is_served(tmp_path / "c.mcap")
    with pytest.raises(NotPlayable):
        import_served(tmp_path / "c.mcap", tmp_path / "z.mcap")


GOOD: dict[str, Any] = {
    "seq": 0, "t_ns": PAUSE_NS, "t_sent_ns": PAUSE_NS, "valid": True, "value": {"p_NB": [1.0, 0.0, 2.0], "q_NB": [1.0, 0.0, 0.0, 0.0]},
}  # fmt: skip


def told(path: Path, messages: list[tuple[str, Any]], **world: Any) -> Path:
    """A file of these messages, and with another world in its head."""
    with served(path, []).open("rb") as file:
        (head,) = [record.metadata for record in make_reader(file).iter_metadata() if record.name == METADATA]
    describe = msgspec.json.decode(head["describe"])
    describe["world"] |= world
    head["describe"] = msgspec.json.encode(describe).decode()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata(METADATA, head)
        schema = writer.register_schema("s", "jsonschema", b'{"type": "object"}')
        channels = {topic: writer.register_channel(topic, "json", schema) for topic, _ in messages}
        for topic, message in messages:
            writer.add_message(channels[topic], PAUSE_NS, msgspec.json.encode(message), PAUSE_NS)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (POSE.path, {"a": 1}),
        (POSE.path, [1, 2]),
        (POSE.path, GOOD | {"value": [1]}),
        (POSE.path, GOOD | {"value": None}),
        (POSE.path, GOOD | {"value": {"p_NB": "x", "q_NB": [1.0, 0.0, 0.0, 0.0]}}),
        (POSE.path, GOOD | {"value": {"p_NB": [1.0], "q_NB": [1.0, 0.0, 0.0, 0.0]}}),
        (POSE.path, GOOD | {"seq": "x"}),
        (POSE.path, GOOD | {"t_ns": "x"}),
        (POSE.path, GOOD | {"t_ns": 1e300}),
        (POSE.path, GOOD | {"t_ns": -5, "t_sent_ns": -(2**62)}),
        (POSE.path, GOOD | {"t_ns": 2**63}),
        (POSE.path, GOOD | {"valid": "x"}),
        (EVENTS, {"event": "x"}),
        (EVENTS, {"event": "fault", "tick": 1, "t_ns": -1, "text": ""}),
    ],
)
def test_a_message_that_is_none_is_left_out_and_told(tmp_path: Path, topic: str, message: Any) -> None:
    path = told(tmp_path / "a.mcap", [(POSE.path, GOOD), (topic, message)])
    remarks = import_served(path, tmp_path / "b.mcap")
    assert "1 messages are left out" in remarks[1]
    track = Track(tmp_path / "b.mcap")
    try:
        items = []
        while track.head_item is not None:
            items.append(track.pop())
        samples = [
            track.messages.sample(item.message, track.scenes[0].ports) for item in items if item.type == "sample"
        ]
        assert [sample and sample.value for sample in samples] == [((1.0, 0.0, 2.0), (1.0, 0.0, 0.0, 0.0))]
        assert not [item for item in items if item.type == "event"]
    finally:
        track.close()


@pytest.mark.parametrize("world", [{"rate_hz": 0.0}, {"rate_hz": 1e300}, {"epoch_utc": "x"}])
def test_a_head_that_no_server_tells_is_refused_and_nothing_is_left(tmp_path: Path, world: dict[str, Any]) -> None:
    path = told(tmp_path / "a.mcap", [(POSE.path, GOOD)], **world)
    with pytest.raises(NotPlayable, match=r"a\.mcap: it cannot be read as a file of `uwserver record`"):
        import_served(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_a_picture_comes_through(tmp_path: Path) -> None:
    picture = Buffer.of(np.arange(12, dtype=np.uint8).reshape(2, 2, 3))
    camera = Port("rov/camera", "sensor", "camera", (Field("image", "1", "what", type="buffer"),), "Sees.", 10.0)
    ports = msgspec.json.encode({"world": {"rate_hz": 50.0}, "ports": [camera], "services": []}).decode()
    path = served(
        tmp_path / "a.mcap", [], {"describe": ports}, (camera, Sample(camera.path, 0, 5, 5, True, (picture,)))
    )
    import_served(path, tmp_path / "b.mcap")
    track = Track(tmp_path / "b.mcap")
    try:
        found = []
        while track.head_item is not None:
            item = track.pop()
            if item.type == "sample":
                found.append(track.messages.sample(item.message, track.scenes[0].ports))
        assert [sample and sample.value for sample in found] == [(picture,)]
    finally:
        track.close()
