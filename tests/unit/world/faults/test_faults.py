"""Faults from the timeline and by service: what they do to thrust, samples and hulls, and that they are part of the state."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from uwserver.modifiers import WhiteNoise
from uwserver.physics.dynamics.params import rigid_body_inertia
from uwserver.ports import Call, Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ImuConfig
from uwserver.world.faults import Faults
from uwserver.world.faults.table import (
    BuoyancyChange,
    MassLoss,
    SensorFrozen,
    SensorSilent,
    ThrusterDead,
    ThrusterStuck,
    ThrusterWeak,
)
from uwserver.world.state import snapshot
from uwserver.world.state.saving import in_one_piece

RATE = 240


def resolved(**faults):
    imu = ImuConfig(rate_hz=RATE, modifiers={"noise": WhiteNoise(field="f_S", sigma=0.1)})
    vehicles = {
        name: VehicleEntry(model="bluerov2_heavy", position_ned_m=(4.0 * k, 0.0, 20.0), sensors={"fast": imu})
        for k, name in enumerate(("other", "rov"))
    }
    scenario = Scenario(schema=1, vehicles=vehicles, faults=faults, server=Server(metrics=False))
    return load(scenario, adapters={})


without = cache(resolved)


def make(**faults):
    return build(resolved(**faults) if faults else without())


def thrust(world, u=0.5, vehicle="rov"):
    """Thrust of each thruster (8) after two seconds of the same command; the vehicle is held in place."""
    held = world.hydro.state.copy()
    world.command(f"{vehicle}/thrusters", u=[u] * 8)
    for _ in range(2 * RATE):
        world.command(f"{vehicle}/thrusters", u=[u] * 8)
        world.step()
        world.hydro.state[:] = held
    rows = world.hydro.thrusters[8 * (vehicle == "rov") :][:8]
    return rows["efficiency"] * rows["demand"], np.array(world.vehicles[vehicle].wrench)


def test_dead_thrusters_give_no_wrench():
    world = make(dead=ThrusterDead(target="rov/thrusters"))
    forces, wrench = thrust(world)
    assert (forces == 0.0).all()
    assert (wrench == 0.0).all()
    assert np.abs(thrust(make(), vehicle="rov")[1]).max() > 1.0


def test_a_fault_leaves_other_vehicles_alone():
    whole, hurt = make(), make(dead=ThrusterDead(target="rov/thrusters"))
    assert thrust(whole, vehicle="other")[1].tolist() == thrust(hurt, vehicle="other")[1].tolist()


def test_one_dead_member_takes_exactly_its_wrench():
    healthy, hurt = thrust(make())[1], thrust(make(dead=ThrusterDead(target="rov/thrusters", members=("t3",))))[1]
    world = make()
    for name in (f"t{k}" for k in (1, 2, 4, 5, 6, 7, 8)):
        world.call(
            "world/set_fault", name=name, kind="thruster_dead", target="rov/thrusters", parameters={"members": [name]}
        )
    alone = thrust(world)[1]
    assert hurt + alone == pytest.approx(healthy, abs=1e-9)
    assert np.abs(alone).max() > 0.1


def test_weak_thrusters_give_their_part_and_faults_multiply():
    whole = thrust(make())[1]
    half = ThrusterWeak(target="rov/thrusters", factor=0.5)
    assert thrust(make(a=half))[1] == pytest.approx(0.5 * whole, rel=1e-12)
    assert thrust(make(a=half, b=half))[1] == pytest.approx(0.25 * whole, rel=1e-12)


def test_stuck_where_it_was_until_it_hears_its_newest_command_again():
    world = make(stuck=ThrusterStuck(target="rov/thrusters", members=("t1",), at_s=1.0, until_s=2.0))
    healthy = make()
    demands = []
    for second, u in enumerate((0.2, 0.6, -0.4)):
        for w in (world, healthy):
            w.command("rov/thrusters", u=[u] * 8)
            w.step(RATE)
        demands.append(
            (world.hydro.thrusters["demand"][8:16].tolist(), healthy.hydro.thrusters["demand"][8:16].tolist())
        )
        assert demands[second][0][1:] == demands[second][1][1:]
    assert demands[0][0][0] == demands[0][1][0] == demands[1][0][0]
    assert demands[1][1][0] != demands[1][0][0]
    assert demands[2][0][0] == demands[2][1][0]


def test_the_newest_command_during_the_fault_holds_after_it():
    world = make(stuck=ThrusterStuck(target="rov/thrusters", at_s=0.0, until_s=0.5))
    world.command("rov/thrusters", u=[0.3] * 8)
    world.step(100)
    assert (world.hydro.thrusters["demand"][8:16] == 0.0).all()
    world.step(40)
    demand = world.hydro.thrusters["demand"][8:16].copy()
    assert (demand != 0.0).all()
    whole = make()
    whole.command("rov/thrusters", u=[0.3] * 8)
    whole.step(1)
    assert demand.tolist() == whole.hydro.thrusters["demand"][8:16].tolist()


def test_stuck_at_a_given_command():
    given, told = make(full=ThrusterStuck(target="rov/thrusters", u=0.7)), make()
    assert thrust(given, u=-0.2)[1].tolist() == thrust(told, u=0.7)[1].tolist()


def readings(world, port, ticks):
    return [sample for sample in world.step(ticks) if sample.port == port]


def test_a_frozen_sensor_repeats_its_last_value_and_goes_on():
    world = make(ice=SensorFrozen(target="rov/fast", at_s=0.5, until_s=1.0))
    healthy = make()
    hurt, whole = readings(world, "rov/fast", 360), readings(healthy, "rov/fast", 360)
    assert [s.seq for s in hurt] == list(range(360))
    assert [s.t_ns for s in hurt] == [s.t_ns for s in whole]
    assert hurt[:120] == whole[:120]
    assert {s.value for s in hurt[120:240]} == {whole[119].value}
    assert hurt[240:] == whole[240:]  # and its noise is that of a healthy one


def test_a_silent_sensor_says_and_counts_nothing():
    world = make(gone=SensorSilent(target="rov/fast", at_s=0.5, until_s=1.0))
    samples = readings(world, "rov/fast", 360)
    assert len(samples) == 240
    assert [s.seq for s in samples] == list(range(240))
    assert samples[119].t_ns == 500_000_000
    assert samples[120].t_ns > 1_000_000_000
    assert len(readings(world, "other/fast", 10)) == 10


def test_buoyancy_lost_and_found():
    """The force balance tells: heave acceleration times (m + Z_wdot) is the force."""
    for fault, force in (
        (BuoyancyChange(target="rov", force_N=-20.0), 20.0),
        (BuoyancyChange(target="rov", volume_m3=0.001), -1025.0 * 9.81 * 0.001),
        (BuoyancyChange(target="rov", fraction=-0.1), None),
    ):
        whole, hurt = make(), make(leak=fault)
        hurt.step()
        whole.step()
        buoyancy = float(whole.hydro.bodies["buoyancy"][1])
        change = float(hurt.hydro.bodies["buoyancy"][1]) - buoyancy
        assert change == pytest.approx(-0.1 * buoyancy if force is None else -force, rel=1e-12)
        assert float(hurt.hydro.bodies["displaced"][1]) == pytest.approx((buoyancy + change) / 9.81, rel=1e-12)
        M = whole.hydro.bodies["M_RB"][1] + whole.hydro.bodies["M_A"][1]
        hurt.hydro.state[:] = whole.hydro.state
        difference = hurt.hydro.rates_of_change(0.0)[0][1] - whole.hydro.rates_of_change(0.0)[0][1]
        r_b = whole.hydro.bodies["r_b"][1]
        from uwserver.frames import conjugate, rotate

        up_B = np.array(rotate(conjugate(tuple(whole.hydro.state[1, 3:7])), (0.0, 0.0, -change)))
        assert M @ difference == pytest.approx(np.concatenate([up_B, np.cross(r_b, up_B)]), abs=1e-9)


def test_lost_ballast_leaves_the_rest_of_the_body():
    r = (0.1, -0.05, 0.12)
    world, whole = make(drop=MassLoss(target="rov", mass_kg=2.0, position_frd_m=r)), make()
    world.step()
    before, after = whole.hydro.bodies[1], world.hydro.bodies[1]
    assert after["M_RB"] == pytest.approx(before["M_RB"] - rigid_body_inertia(2.0, np.zeros((3, 3)), r), abs=1e-12)
    assert after["weight"] == pytest.approx(before["weight"] - 2.0 * 9.81)
    mass = before["M_RB"][0, 0]
    assert (mass - 2.0) * after["r_g"] == pytest.approx(mass * before["r_g"] - 2.0 * np.array(r), abs=1e-12)
    # about its centre of mass the inertia of what is left is consistent: the static moment of M_RB is that of r_g
    assert after["M_RB"][1, 5] == pytest.approx((mass - 2.0) * after["r_g"][0], abs=1e-9)
    assert after["M_inv"] @ (after["M_RB"] + after["M_A"]) == pytest.approx(np.eye(6), abs=1e-9)
    for name in ("thruster_first", "thruster_count", "wrench_first", "shape_first", "shape_count"):
        assert after[name] == before[name]


def test_cleared_faults_leave_the_very_bits():
    world = make()
    before = world.hydro.bodies.tobytes()
    for name, kind, keys in (
        ("a", "mass_loss", {"mass_kg": 1.7}),
        ("b", "buoyancy_change", {"fraction": -0.3}),
        ("c", "mass_loss", {"mass_kg": 0.3, "position_frd_m": [0.1, 0, 0]}),
    ):
        world.call("world/set_fault", name=name, kind=kind, target="rov", parameters=keys)
    assert world.hydro.bodies.tobytes() != before
    for name in "bac":
        world.call("world/clear_fault", name=name)
    assert world.hydro.bodies.tobytes() == before


def test_events_and_the_list_tell_what_goes_on():
    world = make(dead=ThrusterDead(target="rov/thrusters", at_s=0.1, until_s=0.2))
    (entry,) = world.call("world/faults")
    assert entry == {
        "name": "dead", "state": "waiting", "kind": "thruster_dead", "target": "rov/thrusters", "at_s": 0.1, "until_s": 0.2,
    }  # fmt: skip
    events = []
    for _ in range(60):
        events += world.advance().events
    assert [(e.event, e.tick, e.text) for e in events] == [
        ("fault", 24, 'fault "dead" began: thruster dead of "rov/thrusters"'),
        ("fault", 48, 'fault "dead" ended: thruster dead of "rov/thrusters"'),
    ]
    assert world.call("world/faults")[0]["state"] == "over"


def test_a_fault_meets_the_commands_of_its_tick():
    world = make(stuck=ThrusterStuck(target="rov/thrusters", at_s=0.5))
    world.step(120)
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(2)
    assert (world.hydro.thrusters["demand"][8:16] == 0.0).all()


def test_a_fault_meets_the_commands_that_are_carried_out_before_its_tick():
    """As those of a world that is paused there, or makes ticks in one go."""
    world = make(stuck=ThrusterStuck(target="rov/thrusters", at_s=0.5))
    world.step(120)
    world.flush()
    assert world.call("world/faults")[0]["state"] == "waiting", "nothing was asked"
    world.command("rov/thrusters", u=[0.5] * 8)
    world.flush()
    assert world.call("world/faults")[0]["state"] == "active"
    world.step(2)
    assert (world.hydro.thrusters["demand"][8:16] == 0.0).all()


def test_a_fault_begins_in_its_tick_also_where_the_time_is_set_to_that():
    """Within a tick, and before one."""
    worlds = [make(stuck=ThrusterDead(target="rov/thrusters", at_s=0.1)) for _ in range(3)]
    for world in worlds:
        world.step(24)
    kept = in_one_piece(snapshot.to_bytes(worlds[0], snapshot.take(worlds[0])))
    assert worlds[0].call("world/faults")[0]["state"] == "waiting"
    for world in worlds[1:]:
        world.step(10)
        world.submit(Call("world/load", kept))
    worlds[2].flush()
    hashes = []
    for world in worlds:
        world.step(1)
        assert world.tick == 25
        assert world.call("world/faults")[0]["state"] == "active"
        world.step(9)
        hashes.append(world.call("world/state_hash")["hash"])
    assert hashes[0] == hashes[1] == hashes[2]


FAULTS = {
    "dead": ThrusterDead(target="rov/thrusters", members=("t2",), at_s=0.3, until_s=0.9),
    "stuck": ThrusterStuck(target="rov/thrusters", members=("t4",), at_s=0.4, until_s=1.1),
    "ice": SensorFrozen(target="rov/fast", at_s=0.35, until_s=1.2),
    "leak": BuoyancyChange(target="rov", fraction=-0.05, at_s=0.5),
    "drop": MassLoss(target="rov", mass_kg=1.0, at_s=0.6, until_s=1.0),
}


@pytest.mark.parametrize("at", [10, 100, 150, 250])
def test_snapshot_restore_and_reset_are_exact(at):
    world = make(**FAULTS)

    def run(ticks):
        samples = []
        for k in range(ticks):
            world.command("rov/thrusters", u=[0.3 * np.sin(0.01 * (world.tick + k))] * 8)
            samples += world.step()
        return samples

    begin = world.call("world/state_hash")["hash"]
    run(at)
    kept = snapshot.take(world)
    first, end = run(200), world.call("world/state_hash")
    world.call("world/set_fault", name="more", kind="sensor_silent", target="rov/imu")
    world.call("world/clear_fault", name="leak")
    world.step(33)
    snapshot.restore(world, kept)
    assert snapshot.take(world) == kept
    assert run(200) == first
    assert world.call("world/state_hash") == end
    world.call("world/reset")
    assert world.call("world/state_hash")["hash"] == begin
    run(at)
    assert snapshot.take(world) == kept


def test_the_hash_sees_a_fault_that_waits():
    assert snapshot.take(make()).hash() != snapshot.take(make(x=ThrusterDead(target="rov/thrusters", at_s=99))).hash()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ({"kind": "thruster_dead", "target": "rov/thruster"}, 'no actuator of thrusters "rov/thruster", there are: other/thrusters, rov/th'),
        ({"kind": "thruster_dead", "target": "rov"}, "no actuator of thrusters"),
        ({"kind": "sensor_silent", "target": "rov/thrusters"}, "no sensor .* there are: .*rov/fast"),
        ({"kind": "mass_loss", "target": "sub", "parameters": {"mass_kg": 1}}, 'no vehicle "sub", there are: other, rov'),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"members": ["t9"]}}, 'no thruster "t9".*t1, t2'),
        ({"kind": "thruster_ded", "target": "rov/thrusters"}, "thruster_dead"),
        ({"kind": "thruster_weak", "target": "rov/thrusters"}, "factor"),
        ({"kind": "thruster_weak", "target": "rov/thrusters", "parameters": {"factor": 1.5}}, "<= 1"),
        ({"kind": "thruster_weak", "target": "rov/thrusters", "parameters": {"factor": float("nan")}}, "Expected `float`"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"at_s": float("inf")}}, "Expected `float`"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"until_s": 0}}, "not after"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"oops": 0}}, "oops"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": [1]}, "must be an object"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"members": {1, 2}}}, "parameters|Expected|no thr|`str`"),
        ({"kind": "thruster_dead", "target": "rov/thrusters", "parameters": {"members": ["t1"] * 65}}, "length <= 64"),
        ({"kind": "thruster_dead", "target": "s" * 9000}, 'no actuator of thrusters "s{80}[.]{3}",'),
        ({"kind": "buoyancy_change", "target": "rov"}, "exactly one of"),
        ({"kind": "buoyancy_change", "target": "rov", "parameters": {"force_N": -1000}}, "takes away more than the"),
        ({"kind": "buoyancy_change", "target": "rov", "parameters": {"volume_m3": 5}}, "more than 10 times"),
        ({"kind": "mass_loss", "target": "rov", "parameters": {"mass_kg": 50}}, "no mass"),
        ({"kind": "mass_loss", "target": "rov", "parameters": {"mass_kg": 5, "position_frd_m": [9, 0, 0]}}, "moment of inertia"),
        ({"kind": "mass_loss", "target": "rov", "parameters": {"mass_kg": 5, "position_frd_m": [1e300, 0, 0]}}, "<= 1000"),
    ],
)  # fmt: skip
def test_wrong_faults_are_refused_and_change_nothing(call, text):
    world = make()
    before = snapshot.take(world)
    with pytest.raises(Refused, match=text):
        world.call("world/set_fault", name="x", **call)
    assert snapshot.take(world) == before


def test_more_than_all_is_refused_in_sum():
    world = make()
    world.call("world/set_fault", name="a", kind="mass_loss", target="rov", parameters={"mass_kg": 10, "at_s": 5})
    with pytest.raises(Refused, match="no mass"):
        world.call("world/set_fault", name="b", kind="mass_loss", target="rov", parameters={"mass_kg": 5})
    world.call("world/set_fault", name="a", kind="mass_loss", target="rov", parameters={"mass_kg": 11})
    with pytest.raises(Refused, match='no fault "c", there are: a'):
        world.call("world/clear_fault", name="c")


def test_clearing_what_made_room_leaves_no_negative_buoyancy():
    world = make()
    world.call("world/set_fault", name="float", kind="buoyancy_change", target="rov", parameters={"fraction": 1.0})
    world.call("world/set_fault", name="leak", kind="buoyancy_change", target="rov", parameters={"volume_m3": -0.02})
    world.call("world/clear_fault", name="float")
    assert world.hydro.bodies["buoyancy"][1] == pytest.approx(0.0, abs=1e-9)


def test_there_is_an_end_to_faults():
    world = make()
    for k in range(256):
        world.call("world/set_fault", name=str(k), kind="sensor_silent", target="rov/imu", parameters={"at_s": 50})
    with pytest.raises(Refused, match="256"):
        world.call("world/set_fault", name="one more", kind="sensor_silent", target="rov/imu")
    world.call("world/set_fault", name="7", kind="sensor_silent", target="rov/imu")
    with pytest.raises(Refused, match="at most 64 characters, not 65"):  # all clients hear it
        world.call("world/set_fault", name="x" * 65, kind="sensor_silent", target="rov/imu")


def test_the_work_of_a_fault_grows_with_their_number_and_no_faster(monkeypatch):
    """Any client may set 256; with thrusters times faults, each further one took longer than a tick may be kept waiting."""
    world = make()
    for k in range(256):
        world.call(
            "world/set_fault", name=str(k), kind="thruster_weak", target="rov/thrusters", parameters={"factor": 0.99}
        )
    looks = []
    rows = Faults._rows
    monkeypatch.setattr(Faults, "_rows", lambda faults, fault: looks.append(fault) or rows(faults, fault))
    world.call("world/clear_fault", name="0")
    assert len(looks) <= 2 * 256
    assert world.hydro.thrusters["efficiency"].min() == pytest.approx(0.99**255)


BAD = """
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
[faults.one]
kind = "thruster_dead"
target = "rov/thruster"
[faults.two]
kind = "thruster_weak"
target = "rov/thrusters"
members = ["t1", "t99"]
factor = 0.5
[faults.three]
kind = "mass_loss"
target = "rov"
mass_kg = 100
[faults.four]
kind = "buoyancy_change"
target = "rov"
force_N = 1
fraction = 0.1
[faults.five]
kind = "sensor_silent"
target = "rov/imu"
at_s = 5
until_s = 4
"""


def test_scenario_errors_have_their_place(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(BAD)
    with pytest.raises(ScenarioError) as caught:
        load(path, adapters={})
    text = str(caught.value)
    assert 'bad.toml:7:1: faults.one.target: no actuator of thrusters "rov/thruster", there are: rov/thrusters' in text
    assert 'bad.toml:11:1: faults.two.members: no thruster "t99" in "rov/thrusters", there are: t1, ' in text
    assert "bad.toml:16:1: faults.three.mass_kg: it leaves no mass or no moment of inertia of the" in text
    assert "bad.toml:17:9: faults.four: give exactly one of force_N, fraction and volume_m3: 2 are given" in text
    assert "bad.toml:26:1: faults.five.until_s: 4 s is not after its begin at 5 s" in text


def test_the_builder_has_the_verb():
    scenario = (
        ScenarioBuilder("trial")
        .vehicle("rov", "bluerov2")
        .fault("dead", "thruster_dead", "rov/thrusters", at_s=2)
        .build()
    )
    assert scenario.faults["dead"] == ThrusterDead(target="rov/thrusters", at_s=2.0)
    with pytest.raises(ScenarioError, match="unknown kind"):
        ScenarioBuilder("trial").fault("dead", "thruster_ded", "rov/thrusters")
