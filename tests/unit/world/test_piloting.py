"""An autopilot as a part: when it flies, what it hears, and that its state is a copy."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import structs

import uwserver
from uwserver.ports import Call, Reply
from uwserver.world.piloting import Piloting
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


def test_it_flies_with_its_divisor_and_after_a_jump_at_the_next_of_its_ticks(flown: World) -> None:
    part, flights = pilot_of(flown), list[int]()
    divisor, original = part.pilot.divisor, part.pilot.step
    part.pilot.step = flights.append
    try:
        for tick in (0, 1, divisor, divisor + 1, 2 * divisor):
            part.before(tick, tick)
        assert flights == [0, divisor, 2 * divisor]
        part.before(2 * divisor + 1, 0)
        assert part.next_tick == 3 * divisor
        part.load(part.save())
        assert part.next_tick == 0
    finally:
        part.pilot.step = original


def test_it_hears_the_sensors_of_its_estimate(flown: World) -> None:
    part = pilot_of(flown)
    assert set(part.hears) == set(part.pilot.craft.estimator.sources)
    assert set(part.hears) <= set(flown.ports)
    assert part.pilot.estimate.depth_ns > 0


def test_its_state_stays_as_it_was_and_it_goes_on_from_there(flown: World) -> None:
    part = pilot_of(flown)
    kept = part.save()
    before = structs.asdict(kept.estimate), structs.asdict(kept.memory), structs.asdict(kept.orders)
    part.load(kept)
    flown.call("rov/autopilot/disarm")
    flown.step(50)
    assert (structs.asdict(kept.estimate), structs.asdict(kept.memory), structs.asdict(kept.orders)) == before
    assert flown.actuators["rov/thrusters"].refusal == ""
    part.load(kept)
    assert part.pilot.orders.armed
    assert "held by the autopilot" in flown.actuators["rov/thrusters"].refusal
    part.pilot.disarm()
    assert kept.orders.armed


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("estimate", {"q": (0.0, 0.0, 0.0, 0.0)}, "no rotation"),
        ("estimate", {"p": (0.0, 1e300, 0.0)}, "out of all range"),
        ("memory", {"outputs": (0.0,)}, "other actuators"),
        ("orders", {"index": 0}, "does not have"),
    ],
)
def test_what_cannot_be_its_state_is_refused(flown: World, name: str, change: dict[str, Any], text: str) -> None:
    part = pilot_of(flown)
    state = part.save()
    with pytest.raises(ValueError, match=text):
        part.check(structs.replace(state, **{name: structs.replace(getattr(state, name), **change)}))


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
