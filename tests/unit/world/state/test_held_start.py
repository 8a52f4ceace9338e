"""The held start: who stays where, until when, in every way of stepping a world."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import uwserver
from uwserver.adapter import installed_adapters
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.world.state import snapshot
from uwserver.world.world import World

HOVER = [0.0, 0.0, 0.0, 0.0, 0.2, 0.2, 0.2, 0.2]


def scenario(*, start: str = "held", seabed: bool = False) -> Scenario:
    """A ROV with an autopilot and an AUV, in a current and waves; with a seabed also a ball that floats up beside them."""
    b = ScenarioBuilder("held", start=start, seed=2).environment(density_kgpm3=1025, gravity_mps2=9.81)
    b.current(velocity_ned_mps=[0.3, 0.2, 0.0]).waves(significant_height_m=1.0, peak_period_s=5, components=4)
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3], attitude_rpy_deg=[0, 10, 45], autopilot={})
    b.truth("rov", rate_hz=20)
    b.sensor("rov", "imu", "imu", rate_hz=60, profile="mems_imu", ideal=True)
    b.sensor("rov", "ahrs", "attitude", rate_hz=40)
    b.sensor("rov", "dvl", "dvl", rate_hz=8, ideal=True)
    b.vehicle("auv", "remus100", position_ned_m=[0, 20, 8])
    if seabed:
        b.seabed("flat", depth_m=10.0)
        b.free_object("ball", "sphere", radius_m=0.3, density_kgpm3=900, position_ned_m=[0.0, 0.0, 6.0])
    return b.build()


def made(scenario: Scenario, seed: int | None = None) -> World:
    """The world that a server steps."""
    return build(load(scenario, adapters=installed_adapters()), seed)


def here(world: World, name: str) -> tuple[object, ...]:
    vehicle = world.vehicles[name]
    return vehicle.p_NB, vehicle.q_NB, vehicle.nu


def events(world: World, ticks: int) -> list[str]:
    """The texts about held vehicles in so many ticks."""
    return [event.text for _ in range(ticks) for event in world.advance().events if event.event == "held"]


@pytest.fixture(scope="module")
def shared() -> World:
    return made(scenario())


@pytest.fixture
def world(shared: World) -> World:
    shared.call("world/reset")
    return shared


def test_it_is_off_unless_the_scenario_asks_for_it() -> None:
    free = made(scenario(start="free"))
    begin = here(free, "rov")
    free.step(24)
    assert "world/held" not in free.parts
    assert not free.vehicles["rov"].is_held
    assert here(free, "rov") != begin


def test_the_pose_keeps_every_bit_in_waves_and_current(world: World) -> None:
    begin = {name: here(world, name) for name in world.vehicles}
    world.step(2400)
    assert {name: here(world, name) for name in world.vehicles} == begin
    assert all(vehicle.is_held for vehicle in world.vehicles.values())
    assert "held until the first command" in repr(world.vehicles["rov"])


def test_a_world_for_programs_is_held_too() -> None:
    world = uwserver.load(scenario())
    begin = list(world.vehicles["rov"].p_NB)
    world.step(240)
    assert list(world.vehicles["rov"].p_NB) == begin
    assert "held until the first command" in repr(world.vehicles["rov"])
    world.command("rov/thrusters", u=HOVER)
    world.step(24)
    assert not world.vehicles["rov"].is_held
    assert list(world.vehicles["rov"].p_NB) != begin


def test_its_sensors_read_a_vehicle_at_rest(world: World) -> None:
    world.step(240)
    acceleration, velocity = world.read("rov/truth/acceleration"), world.read("rov/truth/velocity")
    assert not np.any([acceleration.array(name) for name in acceleration] + [velocity.array(name) for name in velocity])
    # Pitched up by 10 degrees: the specific force is that of a body that stands, whose length is g.
    force = world.read("rov/imu").array("f_S")
    assert np.linalg.norm(force) == pytest.approx(9.81, abs=0.02)
    assert np.max(np.abs(world.read("rov/imu").array("w_S"))) < 1e-3
    assert np.max(np.abs(world.read("rov/dvl").array("v_S"))) == 0.0 or not world.read("rov/dvl").valid
    assert world.read("rov/depth").depth == pytest.approx(3.0, abs=1.0)


def test_a_neutral_command_holds_it_and_the_first_other_one_lets_it_go_in_its_tick(world: World) -> None:
    begin = here(world, "rov")
    assert events(world, 1) == ['"rov", "auv" are held until the first command']
    for _ in range(40):  # as an autopilot that is not armed sends neutral outputs in each frame
        world.command("rov/thrusters", u=[0.0, -0.0] * 4)
        world.step()
    assert here(world, "rov") == begin
    world.command("rov/thrusters", u=HOVER)
    assert events(world, 1) == ['"rov" is held no longer: rov/thrusters was commanded by in-process']
    assert here(world, "rov") != begin
    assert world.vehicles["auv"].is_held  # each by itself


def test_what_exerts_no_force_does_not_let_it_go(world: World) -> None:
    world.command("rov/lights", levels=[0.5, 0.5])
    world.step(24)
    assert world.vehicles["rov"].is_held


@pytest.mark.parametrize(
    ("port", "value"), [("auv/propeller", {"speed_radps": 50.0}), ("auv/rudder", {"angle_rad": 0.1})]
)
def test_propellers_and_fins_let_their_vehicle_go(world: World, port: str, value: dict[str, float]) -> None:
    world.command(port, **value)
    world.step()
    assert [world.vehicles[name].is_held for name in ("rov", "auv")] == [True, False]


def test_a_vehicle_may_be_put_elsewhere_and_one_that_is_given_a_velocity_goes(world: World) -> None:
    state = world.hydro.state[world.vehicles["rov"].row]
    world.step(5)
    state[:3] = 1.0, 2.0, 4.0
    world.step(24)
    assert world.vehicles["rov"].p_NB == (1.0, 2.0, 4.0)
    state[7] = 0.5
    assert events(world, 1) == ['"rov" is held no longer: it was given a velocity']
    assert world.vehicles["rov"].p_NB != (1.0, 2.0, 4.0)


def test_orders_and_sticks_count_from_the_moment_the_autopilot_is_armed(world: World) -> None:
    world.step(24)
    world.call("rov/autopilot/set_mode", mode="stabilise")
    world.command("rov/autopilot/pilot", u=[0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    world.step(24)
    assert world.vehicles["rov"].is_held  # it is not armed, so the stick moves nothing
    world.call("rov/autopilot/arm")
    assert events(world, 1)[-1] == '"rov" is held no longer: its autopilot is armed'


def test_a_vehicle_whose_autopilot_is_armed_at_the_start_goes_at_once() -> None:
    b = ScenarioBuilder("armed", start="held")
    b.vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 3], autopilot={"armed": True, "mode": "manual"})
    world = made(b.build())
    assert events(world, 1) == ['"rov" is held no longer: its autopilot is armed']


def test_the_service_lets_go_one_or_all(world: World) -> None:
    world.call("world/let_go", vehicle="auv")
    assert [world.vehicles[name].is_held for name in ("rov", "auv")] == [True, False]
    with pytest.raises(Refused, match='"auv" is not held; held is: rov'):
        world.call("world/let_go", vehicle="auv")
    world.call("world/let_go")
    begin = here(world, "rov")
    world.step(24)
    assert here(world, "rov") != begin


def test_a_reset_holds_again_and_a_restore_goes_back_to_what_was_held(world: World) -> None:
    begin = here(world, "rov")
    world.step(5)
    world.command("rov/thrusters", u=HOVER)
    world.step(24)
    world.call("world/snapshot", name="rov is free")
    world.call("world/reset")
    assert here(world, "rov") == begin
    world.step(24)
    assert here(world, "rov") == begin
    world.call("world/restore", name="rov is free")
    before = here(world, "rov")
    world.step(24)
    assert here(world, "rov") != before
    assert [world.vehicles[name].is_held for name in ("rov", "auv")] == [False, True]


@pytest.mark.parametrize("released", [False, True])
def test_a_saved_state_goes_on_as_its_world_does(world: World, released: bool) -> None:
    other = made(scenario())
    world.step(30)
    if released:
        world.command("rov/thrusters", u=HOVER)
        world.step(30)
    snapshot.from_bytes(other, snapshot.to_bytes(world, snapshot.take(world)))
    for each in (world, other):
        each.command("rov/thrusters", u=HOVER)
        each.step(60)
    assert snapshot.take(world).hash() == snapshot.take(other).hash()
    assert [vehicle.is_held for vehicle in other.vehicles.values()] == [False, True]


def test_states_of_a_free_world_and_of_vehicles_that_were_not_there_are_refused(world: World) -> None:
    free = made(scenario(start="free"))
    with pytest.raises(Refused, match="another scenario"):
        snapshot.from_bytes(world, snapshot.to_bytes(free, snapshot.take(free)))
    part = world.parts["world/held"]
    with pytest.raises(ValueError, match="not there at the start"):
        part.check(type(part.save())(("rov", "nobody")))


def test_one_tick_at_a_time_many_at_once_and_paused_give_the_same_run(world: World) -> None:
    hashes = []
    for portions in ([1] * 120, [120], [7, 113]):
        world.call("world/reset")
        for n in portions:
            world.step(n)
            world.flush()  # a paused world carries out what is posted, and nothing else
        world.command("rov/thrusters", u=HOVER)
        world.flush()
        assert world.vehicles["rov"].is_held  # until a tick is made
        world.step(60)
        hashes.append(snapshot.take(world).hash())
    assert len(set(hashes)) == 1


def test_a_spawned_vehicle_is_free_and_a_removed_one_is_forgotten(world: World) -> None:
    world.call("world/spawn", name="second", like="rov", p_NB=[5.0, 5.0, 3.0])
    world.step(24)
    assert [vehicle.is_held for vehicle in world.vehicles.values()] == [True, True, False]
    world.call("world/remove", name="rov")
    world.step(24)
    assert [(name, vehicle.is_held) for name, vehicle in world.vehicles.items()] == [("auv", True), ("second", False)]
    world.call("world/reset")
    assert [(name, vehicle.is_held) for name, vehicle in world.vehicles.items()] == [("rov", True), ("auv", True)]


# -- with solids ------------------------------------------------------------------------------------------------------------------------


def test_objects_are_free_and_what_touches_a_held_vehicle_lets_it_go() -> None:
    world = made(scenario(seabed=True))
    begin = here(world, "rov")
    told: list[str] = []
    while not told or len(told) < 2:
        assert world.tick < 2400
        told += events(world, 1)
        if len(told) < 2:
            assert here(world, "rov") == begin or world.hydro.touched.impulse.any()
    assert told[1] == '"rov" is held no longer: something touched it'
    assert world.vehicles["auv"].is_held


def test_a_held_vehicle_has_no_contact_with_the_bottom_or_with_another_held_one() -> None:
    b = ScenarioBuilder("crowd", start="held").seabed("flat", depth_m=10.0)
    for k, depth in enumerate((9.9, 9.8)):
        b.vehicle(f"rov{k}", "bluerov2_heavy", position_ned_m=[0.2 * k, 0, depth])
    world = made(b.build())
    begin = here(world, "rov0")
    world.step(240)
    assert here(world, "rov0") == begin
    assert not len(world.hydro.touched.impulse)
    world.call("world/let_go")
    world.step(2)
    assert world.hydro.touched.impulse.any()


def test_the_first_solid_body_that_is_spawned_touches_a_held_vehicle_too() -> None:
    """Before it comes, the world has no solids at all."""
    b = ScenarioBuilder("alone", start="held").vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 5])
    world = made(b.free_object("ball", "sphere", radius_m=0.3, density_kgpm3=500, present=False).build())
    world.step(24)
    world.call("world/spawn", name="second", like="ball", p_NB=[0.0, 0.0, 7.0])
    told = events(world, 1200)
    assert told == ['"rov" is held no longer: something touched it']


# -- copies -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seabed", [False, True])
def test_copies_are_held_as_their_worlds_are(seabed: bool) -> None:
    batch = uwserver.batch(scenario(seabed=seabed), 2, seeds=2, sensors=("rov/imu",))
    world = made(scenario(seabed=seabed), seed=2)
    row = world.vehicles["rov"].row
    for _ in range(2):
        begin = batch.states("rov")
        for commands in (None, [0.0] * 8, HOVER, None):
            for each in (world, batch):
                if commands is not None:
                    each.command("rov/thrusters", **({"copies": [0]} if each is batch else {}), u=commands)
                each.step(30)
            assert np.array_equal(batch.states("rov")[0], world.hydro.state[row])
        assert np.array_equal(batch.states("rov")[1], begin[1])  # nobody commanded that copy
        assert not np.array_equal(batch.states("rov")[0], begin[0])
        batch.reset()
        world.call("world/reset")
        assert np.array_equal(batch.states("rov"), begin)


def test_an_armed_autopilot_lets_the_vehicle_of_its_copy_go() -> None:
    batch = uwserver.batch(scenario(), 2, seeds=2, sensors=())
    begin = batch.states("rov")
    batch.step(24)
    batch.call("rov/autopilot/arm", copies=[1], force=True)
    batch.step(24)
    assert [np.array_equal(batch.states("rov")[k], begin[k]) for k in range(2)] == [True, False]


# -- the file ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["velocity_frd_mps", "angular_velocity_frd_degps"])
def test_a_held_vehicle_that_is_to_begin_in_motion_is_refused(key: str) -> None:
    b = ScenarioBuilder("moving", start="held").vehicle("rov", "bluerov2_heavy", **{key: [1.0, 0.0, 0.0]})
    with pytest.raises(ScenarioError, match=f'start = "held" holds it at rest: leave {key} out'):
        made(b.build())


def test_any_other_start_is_refused() -> None:
    make: Callable[[], object] = lambda: ScenarioBuilder("odd", start="later").build()  # noqa: E731
    with pytest.raises(ScenarioError, match="start"):
        make()
