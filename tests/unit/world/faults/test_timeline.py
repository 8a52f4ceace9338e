"""The timeline of faults as a part: when it has something to do, whom it forgets, and what it takes over."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec import structs

from uwserver.ports import Refused
from uwserver.world.faults import Faults, SensorFrozen, SensorSilent, ThrusterDead
from uwserver.world.faults.timeline import Entry, FaultsState
from uwserver.world.world import World


def faults_of(world: World) -> Faults:
    part = world.parts["world/faults"]
    assert isinstance(part, Faults)
    return part


@pytest.mark.parametrize(
    ("t_s", "tick"), [(0.0, 0), (0.1, 24), (0.101, 25), (0.0041, 1), (3.0, 720), *((k / 240, k) for k in range(1, 12))]
)
def test_a_fault_acts_from_the_first_tick_at_or_after_its_time(world: World, t_s: float, tick: int) -> None:
    faults = faults_of(world)
    faults.set("dead", ThrusterDead(target="rov/thrusters", at_s=t_s))
    assert faults.entries["dead"].begin == tick


def test_the_time_that_a_status_tells_is_the_tick_of_a_fault(world: World) -> None:
    faults = faults_of(world)
    for tick in range(1, 30):
        faults.set("dead", ThrusterDead(target="rov/thrusters", at_s=world.ticks.time_of(tick) / 1e9))
        assert faults.entries["dead"].begin == tick


def test_it_has_nothing_to_do_until_the_next_begin_or_end(world: World) -> None:
    faults = faults_of(world)
    assert faults.next_tick is None
    faults.set("late", SensorSilent(target="rov/imu", at_s=1.0, until_s=2.0))
    faults.set("early", ThrusterDead(target="rov/thrusters", at_s=0.5))
    assert faults.next_tick == 120
    for tick, states in ((120, ("waiting", "active")), (240, ("active", "active")), (480, ("over", "active"))):
        faults.before(tick, 0)
        assert tuple(entry.state for entry in faults.entries.values()) == states
    assert faults.next_tick is None


def test_the_faults_of_a_body_that_goes_are_forgotten_and_no_others(make_world: Callable[..., World]) -> None:
    world = make_world(vehicles=2)
    faults = faults_of(world)
    for target in ("rov/imu", "rov1/imu", "rov1/thrusters"):
        kind: Any = ThrusterDead if target.endswith("thrusters") else SensorSilent
        faults.set(target, kind(target=target))
    faults.forget("rov1")
    assert list(faults.entries) == ["rov/imu"]
    assert world.hydro.thrusters["efficiency"].tolist() == [1.0] * 16
    assert (world.sensors["rov/imu"].fault, world.sensors["rov1/imu"].fault) == ("silent", "")
    world.call("world/remove", name="rov")
    assert not faults.entries


def test_marks_of_sensors_follow_the_state(world: World) -> None:
    faults = faults_of(world)
    empty = faults.save()
    faults.set("a", SensorFrozen(target="rov/imu"))
    faults.set("b", SensorSilent(target="rov/depth", at_s=9.0))
    kept = faults.save()
    faults.load(empty)
    assert (world.sensors["rov/imu"].fault, faults.next_tick) == ("", None)
    faults.load(kept)
    assert (world.sensors["rov/imu"].fault, world.sensors["rov/depth"].fault) == ("frozen", "")
    assert faults.next_tick == 9 * 240


@pytest.mark.parametrize(
    ("changes", "text"),
    [(({}, {}), "one name"), (({"fault": SensorSilent(target="rov/none")},), "no sensor")],
)
def test_a_state_that_cannot_be_is_refused(world: World, changes: tuple[dict[str, Any], ...], text: str) -> None:
    entry = Entry("a", SensorSilent(target="rov/imu"), 0, None)
    with pytest.raises(ValueError, match=text):
        faults_of(world).check(FaultsState(tuple(structs.replace(entry, **change) for change in changes)))


def test_one_that_is_over_already_is_refused_and_the_old_one_of_its_name_stays(world: World) -> None:
    faults = faults_of(world)
    faults.set("a", SensorSilent(target="rov/imu"))
    world.step(480)
    with pytest.raises(Refused, match="over already"):
        faults.set("a", SensorSilent(target="rov/depth", until_s=1.0))
    assert faults.entries["a"].fault.target == "rov/imu"
    assert not faults.clear("b")
