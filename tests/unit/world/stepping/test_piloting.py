"""An autopilot as a part: when it flies, what it hears, and that its state is a copy. Also of uwserver.autopilot.arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

import uwserver
from uwserver.autopilot.rows import REMEMBERED
from uwserver.ports import Call, Reply
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.world.state import snapshot
from uwserver.world.stepping.piloting import Piloting, Pilots
from uwserver.world.world import World


@pytest.fixture(scope="module")
def flown() -> World:
    world = uwserver.load("rov_autopilot").core
    world.step(300)
    world.call("rov/autopilot/arm", force=True)
    world.step(100)
    return world


def pilot_of(world: World) -> Any:
    part = world.parts["rov/autopilot"]
    assert isinstance(part, Piloting)
    return part


def test_each_flies_with_its_divisor_and_after_a_jump_at_the_next_of_its_ticks() -> None:
    """With each step the variance of the bias grows, and with nothing else."""
    builder = ScenarioBuilder("two", rate_hz=240, adapters={})
    for name, rate in (("a", 60), ("b", 40)):
        builder.vehicle(name, "bluerov2", position_ned_m=(0.0, 0.0, 3.0), autopilot={"rate_hz": rate})
    world = build(load(builder.build(), adapters={}))
    pilots = {name: world.parts[f"{name}/autopilot"].pilot for name in "ab"}  # type: ignore[attr-defined]  # a Piloting
    stepped: dict[str, list[int]] = {"a": [], "b": []}

    def fly(ticks: int) -> None:
        for _ in range(ticks):
            tick = world.tick
            for pilot in pilots.values():
                pilot.estimate.flat = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            world.step()
            for name, pilot in pilots.items():
                if pilot.estimate.flat[5] > 0.0:
                    stepped[name].append(tick)

    fly(13)
    assert stepped == {"a": [0, 4, 8, 12], "b": [0, 6, 12]}
    world.call("world/reset")
    stepped["a"].clear()
    fly(5)
    assert stepped["a"] == [0, 4]


def test_compiled_code_hears_the_sensors_of_its_estimate(flown: World) -> None:
    pilots, part = flown.parts["world/autopilots"], pilot_of(flown)
    assert isinstance(pilots, Pilots)
    assert set(pilots.ports) == set(part.pilot.spec.inputs.ports)
    assert set(pilots.ports) <= set(flown.ports)
    assert part.listens_to == ()
    assert part.pilot.estimate.depth_ns > 0


@pytest.mark.parametrize("wanted", [None, (), ("rov/depth", "rov/autopilot/state")])
def test_it_hears_the_same_whoever_else_reads(wanted: Any) -> None:
    world = uwserver.load("rov_autopilot").core
    world.subscribe(wanted)
    read = {sample.port for sample in world.step(240)}
    assert read == set(wanted) if wanted is not None else read > {"rov/ahrs", "rov/depth"}
    other = uwserver.load("rov_autopilot").core
    other.step(240)
    assert pilot_of(world).save() == pilot_of(other).save()
    assert pilot_of(world).pilot.estimate.depth_ns > 0


def test_a_switched_off_actuator_gets_no_commands(flown: World) -> None:
    flown.call("rov/autopilot/set_mode", mode="depth_hold")
    flown.call("rov/thrusters/deactivate")
    flown.step(8)
    assert not flown.hydro.thrusters["command"].any()
    assert any(pilot_of(flown).pilot.memory.outputs)
    flown.call("rov/thrusters/activate")
    flown.step(8)
    assert flown.hydro.thrusters["command"].any()


def test_its_state_stays_as_it_was_and_it_goes_on_from_there(flown: World) -> None:
    part = pilot_of(flown)
    row = part.pilot.row
    flown.call("rov/autopilot/set_gain", name="depth_p", value=0.7)
    flown.call("rov/autopilot/set_mission", items=[{"kind": "hold", "time_s": 5}])
    flown.command("rov/autopilot/test", outputs=[0.25] * 8)
    flown.step(8)
    kept, before = part.save(), row.read()
    assert (before[2].gains.depth_p, len(before[2].items), before[2].test) == (0.7, 1, (0.25,) * 8)
    assert before[1].outputs == (0.25,) * 8
    part.load(kept)
    flown.call("rov/autopilot/disarm")
    flown.call("rov/autopilot/set_gain", name="depth_p", value=0.5)
    flown.call("rov/autopilot/set_mission", items=[])
    flown.step(50)
    assert not part.pilot.orders.armed
    assert row.records(kept.pilot) == before
    assert flown.actuators["rov/thrusters"].refusal == ""
    part.check(kept)
    part.load(kept)
    assert row.read() == before
    assert part.save() == kept
    assert part.pilot.orders.armed
    assert "held by the autopilot" in flown.actuators["rov/thrusters"].refusal
    part.pilot.disarm()
    assert row.records(kept.pilot)[2].armed


@pytest.mark.parametrize(
    ("record", "field", "value", "text"),
    [
        ("e", "q", 0.0, "no rotation"),
        ("e", "p", 1e300, "out of all range"),
        ("e", "depth_ns", -(2**63), "out of all range"),
        ("e", "leak", 2, "2 is no code"),
        ("m", "push", np.inf, "out of all range"),
        ("o", "index", 5, "does not have"),
        ("o", "mode", -1, "-1 is no code"),
        ("o", "failsafe", 10, "10 is no code"),
        ("o", "given", 16, "16 are no bits"),
        ("o", "gains", -1.0, "Expected `float` >= 0.0"),
        ("o", "gains", np.nan, "Expected `float` >= 0.0"),
    ],
)
def test_what_cannot_be_its_state_is_refused(flown: World, record: str, field: str, value: Any, text: str) -> None:
    part = pilot_of(flown)
    state = part.save()
    row = np.frombuffer(state.pilot.row, REMEMBERED).copy()
    row[record][field] = value
    with pytest.raises(ValueError, match=text):
        part.check(structs.replace(state, pilot=structs.replace(state.pilot, row=row.tobytes())))
    assert part.save() == state


@pytest.mark.parametrize("change", [{"row": b""}, {"row": bytes(8)}, {"outputs": bytes(8)}, {"test": bytes(56)}])
def test_a_state_of_another_vehicle_is_refused(flown: World, change: dict[str, bytes]) -> None:
    part = pilot_of(flown)
    state = part.save()
    with pytest.raises(ValueError, match="saved by another version, or with other actuators"):
        part.check(structs.replace(state, pilot=structs.replace(state.pilot, **change)))


def test_who_waits_for_the_end_of_a_way_is_answered_when_it_leaves() -> None:
    world = uwserver.load("rov_autopilot").core
    world.step(300)
    world.call("rov/autopilot/arm", force=True)
    world.call("rov/autopilot/set_mode", mode="guided")
    service = world.services["rov/autopilot/goto"]
    args: dict[str, Any] = {a.name: a.default for a in service.arguments if not a.required}
    answers: list[Any] = []
    world.submit(Call("rov/autopilot/goto", {**args, "position_ned_m": [20.0, 0.0, 5.0]}), answers.append)
    world.step(5)
    pilot_of(world).leave("the vehicle was taken out")
    world.step()
    last = answers[-1]
    assert isinstance(last, Reply)
    assert last.fault is not None
    assert last.fault.code == "preempted"


# -- autopilots, bodies and sensors that come and go, and errors of delivery; nobody but the autopilots wants any sample ----------------------


def unread(seed: int = 7, **delivery: dict[str, Any]) -> World:
    """Two vehicles that hold their depth; nobody reads anything. `delivery`: modifiers of the depth sensor of `a`, by name."""
    builder = ScenarioBuilder("unread", seed=seed, rate_hz=240, adapters={})
    for k, name in enumerate("ab"):
        start = (10.0 * k, 0.0, 5.0)
        builder.vehicle(name, "bluerov2", position_ned_m=start, autopilot={"start_position_ned_m": start})
        builder.sensor(name, "ahrs", "attitude", rate_hz=40, noise_deg=0.05)
        builder.sensor(name, "depth", "pressure", output="depth", rate_hz=24)
    for name, keys in delivery.items():
        builder.modifier("a", "depth", name, **keys)
    world = build(load(builder.build(), adapters={}))
    world.subscribe(())
    return world


def dive(world: World, *names: str) -> World:
    assert world.step(240) == []
    for name in names:
        world.call(f"{name}/autopilot/set_mode", mode="depth_hold")
        world.call(f"{name}/autopilot/arm")
        world.command(f"{name}/autopilot/depth", depth=7.0)
    assert world.step(480) == []
    return world


def part_of(world: World, name: str) -> Piloting:
    part = world.parts[f"{name}/autopilot"]
    assert isinstance(part, Piloting)
    return part


def heard_ns(world: World, name: str) -> int:
    """When the depth that its autopilot has heard last was true."""
    return int(part_of(world, name).pilot.estimate.depth_ns)


def test_an_autopilot_that_a_program_takes_out_flies_and_hears_no_more_until_it_is_put_back() -> None:
    world = dive(unread(), "a", "b")
    part, a, b = part_of(world, "a"), world.members["a"], world.members["b"]
    with_it = a.others
    assert part in with_it
    thrusters = world.hydro.thrusters["command"].copy()
    rows = world.hydro.bodies["thruster_first"][a.vehicle.row], world.hydro.bodies["thruster_count"][a.vehicle.row]
    mine = slice(rows[0], rows[0] + rows[1])
    world.set_members([replace(a, others=tuple(each for each in with_it if each is not part)), b])
    kept, others = part.save(), heard_ns(world, "b")
    world.step(120)
    assert part.save() == kept
    assert (world.hydro.thrusters["command"][mine] == thrusters[mine]).all()
    assert heard_ns(world, "b") > others
    world.set_members([a, b])
    world.step(120)
    assert heard_ns(world, "a") > world.t_ns - 100_000_000
    assert not (world.hydro.thrusters["command"][mine] == thrusters[mine]).any()


def test_an_autopilot_may_be_a_part_of_the_world_itself() -> None:
    world = unread()
    part, a = part_of(world, "a"), world.members["a"]
    services = zip(a.offered, a.carry, strict=True)
    world.set_members([replace(a, others=(), services=services), world.members["b"]])
    world.add(part)
    dive(world, "a", "b")
    same = dive(unread(), "a", "b")
    assert part.save() == part_of(same, "a").save()
    assert world.vehicles["a"].p_NB == same.vehicles["a"].p_NB


def test_vehicles_that_come_and_go_leave_the_others_as_they_are() -> None:
    """They take numbers of streams and rows that others had; each hears its own sensors."""
    world, alone = dive(unread(), "a", "b"), dive(unread(), "a", "b")
    for name in ("c", "A", "c"):
        world.call("world/spawn", name=name, like="b", p_NB=[0.0, 20.0, 9.0])
        world.call(f"{name}/autopilot/arm", force=True)
        world.step(120)
        assert part_of(world, name).pilot.estimate.p[2] == pytest.approx(9.0, abs=0.5)
        assert heard_ns(world, name) > world.t_ns - 100_000_000
        world.call("world/remove", name=name)
        world.step(60)
        alone.step(180)
        for each in "ab":
            assert part_of(world, each).save() == part_of(alone, each).save()


def test_sensors_without_an_autopilot_that_come_and_go_are_heard_by_nobody() -> None:
    builder = ScenarioBuilder("mute", seed=7, rate_hz=240, adapters={})
    builder.vehicle(
        "a", "bluerov2", position_ned_m=(0.0, 0.0, 5.0), autopilot={"start_position_ned_m": (0.0, 0.0, 5.0)}
    )
    builder.vehicle("mute", "bluerov2", position_ned_m=(10.0, 0.0, 9.0), present=False)
    for name in ("a", "mute"):
        builder.sensor(name, "ahrs", "attitude", rate_hz=40, noise_deg=0.05)
    world, alone = (build(load(builder.build(), adapters={})) for _ in range(2))
    for each in (world, alone):
        each.subscribe(())
        dive(each, "a")
    for _ in range(2):
        world.call("world/spawn", name="mute", like="mute", p_NB=[0.0, 20.0, 9.0])
        world.step(120)
        pilots, numbers = world._pilots, world.sensing.numbers
        assert pilots._arrays is not None
        heard = {port for port, k in numbers.items() if pilots._arrays._kept["listeners"][k] >= 0}
        assert heard == set(pilots.ports)
        newest = world.read("mute/depth")
        assert newest is not None
        assert newest.depth == pytest.approx(9.0, abs=0.5)
        world.call("world/remove", name="mute")
        world.step(60)
        alone.step(180)
        assert part_of(world, "a").save() == part_of(alone, "a").save()


def test_beacons_reach_it_in_words_though_nobody_reads_them() -> None:
    builder = ScenarioBuilder("beacons", seed=5, rate_hz=240, adapters={})
    builder.vehicle("a", "bluerov2", position_ned_m=(3.0, 4.0, 5.0), autopilot={})
    builder.sensor("a", "ahrs", "attitude", rate_hz=40)
    beacons = {"b": {"position_ned_m": [60.0, 0.0, 25.0]}}
    builder.sensor("a", "usbl", "usbl", rate_hz=2, beacons=beacons, position_frd_m=[0.0, 0.0, 0.2])
    world, read = (build(load(builder.build(), adapters={})) for _ in range(2))
    world.subscribe(())
    assert part_of(world, "a").listens_to == ("a/usbl",)
    world.step(960)
    assert 8 <= world.stops["called sensors"] <= 24, "the step stops when answers come, not in each tick"
    assert "a/usbl" in {sample.port for sample in read.step(960)}
    assert part_of(world, "a").pilot.estimate.fix_ns > 3_000_000_000
    assert part_of(world, "a").save() == part_of(read, "a").save()


def test_one_that_was_removed_comes_back_with_a_state_and_goes_on_as_if_nothing_had_been() -> None:
    world = unread()
    world.call("world/spawn", name="A", like="b", p_NB=[0.0, 20.0, 9.0])
    dive(world, "a", "A")
    kept = snapshot.take(world)
    world.step(200)
    there = snapshot.take(world).hash()
    flew = part_of(world, "A").save()
    for name in "cd":
        # As many autopilots as in the state, and at once in the place of these.
        for gone, new, y in (("A", name, 20.0), ("b", f"{name}2", 40.0)):
            world.call("world/remove", name=gone)
            world.call("world/spawn", name=new, like="b", p_NB=[0.0, y, 9.0])
        world.step(50)
        snapshot.restore(world, kept)
        assert part_of(world, "A").save() == kept.parts["A/autopilot"]
        assert world.step(200) == []
        assert part_of(world, "A").save() == flew
        assert snapshot.take(world).hash() == there


@pytest.mark.parametrize(
    ("modifier", "least_s", "most_s"),
    [
        ({"kind": "delay", "latency_s": 0.2}, 0.2, 0.25),
        ({"kind": "delay", "latency_s": 0.2, "jitter_s": 0.02}, 0.1, 0.4),
        ({"kind": "dropout", "probability": 0.7}, 0.0, 1.5),
    ],
)
def test_it_hears_late_and_lossy_samples_as_if_everybody_read_them(
    modifier: dict[str, Any], least_s: float, most_s: float
) -> None:
    world, read = unread(error=modifier), unread(error=modifier)
    read.subscribe(None)
    ages, shown = [], []
    for _ in range(480):
        assert world.step() == []
        samples = {sample.port: sample for sample in read.step()}
        assert part_of(world, "a").save() == part_of(read, "a").save()
        ages.append((world.t_ns - heard_ns(world, "a")) * 1e-9)
        shown += [samples["a/depth"]] if "a/depth" in samples else []
    assert least_s <= min(ages[240:])
    assert max(ages[240:]) <= most_s
    assert heard_ns(world, "a") == shown[-1].t_ns
    assert len(shown) < 48 if modifier["kind"] == "dropout" else len(shown) > 40


def test_faults_of_its_sensors_reach_it_though_nobody_reads_them() -> None:
    world = dive(unread(), "a", "b")
    orders = part_of(world, "a").pilot.orders
    world.call("world/set_fault", name="dark", kind="sensor_silent", target="a/depth")
    world.call("world/set_fault", name="dark2", kind="sensor_silent", target="a/pressure")
    world.step(300)
    assert (orders.failsafe, orders.mode) == ("sensor depth", "stabilise")
    assert part_of(world, "b").pilot.orders.mode == "depth_hold"
    world.call("world/clear_fault", name="dark")
    world.step(24)
    assert heard_ns(world, "a") > world.t_ns - 100_000_000
    world.call("a/autopilot/set_mode", mode="depth_hold")
    world.call("a/depth/deactivate")
    world.step(300)
    assert orders.failsafe == "sensor depth"
    world.call("a/depth/activate")
    world.call("a/depth/set", rate_hz=10)
    world.step(48)
    assert heard_ns(world, "a") > world.t_ns - 150_000_000
