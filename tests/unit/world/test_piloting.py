"""An autopilot as a part: when it flies, what it hears, and that its state is a copy."""

from __future__ import annotations

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
from uwserver.world.piloting import Piloting, Pilots
from uwserver.world.world import World


@pytest.fixture(scope="module")
def flown() -> World:
    world = uwserver.load("rov_autopilot")
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
    assert world.parts["world/autopilots"].next_tick == 16
    world.call("world/reset")
    stepped["a"].clear()
    fly(5)
    assert stepped["a"] == [0, 4]


def test_compiled_code_hears_the_sensors_of_its_estimate(flown: World) -> None:
    pilots, part = flown.parts["world/autopilots"], pilot_of(flown)
    assert isinstance(pilots, Pilots)
    assert set(pilots.ports) == set(part.pilot.craft.hearing.ports)
    assert set(pilots.ports) <= set(flown.ports)
    assert part.hears == ()
    assert part.pilot.estimate.depth_ns > 0


@pytest.mark.parametrize("wanted", [None, (), ("rov/depth", "rov/autopilot/state")])
def test_it_hears_the_same_whoever_else_reads(wanted: Any) -> None:
    world = uwserver.load("rov_autopilot")
    world.want(wanted)
    read = {sample.port for sample in world.step(240)}
    assert read == set(wanted) if wanted is not None else read > {"rov/ahrs", "rov/depth"}
    other = uwserver.load("rov_autopilot")
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
    seat = part.pilot.seat
    flown.call("rov/autopilot/set_gain", name="depth_p", value=0.7)
    flown.call("rov/autopilot/set_mission", items=[{"kind": "hold", "time_s": 5}])
    flown.command("rov/autopilot/test", outputs=[0.25] * 8)
    flown.step(8)
    kept, before = part.save(), seat.read()
    assert (before[2].gains.depth_p, len(before[2].items), before[2].test) == (0.7, 1, (0.25,) * 8)
    assert before[1].outputs == (0.25,) * 8
    part.load(kept)
    flown.call("rov/autopilot/disarm")
    flown.call("rov/autopilot/set_gain", name="depth_p", value=0.5)
    flown.call("rov/autopilot/set_mission", items=[])
    flown.step(50)
    assert not part.pilot.orders.armed
    assert seat.records(kept.pilot) == before
    assert flown.actuators["rov/thrusters"].refusal == ""
    part.check(kept)
    part.load(kept)
    assert seat.read() == before
    assert part.save() == kept
    assert part.pilot.orders.armed
    assert "held by the autopilot" in flown.actuators["rov/thrusters"].refusal
    part.pilot.disarm()
    assert seat.records(kept.pilot)[2].armed


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
    with pytest.raises(ValueError, match="other numbers, or commands other actuators"):
        part.check(structs.replace(state, pilot=structs.replace(state.pilot, **change)))


def test_who_waits_for_the_end_of_a_way_is_answered_when_it_leaves() -> None:
    world = uwserver.load("rov_autopilot")
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
