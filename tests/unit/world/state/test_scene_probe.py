"""Where all bodies are, and what their actuators achieve, as those see it who watch."""

from __future__ import annotations

import numpy as np
import pytest

import uwserver
from uwserver.physics.dynamics.params import ForceTable, Lag, ThrusterParams
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.world.state import snapshot
from uwserver.world.state.scene_probe import SceneProbe, full_thrust
from uwserver.world.world import World


@pytest.fixture
def world() -> World:
    begun = ScenarioBuilder("watched")
    begun.vehicle("rov", "bluerov2_heavy", position_ned_m=(1.0, 2.0, 3.0))
    begun.vehicle("auv", "remus100", position_ned_m=(9.0, 8.0, 7.0))
    return uwserver.load(begun.build()).core


def test_poses_are_those_of_the_bodies(world: World) -> None:
    scene_probe = SceneProbe(world)
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(60)
    state = scene_probe.state()
    assert state.t_ns == world.t_ns > 0
    assert [body.name for body in state.entities.vehicles] == ["rov", "auv"]
    for pose, name in zip(state.poses, ("rov", "auv"), strict=True):
        vehicle = world.vehicles[name]
        assert (*pose[:3], *pose[3:]) == (*vehicle.p_NB, *vehicle.q_NB)
    before = state.poses.copy()
    world.step(60)
    assert (state.poses == before).all(), "a state that was taken does not change any more"


def test_what_thrusters_achieve_follows_their_lag(world: World) -> None:
    scene_probe = SceneProbe(world)
    assert not scene_probe.state().achieved.any()
    world.command("rov/thrusters", u=[1.0, -1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    world.step(1)
    begun = scene_probe.state().achieved.tolist()
    world.step(239)
    full = scene_probe.state().achieved.tolist()
    assert full[:2] == [127, -127]
    assert abs(begun[0]) < 127
    assert 0 < full[2] < 127
    assert not any(full[3:8])


def test_what_fins_and_shafts_achieve_is_their_place_between_the_limits(world: World) -> None:
    names = [servo.name for servo in world.hydro.params[1].appendages.servos]
    paths = [path for path, port in world.ports.items() if path.startswith("auv/") and port.direction == "actuator"]
    scene_probe = SceneProbe(world)
    for ticks in (1, 120):  # before the watchdogs
        for path in paths:
            field = world.ports[path].fields[0]
            if field.maximum is not None:
                most = [field.maximum] * field.shape[0] if field.shape else field.maximum
                world.command(path, **{field.name: most})
        world.step(ticks)
        achieved = scene_probe.state().achieved[8:].tolist()
        assert len(achieved) == len(names)
        if ticks == 1:
            assert max(achieved) < 127, "they take their time"
    rows = world.hydro.servos[int(world.hydro.bodies["servo_first"][1]) :]
    whole = 127.0 * (2.0 * (rows["value"] - rows["low"]) / (rows["high"] - rows["low"]) - 1.0)
    assert achieved == np.rint(whole).tolist()
    assert max(achieved) > 30


def test_the_revision_rises_when_somebody_comes_or_goes(world: World) -> None:
    scene_probe = SceneProbe(world)
    first = scene_probe.state().entities
    world.step(3)
    assert scene_probe.state().entities is first
    world.call("world/spawn", name="second", like="rov", p_NB=[5.0, 5.0, 5.0])
    spawned = scene_probe.state()
    assert spawned.entities.revision == first.revision + 1
    assert [(body.name, body.like) for body in spawned.entities.vehicles] == [
        ("rov", "rov"),
        ("auv", "auv"),
        ("second", "rov"),
    ]
    assert (spawned.poses[2, :3] == 5.0).all()
    world.call("world/remove", name="rov")
    gone = scene_probe.state()
    assert [body.name for body in gone.entities.vehicles] == ["auv", "second"]
    assert gone.entities.revision == first.revision + 2
    assert len(gone.achieved) == len(spawned.achieved) - 8
    world.call("world/reset")
    assert scene_probe.state().entities.revision == first.revision + 3


def test_free_objects_stand_behind_the_vehicles() -> None:
    world = uwserver.load("push_the_crate").core
    state = SceneProbe(world).state()
    assert state.entities.objects
    assert len(state.poses) == len(state.entities.vehicles) + len(state.entities.objects)
    crate = world.members[state.entities.objects[0].name].vehicle
    assert tuple(state.poses[len(state.entities.vehicles)]) == (*crate.p_NB, *crate.q_NB)


def test_a_vehicle_whose_file_calls_it_object_is_a_vehicle(world: World) -> None:
    object.__setattr__(world.vehicles["rov"], "model", "object")
    entities = SceneProbe(world).state().entities
    assert [body.name for body in entities.vehicles] == ["rov", "auv"]
    assert entities.objects == ()


def test_looking_changes_nothing(world: World) -> None:
    scene_probe = SceneProbe(world)
    before = world.hydro.save()
    scene_probe.state()
    assert world.hydro.save() == before


def test_full_thrust_lies_between_the_curves_of_the_supply() -> None:
    table = ForceTable((12.0, 16.0), (((-1.0, -30.0), (1.0, 40.0)), ((-1.0, -50.0), (1.0, 60.0))))
    thruster = ThrusterParams("t", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), table, 14.0, Lag(), installed=0.5)
    assert full_thrust(thruster) == pytest.approx((25.0, 20.0))
    assert np.all(np.isfinite(full_thrust(thruster)))


def test_another_current_is_another_revision(world: World) -> None:
    scene_probe = SceneProbe(world)
    first = scene_probe.state().entities
    assert scene_probe.state().entities is first
    before = snapshot.take(world)
    world.set_current((0.5, 0.0, 0.0))
    second = scene_probe.state()
    assert (second.current, second.entities.revision) == ((0.5, 0.0, 0.0), first.revision + 1)
    assert scene_probe.state().entities is second.entities
    snapshot.restore(world, before)
    assert scene_probe.state().entities.revision == first.revision + 2
