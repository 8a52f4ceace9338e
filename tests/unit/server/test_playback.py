"""A recording behind the context of an adapter: the same description as live, and refusals that say why."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playback_rig import pool, recorded

from uwserver.ports import Progress, Refused, Reply, SceneState
from uwserver.recording.player.track import Track
from uwserver.recording.player.world import Range
from uwserver.scenario.build.world import build
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.context import Context
from uwserver.server.playback import Playback
from uwserver.server.status import Monitor
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.testing.mock_time import MockTime
from uwserver.world.state.scene_probe import SceneProbe
from uwserver.world.world import World


class Played:
    """A hub over a recording, turned by hand."""

    def __init__(self, path: Path) -> None:
        self.calls: list[Any] = []
        self.track = Track(path)
        time, bus, mailbox = MockTime(), Bus(self.calls.append), Mailbox()
        self.monitor = Monitor(lambda: self.hub, time.now_ns)
        playback = Playback(self.track, Timing("freerun"), Range())
        resolved = self.track.head.resolved
        tell = (self.calls.append, self.monitor.status)
        self.player, self.hub = playback.start("sea", resolved, (time, bus, mailbox), tell)
        self.context = Context(self.hub, "tcp", True)

    def turn(self) -> None:
        self.player._turn()
        while self.calls:
            self.calls.pop(0)()
        self.hub.bus.drain()


@pytest.fixture
def played(tmp_path: Path) -> Iterator[Played]:
    recorded(tmp_path / "x.mcap", ticks=60)
    found = Played(tmp_path / "x.mcap")
    yield found
    found.track.close()


@pytest.fixture(scope="module")
def world() -> World:
    return build(pool())


def test_it_is_described_as_the_world_was(played: Played, world: World) -> None:
    told = played.context.describe()
    there = {port["path"]: port for port in told["ports"]}  # type: ignore[union-attr,index,call-overload]
    assert list(there) == list(world.ports)
    assert played.context.ports == dict(world.ports)
    services = played.context.services
    assert world.services.items() <= services.items()
    assert {"playback/seek", "world/pause", "world/status"} <= services.keys()
    assert told["world"]["vehicles"] == ["rov"]  # type: ignore[index,call-overload]
    assert played.context.world.vehicles[0].model == world.members["rov"].vehicle.model
    assert played.context.world.epoch_utc == world.epoch_utc


def test_what_changes_something_is_denied_and_the_sender_told(played: Played) -> None:
    context = played.context
    with pytest.raises(Refused, match=r'playback: .*"rov/thrusters"') as refused:
        context.command("rov/thrusters", {"u": [0.0] * 8}, "me", None)
    assert refused.value.fault.code == "denied"
    answers: list[Reply | Progress] = []
    for service, args in (
        ("world/reset", {}), ("world/snapshot", {"name": "a"}), ("rov/thrusters/get", {}), ("world/save", {"name": "a"}),
        ("world/profile", {}), ("recording/start", {}), ("recording/stop", {}), ("rov/thrusters/deactivate", {}),
    ):  # fmt: skip
        with pytest.raises(Refused) as refused:
            context.call(service, args, "me", answers.append)
        assert refused.value.fault.code == "denied", service
    with pytest.raises(Refused) as refused:
        context.command("rov/thrusters", {"u": [9.0]}, "me", None)
    assert refused.value.fault.code == "bad_shape", "a wrong command is wrong in a recording, too"
    assert answers == []


def test_time_is_steered_by_its_services(played: Played) -> None:
    answers: list[Reply | Progress] = []
    played.context.call("world/pause", {}, "me", answers.append)
    played.turn()
    played.context.call("playback/seek", {"t_s": 0.1}, "me", answers.append)
    played.turn()
    played.context.call("world/step", {"n": 2}, "me", answers.append)
    for _ in range(5):
        played.turn()
    assert [answer.fault for answer in answers if isinstance(answer, Reply)] == [None] * 3
    status = played.monitor.status()
    assert status["paused"] is True
    assert status["playback"]["t_s"] == pytest.approx(26 / 240)  # type: ignore[index,call-overload]
    assert played.context.world.mode == "freerun"


def test_the_scene_is_that_of_the_world(played: Played, world: World) -> None:
    states: list[SceneState] = []
    for _ in range(20):
        played.turn()
    played.context.request_scene_state(states.append)
    played.turn()
    shown = played.context.scene(states[0].entities)
    live = Scenery(pool(), world).scene(SceneProbe(world).state().entities)
    assert shown.water == live.water
    assert [(body.name, body.shapes, body.actuators, body.sensors) for body in shown.vehicles] == [
        (body.name, body.shapes, body.actuators, body.sensors) for body in live.vehicles]  # fmt: skip
    assert states[0].poses.shape == (1, 7)
    assert len(states[0].achieved) == 8
