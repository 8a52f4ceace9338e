"""What `uwserver record` wrote, played: ports, samples and times as they were served, vehicles where the ports say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from served_rig import LATER, PAUSE_NS, POSE, TOLD, dive, served

from uwserver.recording.player_file import NotPlayable
from uwserver.recording.player_served import import_served, is_served
from uwserver.recording.player_track import Track


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
    with pytest.raises(NotPlayable, match=r"a\.mcap: not one sample is in it"):
        import_served(served(tmp_path / "a.mcap", []), tmp_path / "x.mcap")
    with pytest.raises(NotPlayable, match=r"b\.mcap: the head of the recording is damaged"):
        import_served(served(tmp_path / "b.mcap", dive(), {"describe": "[]"}), tmp_path / "y.mcap")
    (tmp_path / "c.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert not is_served(tmp_path / "c.mcap")
    with pytest.raises(NotPlayable):
        import_served(tmp_path / "c.mcap", tmp_path / "z.mcap")
