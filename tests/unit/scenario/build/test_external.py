"""External vehicles in a world: who touches them, who sees them, and that a state and a recording bring them back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.ports import Command, Refused
from uwserver.ports.checks import checked_command
from uwserver.recording.format import head_of, metadata
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.scene.scenery import Scenery
from uwserver.scenario.solids.tables import FlatSeabed
from uwserver.scenario.vehicle.entry import COLOURS, Copies, VehicleEntry
from uwserver.sensors.acoustic.altimeter import AltimeterConfig
from uwserver.sensors.truth import Truth
from uwserver.simulation.clock import Timing
from uwserver.world import World
from uwserver.world.external.body import is_nowhere
from uwserver.world.state import snapshot
from uwserver.world.state.scene_probe import SceneProbe


def external(**keys) -> VehicleEntry:
    return VehicleEntry(model="bluerov2", kind="external", **keys)


def resolved_of(**vehicles: VehicleEntry) -> Resolved:
    return load(Scenario(schema=1, seed=3, seabed=FlatSeabed(depth_m=10.0), vehicles=vehicles), adapters={})


def world_of(**vehicles: VehicleEntry) -> World:
    return build(resolved_of(**vehicles))


ROV = VehicleEntry(
    model="bluerov2",
    position_ned_m=(2.0, 0.0, 5.0),
    truth=Truth(),
    sensors={"up": AltimeterConfig(rate_hz=10, ideal=True, rpy_deg=(180.0, 0.0, 0.0))},
)


def drive(world: World, ticks: int, speed: float = 1.0, name: str = "other", first: int = 0) -> None:
    """Command a pose each 24 ticks: along x through where the ROV is."""
    for k in range(first, first + ticks):
        if k % 24 == 0:
            x = -0.5 + speed * k / 240
            world.command(f"{name}/pose", p_NB=[x, 0, 5], q_NB=[1, 0, 0, 0], v_NB_B=[speed, 0, 0], w_NB_B=[0, 0, 0])
        world.step(1)


def test_a_solid_one_pushes_and_does_not_yield():
    world = world_of(rov=ROV, other=external(solid=True))
    drive(world, 600)
    x, rov = world.vehicles["other"].p_NB[0], world.vehicles["rov"]
    assert x == pytest.approx(-0.5 + 600 / 240, abs=1e-9)
    assert rov.p_NB[0] > 2.3
    assert rov.p_NB[0] - x > 0.3  # it was pushed along, not passed through
    assert 0.5 < rov.nu[0] < 1.5  # at about the speed of what pushes it


def test_a_ghost_touches_nothing():
    alone, haunted = world_of(rov=ROV), world_of(rov=ROV, other=external())
    drive(haunted, 600)
    alone.step(600)
    assert haunted.vehicles["rov"].pose == alone.vehicles["rov"].pose


def test_rays_meet_solid_ones_and_no_ghosts():
    """An altimeter that looks up sees the surface 5 m above it, or the belly of what stands between."""
    for solid in (True, False):
        world = world_of(rov=ROV, other=external(solid=solid))
        world.step(48)
        assert world.read("rov/up").range > 4.9
        world.command("other/pose", p_NB=[2.0, 0.0, 2.0])
        world.step(48)
        if solid:
            assert 2.4 < world.read("rov/up").range < 3.1
        else:
            assert world.read("rov/up").range > 4.5
        world.step(24 * 12)  # silence: it is gone, for rays too
        assert world.read("rov/up").range > 4.5
        assert is_nowhere(world.vehicles["other"].p_NB)


def test_a_pose_in_a_wall_or_far_away_ends_no_run():
    world = world_of(rov=ROV, other=external(solid=True), third=external(solid=True))
    for p in ([2.0, 0.0, 10.3], [2.0, 0.0, 5.0], [1e6, -1e6, 1e6], [0.0, 0.0, 50.0]):
        world.command("other/pose", p_NB=p, v_NB_B=[100, 100, 100], w_NB_B=[100, 100, 100])
        world.command("third/pose", p_NB=p)
        world.step(30)
    assert np.isfinite(world.hydro.state).all()
    assert world.vehicles["rov"].p_NB[0] == pytest.approx(2.0, abs=3.0)


def test_bad_poses_are_refused_to_their_sender():
    world = world_of(other=external())
    for value, code in (
        ({"p_NB": [float("nan"), 0, 0]}, "not_finite"),
        ({"p_NB": [2e6, 0, 0]}, "out_of_range"),
        ({"p_NB": [0, 0, 0], "q_NB": [0, 0, 0, 0]}, "out_of_range"),
        ({"p_NB": [0, 0]}, "bad_shape"),
    ):
        with pytest.raises(Refused) as refused:
            world.command("other/pose", **value)
        assert refused.value.fault.code == code
    world.command("other/pose", p_NB=[1, 2, 3], stamp=10.0)
    world.step(1)
    replies = []
    value = checked_command(world.ports["other/pose"], {"q_NB": [1, 0, 0, 0]})
    world.submit(Command("other/pose", value, "test"), replies.append)
    world.step(1)
    assert "needs p_NB" in replies[0].fault.text
    assert world.vehicles["other"].p_NB == (1.0, 2.0, 3.0)


def test_it_tells_its_age_and_its_distance():
    world = world_of(rov=ROV, other=external(compare_with="rov", rate_hz=24))
    world.step(10)
    assert not world.read("other/state").valid
    world.command("other/pose", p_NB=[2.0, 0.0, 4.0])
    world.step(20)
    state, difference = world.read("other/state"), world.read("other/difference")
    assert state.valid
    assert tuple(state.p_NB) == (2.0, 0.0, 4.0)
    assert state.age == pytest.approx(20 / 240)
    assert state.count == 1
    down = 4.0 - world.vehicles["rov"].p_NB[2]
    assert difference.difference_p_NB[2] == pytest.approx(down, abs=1e-9)
    assert difference.distance == pytest.approx(abs(down), abs=1e-9)
    world.step(480)
    assert world.read("other/state").age == pytest.approx(500 / 240, abs=0.05)
    assert not world.read("other/difference").valid


def test_copies_have_a_port_each_and_one_may_be_spawned():
    world = world_of(rov=ROV, fleet=external(copies=Copies(count=3)))
    world.call("world/spawn", name="guest", like="fleet_1", p_NB=[0.0, 0.0, 0.0])
    for name in ("fleet_1", "fleet_2", "fleet_3", "guest"):
        world.command(f"{name}/pose", p_NB=[1, 1, 1])
    world.step(2)
    assert all(world.vehicles[name].p_NB == (1.0, 1.0, 1.0) for name in ("fleet_1", "fleet_3", "guest"))
    world.call("world/remove", name="guest")
    world.step(2)
    assert "guest/pose" not in world.ports


def test_a_state_brings_it_back_bit_for_bit():
    world = world_of(rov=ROV, other=external(solid=True), never=external())
    drive(world, 300)
    kept = snapshot.to_bytes(world, snapshot.take(world))
    drive(world, 240, first=300)
    after = snapshot.take(world).hash()
    fresh = world_of(rov=ROV, other=external(solid=True), never=external())
    fresh.step(7)
    snapshot.from_bytes(fresh, kept)
    drive(fresh, 240, first=300)
    assert snapshot.take(fresh).hash() == after
    world.call("world/reset")
    world.step(1)
    assert is_nowhere(world.vehicles["other"].p_NB)


def test_a_recording_holds_the_track_and_runs_again_without_the_log(tmp_path):
    log, scenario = tmp_path / "a.mcap", tmp_path / "s.toml"
    _write_log(log)
    scenario.write_text(
        'schema = 1\n[adapters]\n[vehicles.rov]\nmodel = "bluerov2"\nposition_ned_m = [0.0, 0.0, 5.0]\n'
        '[vehicles.other]\nmodel = "bluerov2"\nkind = "external"\nsolid = true\nlog = "a.mcap"\ntrack = "x/pose"\n'
    )
    resolved = load(scenario, adapters={})
    world = build(resolved)
    assert world.vehicles["other"].p_NB == (-2.0, 0.0, 5.0)
    assert "other/pose" not in world.ports
    world.step(480)
    assert world.vehicles["other"].p_NB == pytest.approx((0.0, 0.0, 5.0))
    record = metadata(resolved, 0, Timing())
    log.unlink()
    again = build(head_of(record).resolved)
    again.step(480)
    assert snapshot.take(again).hash() == snapshot.take(world).hash()
    again.step(480)
    assert is_nowhere(again.vehicles["other"].p_NB)


def test_a_state_of_a_run_along_another_track_is_refused(tmp_path):
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        'schema = 1\n[adapters]\n[vehicles.other]\nmodel = "bluerov2"\nkind = "external"\nlog = "a.mcap"\ntrack = "x/pose"\n'
    )
    worlds = []
    for step_m in (0.1, 0.2):
        _write_log(tmp_path / "a.mcap", step_m)
        worlds.append(build(load(scenario, adapters={})))
    kept = snapshot.to_bytes(worlds[0], snapshot.take(worlds[0]))
    with pytest.raises(Refused, match="another scenario"):
        snapshot.from_bytes(worlds[1], kept)


def _write_log(path, step_m: float = 0.1) -> None:
    import json

    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("x/pose", "json", writer.register_schema("x", "jsonschema", b"{}"))
        for k in range(31):
            data = {"value": {"p_NB": [-2.0 + step_m * k, 0.0, 5.0], "q_NB": [1, 0, 0, 0]}}
            writer.add_message(channel, k * 10**8, json.dumps(data).encode(), k * 10**8)
        writer.finish()


def test_its_ports_are_known_before_a_world_is_built():
    resolved = resolved_of(rov=ROV, a=external(), b=external(compare_with="rov"))
    ports = build(resolved).ports
    for name in ("a", "b"):
        assert {f"{name}/{port}" for port in resolved.vehicles[name].external_ports} == {
            path for path in ports if path.startswith(f"{name}/")
        }
    assert resolved.vehicles["rov"].external_ports == ()


def test_viewers_are_told_of_it():
    resolved = resolved_of(rov=ROV, a=external(), b=external(solid=True, colour=(0.1, 0.2, 0.3)), c=external())
    world = build(resolved)
    probe = SceneProbe(world)
    views = {view.name: view for view in Scenery(resolved, world).scene(probe.state().entities).vehicles}
    assert (views["rov"].external, views["rov"].ghost, views["rov"].colour) == (False, False, None)
    assert (views["a"].external, views["a"].ghost, views["a"].colour) == (True, True, COLOURS[0])
    assert (views["b"].external, views["b"].ghost, views["b"].colour) == (True, False, (0.1, 0.2, 0.3))
    assert views["c"].colour == COLOURS[2]
    assert views["a"].shapes == views["b"].shapes == views["rov"].shapes
    assert [part.name for part in views["a"].actuators] == [f"t{k}" for k in range(1, 7)]
    assert views["a"].actuators[0].port is None
    assert is_nowhere(tuple(probe.state().poses[1, :3]))


def test_its_thrusters_turn_as_is_said_and_push_nothing():
    world = world_of(rov=ROV, other=external(solid=True))
    probe = SceneProbe(world)
    assert probe.state().achieved.tolist() == [0] * 12
    world.command("other/pose", p_NB=[5.0, 0, 5])
    world.command("other/actuators", u=[1.0, -1.0, 0.5, 0.0, 0.0, 0.0])
    world.step(1)
    assert probe.state().achieved.tolist() == [0] * 6 + [127, -127, 64, 0, 0, 0]
    assert world.vehicles["other"].nu == (0.0,) * 6
    kept = snapshot.take(world)
    world.step(478)
    assert probe.state().achieved.any()
    world.step(3)  # after 2 s nothing newer has come
    assert not probe.state().achieved.any()
    snapshot.restore(world, kept)
    assert probe.state().achieved.tolist()[6:9] == [127, -127, 64]
    with pytest.raises(Refused, match="not 2"):
        checked_command(world.ports["other/actuators"], {"u": [2.0] * 6})


def test_a_hundred_of_them():
    world = world_of(rov=ROV, fleet=external(solid=True, copies=Copies(count=100)))
    for k in range(100):
        world.command(f"fleet_{k + 1}/pose", p_NB=[10.0 * (k // 10), 10.0 * (k % 10), 20.0])
    world.step(3)
    assert world.vehicles["fleet_100"].p_NB == (90.0, 90.0, 20.0)
