"""What the autopilot tells of its commands, and the test of its actuators."""

from __future__ import annotations

import pytest

from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.world.state import snapshot


def test_outputs_are_the_commands_as_parts_of_full_ones(fly):
    f = fly("bluerov2", bottom=None)
    assert f.state["outputs"] == (0.0,) * 6
    f.call("arm")
    f.run(1.0, pilot={"u": [0.4, 0, 0, 0, 0, 0]})
    assert any(f.state["outputs"])
    assert f.state["outputs"] == pytest.approx(f.world.hydro.thrusters["command"].tolist())
    f.call("disarm")
    f.run(0.2)
    assert f.state["outputs"] == (0.0,) * 6


def test_outputs_of_fins_and_shaft_and_of_thrust_in_newtons(fly):
    f = fly("remus100", bottom=None, start=(0.0, 0.0, 10.0))
    f.call("arm")
    f.run(1.0, pilot={"u": [1.0, 0, 0, 0, 1.0, 1.0]})
    servos = f.world.hydro.servos
    assert f.state["outputs"] == pytest.approx((servos["command"] / servos["high"]).tolist())
    names = f.world.ports["v/autopilot/state"].fields[-1].doc.split(": ")[1].split(", ")
    assert len(names) == len(servos)
    assert names[-1].startswith("propellers.")

    f = fly("bluerov2", bottom=None, override={"actuators": {"thrusters": {"input": "force"}}})
    f.call("arm")
    f.send("test", outputs=[1.0, 0, 0, 0, 0, -0.5])
    f.run(0.1)
    strongest = f.world.parts["v/autopilot"].pilot.spec.allocation.devices["high"][0]
    assert f.world.hydro.thrusters["command"] == pytest.approx([strongest, 0, 0, 0, 0, -0.5 * strongest])


def test_a_test_moves_one_actuator_and_ends_disarmed(fly):
    f = fly("bluerov2", bottom=None)
    assert "call v/autopilot/arm first" in f.refusal("autopilot/test", outputs=[0.2] * 6)
    f.call("set_mode", mode="stabilise")
    f.call("arm")
    f.run(1.0, test={"outputs": [0, 0, -0.25, 0, 0, 0]}, pilot={"u": [1.0, 0, 0, 0, 0, 0]})
    assert f.world.hydro.thrusters["command"].tolist() == [0, 0, -0.25, 0, 0, 0]
    assert f.state["outputs"] == (0, 0, -0.25, 0, 0, 0)
    f.run(0.7, pilot={"u": [1.0, 0, 0, 0, 0, 0]})
    assert not f.state["armed"]
    assert not f.world.hydro.thrusters["command"].any()
    assert any("the test of the actuators is over" in text for text in f.events)


@pytest.mark.parametrize("why", ["mode", "leak"])
def test_a_change_of_mode_ends_a_test_disarmed(fly, why):
    f = fly("bluerov2", bottom=None)
    f.call("arm")
    f.run(0.2, test={"outputs": [0.1] * 6})
    assert f.state["tau"] == (0.0,) * 6
    if why == "mode":
        f.call("set_mode", mode="surface")
    else:
        f.world.call("v/leak/set", area_m2=1e-4)
    f.run(1.0)
    assert (f.state["armed"], f.state["mode"]) == (False, "surface")
    assert not f.world.hydro.thrusters["command"].any()
    f.call("arm", force=True)
    f.run(1.0)
    assert f.state["armed"], "the watchdog of a test that is over disarms nobody"


def test_a_test_ends_a_goto_and_halts_a_mission(fly):
    f = fly("bluerov2")
    f.call("arm")
    answers = f.post("goto", position_ned_m=[5.0, 0.0, 3.0])
    f.run(0.3)
    f.run(0.3, test={"outputs": [0.0] * 6})
    assert [answer.fault.code for answer in answers if answer.fault] == ["preempted"]

    f = fly("bluerov2")
    f.call("arm")
    f.call("set_mission", items=[{"kind": "hold", "time_s": 0.1}])
    f.call("start_mission")
    f.send("test", outputs=[0.0] * 6)
    f.run(0.4)
    assert (f.state["mode"], f.state["reached"]) == ("mission", 0)


def test_a_test_is_refused_while_the_autopilot_waits_for_its_sensors():
    b = ScenarioBuilder("waits", adapters={})
    b.vehicle("v", "bluerov2", autopilot={"armed": True, "mode": "stabilise"})
    b.sensor("v", "ahrs", "attitude", rate_hz=40)
    world = build(load(b.build(), adapters={}))
    assert "waits for the sensors" in world.actuators["v/autopilot/test"].refusal
    world.step(240)
    assert world.actuators["v/autopilot/test"].refusal == ""


def test_a_test_is_part_of_a_snapshot(fly):
    f = fly("bluerov2", bottom=None)
    f.call("arm")
    f.send("test", outputs=[0.1, 0, 0, 0, 0, 0])
    f.run(0.1)
    before = snapshot.take(f.world)
    f.call("disarm")
    f.run(0.1)
    snapshot.restore(f.world, before)
    f.run(0.1)
    assert f.state["outputs"] == (0.1, 0, 0, 0, 0, 0)
