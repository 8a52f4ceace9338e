"""The channels of a recording from which a run is shown again: who is there, and where. Also of uwserver.recording.recorder."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from uwserver.ports import Call, EntityList, Present, SceneState
from uwserver.recording.recorder import Recorder
from uwserver.recording.states import (
    ENTITY_LISTS,
    JUMPS,
    STATES,
    EntityListRecord,
    Presence,
    Seen,
    read_state,
    state_message,
    time_of_state,
)
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.world.state.scene_probe import SceneProbe

ENTITIES = EntityList(3, (Present("rov", "rov"),), (Present("crate", "crate"),))
STATE = SceneState(ENTITIES, 5, np.arange(14.0).reshape(2, 7) + 0.1, np.array([-127, 0, 9], np.int8), (0.1, 0.2, 0.3))


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 1.0))
    return load(Scenario(schema=1, title="test", seed=3, vehicles={"rov": vehicle}), adapters={})


def test_a_state_comes_back_bit_for_bit() -> None:
    seen = read_state(state_message(Seen(2, STATE)), {3: ENTITIES})
    state = seen.state
    assert seen.jumps == 2
    assert time_of_state(state_message(Seen(2, STATE))) == (2, 5)
    assert (state.entities, state.t_ns, state.current) == (ENTITIES, 5, (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(state.poses, STATE.poses)
    np.testing.assert_array_equal(state.achieved, STATE.achieved)


@pytest.mark.parametrize("length", [0, 5, 40, 41, 60])
def test_a_state_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match="a state of"):
        read_state(state_message(Seen(0, STATE))[:length], {3: ENTITIES})


def test_a_state_of_an_unknown_cast_is_refused() -> None:
    with pytest.raises(ValueError, match="refers to the list of bodies 3"):
        read_state(state_message(Seen(0, STATE)), {2: ENTITIES})


def test_a_second_record_tells_the_difference_alone(resolved: Resolved) -> None:
    world = build(resolved)
    presence = Presence(ENTITIES, 0, 1, 2, world.ports, world.services, {"rov": "x", "crate": "object"})
    first = presence.since(None)
    assert [port.path for port in first.ports] == list(world.ports)
    gone = next(iter(world.ports))
    left = {path: port for path, port in world.ports.items() if path != gone}
    second = msgspec.structs.replace(presence, ports=left).since(presence)
    assert (second.ports, second.ports_gone, second.services) == ((), (gone,), ())
    assert msgspec.json.decode(msgspec.json.encode(first), type=EntityListRecord) == first
    assert first.entities == ENTITIES


def test_a_run_tells_where_its_bodies_are_thirty_times_a_second_and_after_a_jump(
    resolved: Resolved, tmp_path: Path
) -> None:
    world = build(resolved)
    bus = Bus(lambda function: None)
    simulation = Simulation(world, Timing("freerun"), SystemTime(), bus, Mailbox())
    recorder = Recorder(tmp_path / "run.mcap", world, resolved)
    truth = {}
    with recorder.running(simulation, bus):
        for _ in range(round(world.rate_hz)):
            world.advance()
            truth[world.t_ns] = SceneProbe(world).state().poses
            recorder.ticked(world)
        recorder.requested(Call("world/reset", {}, "tester"), world.tick, 1)
        world.call("world/reset")
        for event in world.flush().events:
            recorder.put_event(event)
        world.advance()
        again = SceneProbe(world).state().poses
        recorder.ticked(world)
    with (tmp_path / "run.mcap").open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=[STATES, ENTITY_LISTS, JUMPS], log_time_order=False))
    entity_lists = [
        msgspec.json.decode(m.data, type=EntityListRecord) for _, channel, m in found if channel.topic == ENTITY_LISTS
    ]
    assert len(entity_lists) == 1
    assert [port.path for port in entity_lists[0].ports] == list(world.ports)
    assert [record.service for record in entity_lists[0].services] == list(world.services.values())
    assert entity_lists[0].water
    states = [
        read_state(m.data, {entity_lists[0].revision: entity_lists[0].entities})
        for _, c, m in found
        if c.topic == STATES
    ]
    assert [m.log_time for _, c, m in found if c.topic == JUMPS] == [0]
    assert [seen.jumps for seen in states][-2:] == [0, 1]
    assert 27 <= len(states) - 1 <= 32
    np.testing.assert_array_equal(states[-1].state.poses, again)
    for state in (seen.state for seen in states[:-1]):
        np.testing.assert_array_equal(state.poses, truth[state.t_ns])
