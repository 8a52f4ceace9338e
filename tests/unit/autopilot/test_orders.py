"""What the autopilot takes and refuses, how it fails safe, and that a snapshot holds all of it.

Also of uwserver.autopilot.pilot, uwserver.autopilot.ports, uwserver.autopilot.ports and uwserver.autopilot.ports.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.world.state import snapshot

HELD = "is held by the autopilot while it is armed: call v/autopilot/disarm first, or steer by v/autopilot/pilot"


def refused(call, **args):
    with pytest.raises(Refused) as error:
        call(**args)
    return error.value.fault


# -- who commands the actuators ------------------------------------------------------------------------------------------------------------


def test_armed_it_holds_the_actuators_and_disarmed_it_lets_them_go(fly):
    f = fly("bluerov2", bottom=None)
    assert f.refusal("thrusters", u=[0.1] * 6) == ""
    f.call("arm")
    assert f.refusal("thrusters", u=[0.1] * 6) == f'"v/thrusters" {HELD}'
    f.run(2.0)
    # Neither the command before arming nor its watchdog acts any more.
    assert all(command == 0.0 for command in f.world.hydro.thrusters["command"])
    assert not any("watchdog" in text or "no command for" in text for text in f.events)
    f.call("disarm")
    assert f.refusal("thrusters", u=[0.1] * 6) == ""


def test_disarming_stops_the_thrusters(fly):
    f = fly("bluerov2", bottom=None)
    f.call("arm")
    f.run(1.0, pilot={"u": [1.0, 0, 0, 0, 0, 0]})
    assert f.world.hydro.thrusters["command"].any()
    f.call("disarm")
    assert not f.world.hydro.thrusters["command"].any()
    assert f.state["armed"] is False


def test_disarmed_it_moves_nothing(fly):
    f = fly("bluerov2", bottom=None)
    f.call("set_mode", mode="depth_hold")
    f.send("depth", depth=10.0)
    f.run(2.0, pilot={"u": [1.0] * 6})
    assert not f.world.hydro.thrusters["command"].any()


def test_another_actuator_on_the_same_thruster_is_held_too():
    b = ScenarioBuilder("two", adapters={})
    single = {"bow": {"kind": "thruster", "member": "t1"}}
    b.vehicle("v", "bluerov2", position_ned_m=[0, 0, 3], autopilot={"armed": True}, override={"actuators": single})
    world = build(load(b.build(), adapters={}))
    assert world.actuators["v/bow"].refusal == HELD
    world.step(240)
    # Commanded once, as part of the vector.
    assert len(world.parts["v/autopilot"].pilot.spec.held) == 1


def test_a_deactivated_actuator_stays_off(fly):
    f = fly("bluerov2", bottom=None)
    f.world.call("v/thrusters/deactivate")
    f.call("arm")
    f.run(1.0, pilot={"u": [1.0, 0, 0, 0, 0, 0]})
    assert not f.world.hydro.thrusters["command"].any()


def test_a_set_point_that_the_mode_does_not_follow_is_refused_with_the_modes_that_do(fly):
    f = fly("bluerov2")
    text = f.refusal("autopilot/depth", depth=4.0)
    assert text.startswith(
        '"v/autopilot/depth" is not followed in mode manual: call v/autopilot/set_mode with depth_hold'
    )
    f.call("set_mode", mode="depth_hold")
    assert f.refusal("autopilot/depth", depth=4.0) == ""
    assert "position_hold or guided" in f.refusal("autopilot/position", p_N=[0, 0, 1])
    assert f.refusal("autopilot/pilot", u=[0] * 6) == ""


# -- bad input -----------------------------------------------------------------------------------------------------------------------------


def test_bad_values_are_refused_and_change_nothing(fly):
    f = fly("bluerov2")
    f.call("set_mode", mode="position_hold")
    before = f.world.parts["v/autopilot"].save()
    for port, value, code in (
        ("depth", {"depth": math.nan}, "not_finite"),
        ("depth", {"depth": "deep"}, "bad_shape"),
        ("depth", {"depth": 1e5}, "out_of_range"),
        ("pilot", {"u": [2.0, 0, 0, 0, 0, 0]}, "out_of_range"),
        ("pilot", {"u": [0.0] * 5}, "bad_shape"),
        ("position", {"p_N": [0, math.inf, 0]}, "not_finite"),
        ("attitude", {"q_NB": [0, 0, 0, 0]}, "out_of_range"),
        ("velocity", {"speed": 1}, "bad_argument"),
    ):
        with pytest.raises(Refused) as error:
            f.send(port, **value)
        assert error.value.fault.code == code, port
    for service, args, code in (
        ("set_mode", {"mode": "loiter"}, "bad_argument"),
        ("goto", {"position_ned_m": [0, 0, math.nan]}, "not_finite"),
        ("goto", {"position_ned_m": [0, 0]}, "bad_shape"),
        ("goto", {"position_ned_m": [0, 0, 1], "speed_mps": -1.0}, "out_of_range"),
        ("set_gain", {"name": "depth_pp", "value": 1.0}, "bad_argument"),
        ("set_gain", {"name": "depth_p", "value": -1.0}, "out_of_range"),
        ("set_gain", {"name": "depth_p", "value": math.nan}, "not_finite"),
        ("set_mission", {"items": [{"kind": "surface"}, {"kind": "waypoint"}]}, "bad_argument"),
        ("start_mission", {"index": 0}, "denied"),
        ("set_position", {"position_ned_m": [1e9, 0, 0]}, "out_of_range"),
    ):
        with pytest.raises(Refused) as error:
            f.call(service, **args)
        assert error.value.fault.code == code, service
    assert f.world.parts["v/autopilot"].save() == before
    assert "depth_hold" in refused(f.call, service="set_mode", mode="depthhold").text


def test_a_bad_mission_leaves_the_old_one(fly):
    f = fly("bluerov2")
    f.call("set_mission", items=[{"kind": "surface"}])
    fault = refused(f.call, service="set_mission", items=[{"kind": "surface"}, {"kind": "hold", "time_s": -1}])
    assert "item 1" in fault.text
    assert "time_s" in fault.text
    assert f.call("get_mission") == {"items": [{"kind": "surface"}], "index": -1, "reached": 0}


def test_missions_need_arming_items_and_an_index(fly):
    f = fly("bluerov2")
    assert "set_mission first" in refused(f.call, service="start_mission").text
    assert "set_mission first" in refused(f.call, service="set_mode", mode="mission").text
    assert f.state["mode"] == "manual"
    f.call("set_mission", items=[{"kind": "surface"}])
    assert "not armed" in refused(f.call, service="start_mission").text
    f.call("arm")
    assert "from 0 on" in refused(f.call, service="start_mission", index=5).text


@pytest.mark.parametrize(
    ("mode", "without", "bottom", "word"),
    [
        ("heading_hold", ("ahrs",), None, "no heading"),
        ("altitude_hold", ("altimeter", "dvl"), 30.0, "no altitude"),
        ("position_hold", ("dvl",), 30.0, "no position"),
        ("velocity", ("dvl",), 30.0, "no velocity"),
        ("mission", ("dvl",), 30.0, "no position"),
    ],
)
def test_a_mode_without_its_sensor_is_refused_with_the_reason(fly, mode, without, bottom, word):
    f = fly("bluerov2", without=without, bottom=bottom)
    fault = refused(f.call, service="set_mode", mode=mode)
    assert fault.code == "denied"
    assert word in fault.text
    assert f.state["mode"] == "manual"


def test_arming_needs_what_the_mode_needs_unless_forced(fly):
    f = fly("bluerov2", bottom=None)
    f.call("set_mode", mode="depth_hold")
    f.world.call("v/depth/deactivate")
    f.world.call("v/pressure/deactivate")
    f.run(2.0)
    assert "no depth" in refused(f.call, service="arm").text
    f.call("arm", force=True)
    f.run(0.1)
    assert f.state["armed"]
    assert f.state["mode"] == "stabilise"


def test_gains_are_read_and_changed(fly):
    f = fly("bluerov2", bottom=None, autopilot={"gains": {"depth_p": 0.33}})
    assert f.call("get_gains")["depth_p"] == 0.33
    f.call("set_gain", name="depth_p", value=0.9)
    assert f.call("get_gains")["depth_p"] == 0.9
    f.world.call("world/reset")
    assert f.call("get_gains")["depth_p"] == 0.33


# -- goto ----------------------------------------------------------------------------------------------------------------------------------


def test_goto_needs_arming(fly):
    f = fly("bluerov2")
    (reply,) = (answers := f.post("goto", position_ned_m=[1, 0, 3]), f.run(0.1))[0]
    assert answers
    assert reply.fault.code == "denied"
    assert "not armed" in reply.fault.text


@pytest.mark.parametrize(
    ("what", "word"),
    [
        (lambda f: f.post("goto", position_ned_m=[0, 9, 3]), "another goto"),
        (lambda f: f.post("cancel_goto"), "cancelled"),
        (lambda f: f.post("set_mode", mode="depth_hold"), "mode depth_hold"),
        (lambda f: f.post("disarm"), "disarmed"),
        (lambda f: f.send("position", p_N=[0, 0, 3]), "position was commanded"),
        (lambda f: f.send("velocity", v_N=[0.1, 0, 0]), "velocity was commanded"),
        (lambda f: f.world.call("world/reset"), "reset"),
        (lambda f: f.world.call("world/remove", name="v"), "taken out"),
    ],
)
def test_goto_is_preempted_and_says_why(fly, what, word):
    f = fly("bluerov2")
    f.call("arm")
    answers = f.post("goto", position_ned_m=[9, 0, 3])
    f.run(1.0)
    assert not [a for a in answers if hasattr(a, "fault")]
    what(f)
    f.run(0.1)
    last = answers[-1]
    assert last.fault.code == "preempted"
    assert word in last.fault.text


HOLDS = [{"kind": "hold", "time_s": 0.5}, {"kind": "hold", "time_s": 0.5}]


def test_a_flown_mission_tells_progress_and_its_end(fly):
    f = fly("bluerov2")
    f.call("arm")
    answers = f.post("fly_mission", items=HOLDS)
    f.run(2.0)
    assert [answer.fraction for answer in answers[:-1]] == [0.5]
    assert (answers[-1].fault, answers[-1].result) == (None, {"reached": 2})
    again = f.post("fly_mission", index=1)
    f.run(1.0)
    assert [answer.result for answer in again] == [{"reached": 1}]
    f.call("start_mission")  # nobody waits for this one
    f.run(2.0)
    assert (len(answers), len(again)) == (2, 1)


def test_a_mission_that_cannot_be_flown_changes_nothing(fly):
    f = fly("bluerov2")
    f.call("set_mission", items=HOLDS)
    for wrong, word in (
        ({"items": HOLDS[:1]}, "not armed"),
        ({"items": []}, "no mission"),
        ({"items": HOLDS, "index": 2}, "2 items"),
    ):
        answers = f.post("fly_mission", **wrong)
        f.run(0.1)
        assert word in answers[-1].fault.text
        assert f.call("get_mission")["items"] == HOLDS


@pytest.mark.parametrize(
    ("what", "word"),
    [
        (lambda f: f.post("fly_mission"), "mode mission was set"),
        (lambda f: f.post("cancel_fly_mission"), "cancelled"),
        (lambda f: f.post("set_mission", items=HOLDS), "replaced"),
        (lambda f: f.post("clear_mission"), "replaced"),
        (lambda f: f.post("goto", position_ned_m=[0, 9, 3]), "mode guided"),
        (lambda f: f.post("disarm"), "disarmed"),
        (lambda f: f.world.call("world/reset"), "reset"),
    ],
)
def test_a_flown_mission_is_preempted_and_says_why(fly, what, word):
    f = fly("bluerov2")
    f.call("arm")
    answers = f.post("fly_mission", items=[{"kind": "hold", "time_s": 60}])
    f.run(1.0)
    assert answers == []
    what(f)
    f.run(0.1)
    (last,) = answers
    assert (last.fault.code, last.fault.where) == ("preempted", "v/autopilot/fly_mission")
    assert word in last.fault.text


def test_a_cancelled_mission_holds_and_a_cancel_elsewhere_does_nothing(fly):
    f = fly("bluerov2")
    f.call("arm")
    f.call("set_mode", mode="depth_hold")
    f.call("cancel_fly_mission")
    assert f.state["mode"] == "depth_hold"
    f.post("fly_mission", items=[{"kind": "hold", "time_s": 60}])
    f.run(0.5)
    f.call("cancel_fly_mission")
    f.run(0.1)
    assert f.state["mode"] == "position_hold"


def test_a_mission_can_be_left_taken_up_again_and_cleared(fly):
    f = fly("bluerov2")
    f.call("set_mission", items=[{"kind": "hold", "time_s": 1}, {"kind": "hold", "time_s": 100}])
    f.call("arm")
    f.call("start_mission")
    f.run(3.0)
    assert (f.state["mission_index"], f.state["reached"]) == (1, 1)
    f.call("set_mode", mode="position_hold")
    f.call("set_mode", mode="mission")
    f.run(0.5)
    assert (f.state["mission_index"], f.state["reached"]) == (1, 1)
    f.call("clear_mission")
    f.run(0.5)
    assert (f.state["mission_index"], f.state["mission_count"]) == (-1, 0)


def test_set_position_corrects_the_dead_reckoning(fly):
    f = fly("bluerov2")
    f.call("set_position", position_ned_m=[100.0, 50.0, 0.0])
    f.run(0.5)
    state = f.state
    assert state["p_N"][:2] == pytest.approx((100.0, 50.0), abs=0.1)
    assert state["depth"] == pytest.approx(3.0, abs=0.1)


# -- fail-safes ----------------------------------------------------------------------------------------------------------------------------


def test_without_pilot_the_sticks_spring_back_and_a_new_command_heals(fly):
    f = fly("bluerov2", bottom=None)
    f.call("arm")
    f.run(1.0, pilot={"u": [0.5, 0, 0, 0, 0, 0]})
    f.run(1.5)
    assert f.state["failsafe"] == "pilot"
    assert not f.world.hydro.thrusters["command"].any()
    assert any("no command from the pilot" in text for text in f.events)
    f.run(0.1, pilot={"u": [0] * 6})
    assert f.state["failsafe"] == ""


def test_nobody_at_the_sticks_is_no_fault_of_a_mission(fly):
    f = fly("bluerov2")
    f.call("set_mode", mode="position_hold")
    f.call("arm")
    f.run(3.0)
    assert f.state["failsafe"] == ""


def test_water_in_the_hull_brings_it_up_and_keeps_it_from_arming(fly):
    f = fly("bluerov2")
    f.call("set_mode", mode="depth_hold")
    f.call("arm")
    f.world.call("v/leak/set", area_m2=1e-4)
    f.run(1.0)
    assert (f.state["mode"], f.state["failsafe"]) == ("surface", "leak")
    assert any("fail-safe: leak" in text for text in f.events)
    # Once: then the operator has the last word.
    f.call("set_mode", mode="depth_hold")
    f.run(1.0)
    assert (f.state["mode"], f.state["failsafe"]) == ("depth_hold", "leak")
    f.call("disarm")
    assert "water in the hull" in refused(f.call, service="arm").text


def test_a_leak_may_only_be_told(fly):
    f = fly("bluerov2", autopilot={"on_leak": "warn"})
    f.call("set_mode", mode="depth_hold")
    f.call("arm")
    f.world.call("v/leak/set", area_m2=1e-4)
    f.run(1.0)
    assert (f.state["mode"], f.state["failsafe"]) == ("depth_hold", "leak")


def test_an_empty_battery_brings_it_up():
    b = ScenarioBuilder("low", adapters={})
    b.vehicle("v", "bluerov2", position_ned_m=[0, 0, 3], autopilot={"armed": True})
    b.sensor("v", "battery", "battery", rate_hz=10, charge=0.05)
    world = build(load(b.build(), adapters={}))
    world.step(120)
    pilot = world.parts["v/autopilot"].pilot
    assert (pilot.orders.mode, pilot.orders.failsafe) == ("surface", "battery")


@pytest.mark.parametrize(
    ("mode", "silent", "refuge", "reason"),
    [
        ("position_hold", ("dvl",), "depth_hold", "sensor position"),
        ("velocity", ("dvl",), "depth_hold", "sensor velocity"),
        ("altitude_hold", ("dvl", "altimeter"), "depth_hold", "sensor altitude"),
        ("depth_hold", ("depth",), "stabilise", "sensor depth"),
        ("heading_hold", ("ahrs",), "stabilise", "sensor heading"),
        ("heading_hold", ("ahrs", "imu"), "manual", "sensor attitude"),
        ("position_hold", ("depth", "dvl"), "stabilise", "sensor position"),
    ],
)
def test_a_lost_sensor_leads_to_a_safer_mode_with_an_event(fly, mode, silent, refuge, reason):
    f = fly("bluerov2")
    f.call("set_mode", mode=mode)
    f.call("arm")
    f.run(1.0)
    for name in silent:
        f.world.call("world/set_fault", name=name, kind="sensor_silent", target=f"v/{name}")
    f.run(4.0)
    state = f.state
    assert state["mode"] == refuge
    assert state["failsafe"].startswith("sensor ")
    assert any(f"-> {refuge}" in text for text in f.events)
    for name in silent:
        f.world.call("world/clear_fault", name=name)
    f.run(1.5)
    f.call("set_mode", mode=mode)
    assert f.state["failsafe"] == ""


def test_armed_from_the_start_it_waits_for_its_sensors(fly):
    f = fly("bluerov2_heavy", autopilot={"armed": True, "mode": "position_hold"})
    f.run(10.0)
    state = f.state
    assert (state["mode"], state["armed"], state["failsafe"]) == ("position_hold", True, "")
    assert f.vehicle.p_NB == pytest.approx((0.0, 0.0, 3.0), abs=0.2)
    assert f.refusal("thrusters", u=[0] * 8)


def armed(mode, heading_hz=40.0, **sensors):
    """5 m deep, headed east, far from the origin, and armed in a mode that begins with what the sensors say; nobody told it where it is."""
    b = ScenarioBuilder("armed", seed=3, rate_hz=240, adapters={}).seabed("flat", depth_m=30.0)
    b.vehicle("v", "bluerov2_heavy", position_ned_m=[4, 2, 5], attitude_rpy_deg=[0, 0, 90],
              autopilot={"armed": True, "mode": mode})  # fmt: skip
    b.sensor("v", "imu", "imu", rate_hz=60)
    b.sensor("v", "ahrs", "attitude", rate_hz=heading_hz)
    b.sensor("v", "dvl", "dvl", rate_hz=8)
    for name, keys in sensors.items():
        b.sensor("v", name, **keys)
    return build(load(b.build(), adapters={}))


@pytest.mark.parametrize("mode", ["depth_hold", "altitude_hold", "position_hold", "velocity", "guided"])
def test_armed_from_the_start_it_holds_what_it_finds_itself_at(mode):
    world = armed(mode)
    world.step(8 * 240)
    pose = world.vehicles["v"].pose
    assert world.vehicles["v"].p_NB == pytest.approx((4.0, 2.0, 5.0), abs=0.1)
    assert pose.rpy[2] == pytest.approx(math.pi / 2, abs=0.02)


def test_what_is_first_known_after_it_was_armed_is_held_from_then_on():
    """The attitude of the IMU is enough to hold a depth; the compass and the fixes speak later, and turn and shift the estimate, not the vehicle."""
    fixes = {"kind": "motion_capture", "rate_hz": 0.5}
    world = armed("depth_hold", heading_hz=1.0)
    world.step(8 * 240)
    assert world.vehicles["v"].pose.rpy[2] == pytest.approx(math.pi / 2, abs=0.05)
    world = armed("position_hold", mocap=fixes)
    world.step(10 * 240)
    assert world.parts["v/autopilot"].pilot.estimate.p[:2] == pytest.approx((4.0, 2.0), abs=0.1)
    assert world.vehicles["v"].p_NB == pytest.approx((4.0, 2.0, 5.0), abs=0.1)


# -- snapshots -----------------------------------------------------------------------------------------------------------------------------


def test_a_snapshot_in_the_middle_of_a_mission_goes_on_bit_for_bit(fly):
    f = fly("bluerov2_heavy", current=(0.1, 0.0, 0.0))
    f.call("set_mission", items=[
        {"kind": "waypoint", "position_ned_m": [2, 1, 4]}, {"kind": "hold", "time_s": 1},
        {"kind": "waypoint", "position_ned_m": [0, 2, 3], "heading_deg": 30},
    ])  # fmt: skip
    f.call("arm")
    f.call("start_mission")
    # Not on a step of the autopilot, and between a sample and the step that takes it in.
    f.run(5.0)
    f.world.step(3)
    f.run(0.5, pilot={"u": [0, 0, 0.2, 0, 0, 0]})
    kept = snapshot.take(f.world)
    f.run(6.0)
    first = snapshot.take(f.world)
    snapshot.restore(f.world, kept)
    assert snapshot.take(f.world).hash() == kept.hash()
    f.run(6.0)
    second = snapshot.take(f.world)
    assert second.hash() == first.hash()
    assert second.parts["v/autopilot"] == first.parts["v/autopilot"]
    # And in another world of the same scenario.
    other = fly("bluerov2_heavy", current=(0.1, 0.0, 0.0))
    snapshot.restore(other.world, kept)
    other.run(6.0)
    assert snapshot.take(other.world).hash() == first.hash()
    assert other.world.actuators["v/thrusters"].refusal == HELD


def test_the_hash_sees_what_the_autopilot_remembers(fly):
    f = fly("bluerov2", bottom=None)
    before = snapshot.take(f.world).hash()
    f.call("set_gain", name="depth_p", value=0.5)
    assert snapshot.take(f.world).hash() != before


def test_reset_disarms_and_forgets(fly):
    f = fly("bluerov2")
    f.call("set_mode", mode="depth_hold")
    f.call("arm")
    f.run(1.0)
    f.world.call("world/reset")
    f.run(0.1)
    assert (f.state["mode"], f.state["armed"]) == ("manual", False)
    assert f.refusal("thrusters", u=[0.0] * 6) == ""


def test_a_spawned_vehicle_has_its_own_autopilot(fly):
    f = fly("bluerov2", bottom=None)
    f.world.call("world/spawn", name="w", like="v", p_NB=[5, 0, 3])
    f.call("arm")
    f.world.step(60)
    assert f.world.parts["w/autopilot"].pilot.orders.armed is False
    f.world.command("w/thrusters", u=[0.1] * 6)
    f.world.call("world/remove", name="w")
    f.world.step(60)
    assert "w/autopilot" not in f.world.parts


# -- configuration -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"rate_hz": 50}, ["rate_hz", "48 and 60"]),
        ({"gains": {"depth_pp": 1.0}}, ["depth_pp", "depth_p"]),
        ({"gains": {"depth_p": -1.0}}, ["depth_p", "expected"]),
    ],
)
def test_faults_of_the_table_are_told_at_load(table, words):
    b = ScenarioBuilder("wrong", adapters={})
    b.vehicle("v", "bluerov2", autopilot=table)
    with pytest.raises(ScenarioError) as error:
        load(b.build(), adapters={})
    for word in words:
        assert word in str(error.value)


def test_a_vehicle_without_anything_to_steer_with_is_refused():
    b = ScenarioBuilder("wrong", adapters={})
    off = {"thrusters": {"enabled": False}}
    b.vehicle("v", "bluerov2", autopilot={}, override={"actuators": off})
    with pytest.raises(ScenarioError, match="it cannot steer this vehicle"):
        load(b.build(), adapters={})


@pytest.mark.parametrize(
    "model", ["bluerov2", "bluerov2_heavy", "rexrov", "remus100", "lauv", "tethys", "npsauv2", "eca_a9"]
)
def test_every_shipped_vehicle_takes_an_autopilot(fly, model):
    f = fly(model, bottom=None, start=(0.0, 0.0, 10.0))
    f.call("set_mode", mode="depth_hold")
    f.call("arm")
    f.run(3.0, pilot={"u": [0.5, 0, 0, 0, 0, 0]})
    assert f.vehicle.nu[0] > 0.02
    assert all(abs(v) < 3.0 for v in f.vehicle.nu)


def test_steps_follow_the_physics_rate(fly):
    f = fly("bluerov2", bottom=None)
    assert f.world.parts["v/autopilot"].pilot.spec.dt == pytest.approx(1 / 60)
    assert f.world.ports["v/autopilot/state"].rate_hz == 10.0


def test_the_state_is_written_from_estimate_memory_and_orders(fly):
    f = fly("bluerov2")
    f.call("set_mission", items=[{"kind": "hold", "time_s": 1}, {"kind": "hold", "time_s": 100}])
    f.call("arm")
    f.call("start_mission")
    f.run(3.0)
    slot = f.world.sensors["v/autopilot/state"]
    assert slot.writes, "no scope is made for it, and no object for each number"
    pilot = f.world.parts["v/autopilot"].pilot
    valid, values = slot.sensor.measure(None)
    told = dict(zip([field.name for field in slot.fields], values, strict=True))
    e, m, o = pilot.row.read()
    assert valid
    assert (told["mode"], told["armed"], told["failsafe"], told["outputs"]) == ("mission", True, "", m.outputs)
    assert (told["p_N"], told["v_N"], told["q_NB"], told["w_B"], told["tau"]) == (e.p, e.v, e.q, e.w, m.tau)
    assert (told["depth"], told["altitude"]) == (e.p[2], e.bottom - e.p[2])
    assert (told["p_ref_N"], told["depth_ref"], told["heading_ref"]) == (o.place, o.depth, o.heading)
    assert [told["position_valid"], told["velocity_valid"]] == [True, True]
    assert (told["mission_index"], told["mission_count"], told["reached"]) == (1, 2, 1)
    slot.fault = "silent"
    f.world.sensing.python_readings.write(np.array([slot.head]))
    assert not slot.is_ready


def test_ports_and_services_are_those_of_the_contract(fly):
    f = fly("bluerov2", bottom=None)
    ports = {path.removeprefix("v/autopilot/"): port for path, port in f.world.ports.items() if "/autopilot/" in path}
    assert set(ports) == {"pilot", "depth", "altitude", "heading", "attitude", "velocity", "position", "test", "state"}
    assert all(port.kind == "autopilot" for port in ports.values())
    assert [field.name for field in ports["state"].fields] == [
        "mode", "armed", "p_N", "position_valid", "v_N", "velocity_valid", "q_NB", "w_B", "depth", "altitude", "p_ref_N",
        "depth_ref", "heading_ref", "mission_index", "mission_count", "reached", "tau", "failsafe", "outputs",
    ]  # fmt: skip
    assert ports["pilot"].timeout_s == ports["velocity"].timeout_s == ports["attitude"].timeout_s == 1.0
    assert ports["depth"].timeout_s is None
    services = {path.removeprefix("v/autopilot/") for path in f.world.services if path.startswith("v/autopilot/")}
    assert {
        "arm", "disarm", "set_mode", "goto", "cancel_goto", "set_mission", "get_mission", "start_mission", "clear_mission",
        "fly_mission", "cancel_fly_mission", "set_position", "get_gains", "set_gain",
    } <= services  # fmt: skip
    assert ports["test"].timeout_s == 0.5
