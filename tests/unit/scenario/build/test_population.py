"""Bodies that come and go in a run: what they bring, what they leave, and that reset and restore know about them."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.ports import Call, Command, Refused, Reply
from uwserver.ports.checks import checked_command
from uwserver.scenario.build import population
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.solids.tables import BoxObject, FlatSeabed
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors.truth import Truth
from uwserver.world import World
from uwserver.world.state import snapshot


def world_of(**tables: object) -> World:
    """A heavy vehicle on a flat seabed at 10 m, a crate, and a second vehicle that is not there yet."""
    scenario = Scenario(
        schema=1,
        seed=3,
        seabed=FlatSeabed(depth_m=10.0, friction=0.6),
        vehicles={
            "rov": VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 9.5), truth=Truth()),
            "spare": VehicleEntry(model="bluerov2", present=False),
        },
        objects={
            "crate": BoxObject(
                size_m=(0.4, 0.4, 0.4), density_kgpm3=1300.0, position_ned_m=(1.5, 0.0, 9.7), truth=Truth()
            )
        },
        server=Server(metrics=False),
    )
    return build(load(scenario, adapters={}))


def state_of(world: World, name: str) -> np.ndarray:
    return world.hydro.state[world.vehicles[name].row].copy()


def test_bodies_know_the_level_bottom_also_those_that_come_later() -> None:
    world = world_of()
    assert world.hydro.bodies["floor"].tolist() == [10.0] * len(world.hydro.bodies)
    assert world.hydro.floor == 10.0


def test_a_spawned_vehicle_is_like_one_that_was_there() -> None:
    world = world_of()
    assert set(world.vehicles) == {"rov", "crate"}
    world.step(5)
    world.call("world/spawn", name="second", like="spare", p_NB=[5.0, 0.0, 4.0])
    assert {"second/thrusters", "second/imu"} <= set(world.ports)
    assert "second/imu/set" in world.services
    world.command("second/thrusters", u=[0.5] * 6)
    samples = world.step(240)
    assert {sample.port.split("/")[0] for sample in samples} >= {"rov", "crate", "second"}
    assert np.linalg.norm(state_of(world, "second")[:3] - [5.0, 0.0, 4.0]) > 0.05
    assert world.read("second/imu") is not None


def test_the_others_do_not_notice() -> None:
    """Not by a bit, though rows and shapes were added and taken out in between."""
    alone, company = world_of(), world_of()
    for k in range(300):
        if k == 10:
            company.call("world/spawn", name="a", like="spare", p_NB=[5.0, 0.0, 4.0])
        if k == 20:
            company.call("world/spawn", name="b", like="rov", p_NB=[-5.0, 0.0, 4.0])
        if k == 60:
            company.call("world/remove", name="a")
        alone.step()
        company.step()
        for name in ("rov", "crate"):
            np.testing.assert_array_equal(state_of(company, name), state_of(alone, name))


def test_what_is_removed_is_gone() -> None:
    world = world_of()
    world.call("world/set_fault", name="weak", kind="thruster_weak", target="rov/thrusters", parameters={"factor": 0.5})
    world.step(5)
    world.call("world/remove", name="rov")
    assert "rov" not in world.vehicles
    assert not any(path.startswith("rov/") for path in (*world.ports, *world.services))
    assert world.call("world/faults") == []
    assert {sample.port.split("/")[0] for sample in world.step(240)} == {"crate"}
    with pytest.raises(Refused, match="no port"):
        world.command("rov/thrusters", u=[0.0] * 8)


def test_reset_brings_back_who_was_there_and_nobody_else() -> None:
    world = world_of()
    hash_of = lambda: world.call("world/state_hash")["hash"]  # type: ignore[index,call-overload]  # noqa: E731
    first = hash_of()
    world.step(200)
    later = hash_of()
    world.call("world/reset")
    world.call("world/spawn", name="second", like="spare", p_NB=[5.0, 0.0, 4.0])
    world.call("world/remove", name="rov")
    world.step(50)
    world.call("world/reset")
    assert set(world.vehicles) == {"rov", "crate"}
    assert hash_of() == first
    world.step(200)
    assert hash_of() == later


@pytest.mark.parametrize("seed", range(4))
def test_a_restored_world_goes_on_as_if_nothing_had_been(seed: int) -> None:
    """At random ticks, at rest, in contact, with bodies coming and going: the same samples and the same hash."""
    rng = np.random.default_rng(seed)
    world = world_of()
    world.step(int(rng.integers(0, 400)))
    world.command("rov/thrusters", u=rng.uniform(-1.0, 1.0, 8).tolist())
    world.call("world/spawn", name="second", like="crate", p_NB=[0.0, 3.0, 9.0])
    world.step(int(rng.integers(0, 200)))
    world.call("world/snapshot", name="here")
    runs = []
    for _ in range(3):
        samples = world.step(150)
        runs.append((samples, world.call("world/state_hash")))
        world.call("world/remove", name=("rov", "second", "crate")[len(runs) % 3])
        world.step(7)
        world.call("world/restore", name="here")
    assert runs[0] == runs[1] == runs[2]
    assert len(world.hydro.touched.impulse) > 0


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"name": "rov", "like": "spare", "p_NB": [0, 0, 2]}, "already"),
        ({"name": "a/b", "like": "spare", "p_NB": [0, 0, 2]}, "cannot be a name"),
        ({"name": "world", "like": "spare", "p_NB": [0, 0, 2]}, "cannot be a name"),
        ({"name": "x", "like": "whale", "p_NB": [0, 0, 2]}, "whale"),
        ({"name": "x", "like": "spare", "p_NB": [0, 0, 12]}, "begin inside the seabed"),
        ({"name": "x", "like": "spare", "p_NB": [1.5, 0, 9.7]}, 'begin inside "crate"'),
        ({"name": "x", "like": "spare", "p_NB": [0, 0, 2], "q_NB": [0, 0, 0, 0]}, "zero length"),
    ],
)
def test_a_refused_spawn_changes_nothing(args: dict[str, object], text: str) -> None:
    world = world_of()
    world.step(3)
    before = world.call("world/state_hash")
    with pytest.raises(Refused, match=text):
        world.call("world/spawn", **args)
    assert world.call("world/state_hash") == before
    assert set(world.vehicles) == {"rov", "crate"}
    world.step(10)


def test_rows_of_who_left_are_used_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(population, "MAX_BODIES", 5)
    world = world_of()
    for n in range(4):
        for like in ("spare", "crate", "spare"):
            world.call(
                "world/spawn", name=f"{like}{len(world.members)}", like=like, p_NB=[5.0, 4.0 * len(world.members), 4.0]
            )
        assert [member.vehicle.row for member in world.members.values()] == [0, 1, 2, 3, 4]
        assert len(world.hydro) == 5, "nobody has rows but those who were here at once"
        before = world.call("world/state_hash")
        with pytest.raises(Refused, match="room for 5 bodies"):
            world.call("world/spawn", name="more", like="spare", p_NB=[9.0, 0.0, 4.0])
        assert world.call("world/state_hash") == before
        for name in [*world.members][2:]:
            world.call("world/remove", name=name)
        # What the scenario begins with keeps its rows for a reset.
        assert set(world.members) == {"rov", "crate"}
        world.step(n + 1)


@pytest.mark.parametrize("like", ["rov", "crate"])
def test_who_comes_into_used_rows_begins_as_new(like: str) -> None:
    """Nothing of the one before: no set point, no motion, no fault, and no impulse where it lay on the seabed."""
    used, new = world_of(), world_of()
    place = {"like": like, "p_NB": [0.0, 5.0, 9.7], "q_NB": [0.9, 0.0, 0.0, 0.4]}
    used.call("world/spawn", name="before", **place)
    fault = {"name": "flooded", "kind": "buoyancy_change", "target": "before", "parameters": {"fraction": -0.2}}
    used.call("world/set_fault", **fault)
    for k in range(400):
        if like == "rov" and k == 50:
            used.command("before/thrusters", u=[0.4] * 8)
        used.step()
        new.step()
    assert (used.hydro.touched.contacts.body_a == 2).any(), "it lies on the seabed"
    used.call("world/remove", name="before")
    assert not (used.hydro.touched.contacts.body_a == 2).any()
    for world in (used, new):
        world.call("world/spawn", name="after", **place)
    assert used.vehicles["after"].row == new.vehicles["after"].row == 2
    for _ in range(200):
        assert used.step() == new.step()
        np.testing.assert_array_equal(used.hydro.state, new.hydro.state)
    parts = [snapshot.take(world).parts for world in (used, new)]
    for states in parts:
        del states["world/samples"]  # which are numbered, those of who left too
    assert parts[0] == parts[1]


def test_a_spawn_into_used_rows_that_is_refused_changes_nothing() -> None:
    world = world_of()
    world.call("world/spawn", name="a", like="spare", p_NB=[5.0, 0.0, 4.0])
    world.call("world/remove", name="a")
    before = world.call("world/state_hash")
    with pytest.raises(Refused, match="begin inside the seabed"):
        world.call("world/spawn", name="b", like="spare", p_NB=[5.0, 0.0, 12.0])
    assert world.call("world/state_hash") == before
    world.step(10)
    world.call("world/spawn", name="b", like="spare", p_NB=[5.0, 0.0, 4.0])
    assert world.vehicles["b"].row == 2


def test_a_snapshot_knows_who_was_in_which_row() -> None:
    world = world_of()

    def story() -> list[object]:
        """Who comes next, and where, after the rows of `a` are free."""
        world.call("world/spawn", name="c", like="spare", p_NB=[5.0, 0.0, 4.0])
        world.call("world/spawn", name="d", like="spare", p_NB=[5.0, 9.0, 4.0])
        world.command("c/thrusters", u=[0.5] * 6)
        samples = world.step(40)
        rows = [(name, member.vehicle.row) for name, member in world.members.items()]
        return [samples, rows, world.call("world/state_hash")]

    for name, y in (("a", 0.0), ("b", 3.0)):
        world.call("world/spawn", name=name, like="spare", p_NB=[5.0, y, 4.0])
    world.step(5)
    world.call("world/remove", name="a")
    world.call("world/snapshot", name="here")
    first = story()
    assert first[1] == [("rov", 0), ("crate", 1), ("c", 2), ("b", 3), ("d", 4)]
    world.call("world/restore", name="here")
    assert story() == first
    world.call("world/reset")
    world.call("world/restore", name="here")
    assert story() == first


def test_two_that_meet_after_a_spawn_without_anything_solid_before() -> None:
    scenario = Scenario(
        schema=1,
        vehicles={"rov": VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 5.0))},
        server=Server(metrics=False),
    )
    world = build(load(scenario, adapters={}))
    assert world.scene is None
    world.call("world/spawn", name="other", like="rov", p_NB=[0.7, 0.0, 5.0])  # drag stops it after 0.34 m
    world.hydro.state[world.vehicles["other"].row, 7] = -1.0
    met = False
    for _ in range(240):
        world.step()
        met = met or bool(world.hydro.touched.impulse.any())
    assert met


def test_what_was_sent_to_the_one_before_does_not_reach_the_next() -> None:
    """One client sends all of it at once: each is checked when it comes, and carried out when another body has the name."""
    world = world_of()
    world.call("world/spawn", name="guest", like="rov", p_NB=[5.0, 0.0, 4.0])
    world.step(2)
    command = Command("guest/thrusters", checked_command(world.ports["guest/thrusters"], {"u": [0.5] * 8}), "a")
    replies: list[Reply] = []
    arguments = {"name": "guest", "like": "spare", "p_NB": [5.0, 0.0, 4.0], "q_NB": [1.0, 0.0, 0.0, 0.0]}
    for item in (Call("world/remove", {"name": "guest"}, "a"), Call("world/spawn", arguments, "a"), command):
        world.submit(item, replies.append)  # type: ignore[arg-type]
    world.step(2)
    assert [reply.fault.code if reply.fault else "" for reply in replies] == ["", "", "bad_shape"]
    assert world.call("guest/thrusters/get")["value"] == {}  # type: ignore[index,call-overload]


def test_who_comes_into_an_empty_world_is_told_of() -> None:
    world = world_of()
    for name in ("rov", "crate"):
        world.call("world/remove", name=name)
    world.advance()
    world.call("world/spawn", name="guest", like="rov", p_NB=[5.0, 0.0, 4.0])
    assert [event.event for event in world.advance().events] == ["ports_changed"]


def test_who_was_made_once_is_only_loaded_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """However often a reset takes him out and a restore brings him back."""
    world, made = world_of(), list[str]()
    build_member = population.vehicle_member
    monkeypatch.setattr(population, "vehicle_member", lambda *args: made.append(args[3]) or build_member(*args))
    for n in range(3):
        world.call("world/spawn", name=f"guest{n}", like="spare", p_NB=[5.0, 4.0 * n, 4.0])
    world.step(5)
    world.call("world/snapshot", name="four")
    expected = world.call("world/state_hash")
    assert made == ["guest0", "guest1", "guest2"]
    for _ in range(3):
        world.call("world/reset")
        assert set(world.members) == {"rov", "crate"}
        world.step(3)
        world.call("world/restore", name="four")
        assert world.call("world/state_hash") == expected
    assert made == ["guest0", "guest1", "guest2"]


def test_a_restore_makes_those_whose_rows_others_had() -> None:
    """Thrusters have their rows behind those of all bodies before."""
    world, fresh = world_of(), world_of()
    for each, kinds in ((fresh, ("spare", "crate", "rov")), (world, ("crate", "rov", "spare"))):
        for n, like in enumerate(kinds):
            each.call("world/spawn", name=f"guest{n}", like=like, p_NB=[5.0, 4.0 * n, 4.0])
    fresh.step(5)
    saved = snapshot.to_bytes(fresh, snapshot.take(fresh))
    world.step(7)
    world.call("world/snapshot", name="own")
    own = world.call("world/state_hash")
    snapshot.from_bytes(world, saved)
    for each in (fresh, world):
        each.command("guest0/thrusters", u=[0.5] * 6)
        each.command("guest2/thrusters", u=[-0.5] * 8)
        each.step(20)
    assert world.call("world/state_hash") == fresh.call("world/state_hash")
    world.call("world/restore", name="own")
    assert world.call("world/state_hash") == own
    world.command("guest1/thrusters", u=[0.5] * 8)
    world.step(20)
    assert np.linalg.norm(state_of(world, "guest1")[7:10]) > 0.01


def test_a_fault_of_one_who_left_does_not_come_back_with_him() -> None:
    world = world_of()
    world.call("world/spawn", name="guest", like="spare", p_NB=[5.0, 0.0, 4.0])
    world.call("world/snapshot", name="sound")
    world.call("world/set_fault", name="mute", kind="sensor_silent", target="guest/imu")
    world.call("guest/depth/deactivate")
    world.step(3)
    world.call("world/reset")
    world.call("world/restore", name="sound")
    told = {sample.port for sample in world.step(240)}
    assert {"guest/imu", "guest/depth"} <= told


def test_one_who_comes_under_the_name_of_one_who_left_begins_as_new() -> None:
    """Though he is in the same row: a spawn is no restore."""
    used, fresh = world_of(), world_of()
    used.call("world/spawn", name="guest", like="spare", p_NB=[5.0, 0.0, 4.0])
    used.command("guest/thrusters", u=[1.0] * 6)
    used.step(50)
    used.call("world/reset")
    for world in (used, fresh):
        world.call("world/spawn", name="guest", like="spare", p_NB=[5.0, 0.0, 4.0])
        world.step(30)
    assert used.call("world/state_hash") == fresh.call("world/state_hash")


def test_a_restore_that_fails_takes_everything_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the fault is the server's own."""
    world = world_of()
    world.call("world/spawn", name="guest", like="spare", p_NB=[5.0, 0.0, 4.0])
    saved = snapshot.to_bytes(world, snapshot.take(world))
    world.call("world/reset")
    before = world.call("world/state_hash")

    def fail(*_: object) -> None:
        raise RuntimeError("broken")

    with monkeypatch.context() as broken:
        broken.setattr(type(world.sensors["rov/imu"]), "check", fail)
        with pytest.raises(RuntimeError, match="broken"):
            snapshot.from_bytes(world, saved)
    assert set(world.members) == {"rov", "crate"}
    assert world.call("world/state_hash") == before
    world.step(10)
