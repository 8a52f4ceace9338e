"""Sensors that are added, removed or put in another order change nobody else's numbers, not in the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from msgspec import structs

from uwserver.adapter import installed_adapters
from uwserver.modifiers import Dropout, GaussMarkov, WhiteNoise
from uwserver.ports import Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.sensors.base import StreamTable
from uwserver.world import World

TICKS = 240
Sensors = Mapping[str, Any]
KEPT = {"imu", "pressure", "compass", "gps", "battery", "navigation", "ctd", "dvl", "shafts", "tactical_imu", "sonar"}
"""What stays where others go: in compiled code and in plain Python, with modifiers and without, and those that repeat others."""


def backwards(sensors: Sensors) -> Sensors:
    return dict(reversed(sensors.items()))


def with_another_of_each(sensors: Sensors) -> Sensors:
    """Before them and after them; a second battery would feed the thrusters."""
    others = {name: sensor for name, sensor in sensors.items() if name not in ("battery", "navigation")}
    before = {f"a_{name}": structs.replace(sensor, streams={}) for name, sensor in others.items()}
    after = {f"z_{name}": structs.replace(sensor, rate_hz=sensor.rate_hz / 2) for name, sensor in others.items()}
    return {**before, **sensors, **after}


def without_most(sensors: Sensors) -> Sensors:
    return {name: sensor for name, sensor in sensors.items() if name in KEPT}


def with_more_streams(sensors: Sensors) -> Sensors:
    """Another stream of each imu, with errors and losses of its own."""
    noise, wander = WhiteNoise(field="f_S", sigma=0.1), GaussMarkov(field="w_S", sigma=0.1, tau_s=1.0)
    more = {"more": StreamTable(modifiers={"a": noise, "b": wander, "c": Dropout(probability=0.5)})}
    return {
        name: structs.replace(sensor, streams={**more, **sensor.streams}) if "imu" in name else sensor
        for name, sensor in sensors.items()
    }


CHANGES = {
    "backwards": backwards,
    "another of each": with_another_of_each,
    "most are gone": without_most,
    "more streams": with_more_streams,
}


@cache
def whole() -> Resolved:
    return load("one_of_everything", adapters=installed_adapters())


def world_of(change: Callable[[Sensors], Sensors] = dict, others: tuple[str, ...] = (), seed: int = 5) -> World:
    """One of everything, with other sensors of `heavy`, and with more vehicles, which stand before those that there are."""
    resolved = whole()
    heavy, small = resolved.vehicles["heavy"], resolved.vehicles["small"]
    far = structs.replace(small.entry, position_ned_m=(400.0, 300.0, 3.0))
    vehicles = {name: replace(small, name=name, entry=far) for name in others} | dict(resolved.vehicles)
    vehicles["heavy"] = replace(heavy, vehicle=structs.replace(heavy.vehicle, sensors=change(heavy.vehicle.sensors)))
    scenario = structs.replace(resolved.scenario, seed=seed, faults={})
    return build(replace(resolved, scenario=scenario, vehicles=vehicles))


def run(world: World, ticks: int = TICKS) -> dict[str, list[Sample]]:
    """Samples by port, under power; without those of the autopilot, which flies by the sensors that it finds."""
    world.command("heavy/thrusters", u=[0.3, 0.2, -0.1, 0.4] * 2)
    told: dict[str, list[Sample]] = {}
    for sample in world.step(ticks):
        if "/autopilot/" not in sample.port:
            told.setdefault(sample.port, []).append(sample)
    return told


@pytest.fixture(scope="module")
def alone() -> dict[str, list[Sample]]:
    return run(world_of())


def assert_same(told: Mapping[str, list[Sample]], as_before: Mapping[str, list[Sample]], least: int) -> None:
    common = sorted(told.keys() & as_before.keys())
    assert len(common) >= least
    # As texts, in which each float differs from each other one and NaN is equal to itself.
    changed = [port for port in common if repr(told[port]) != repr(as_before[port])]
    assert not changed, changed


@pytest.mark.parametrize("change", CHANGES)
def test_other_sensors_change_none_of_its_numbers(change: str, alone: Mapping[str, list[Sample]]) -> None:
    told = run(world_of(CHANGES[change]))
    assert_same(told, alone, len(KEPT))


def test_other_vehicles_change_none_of_its_numbers(alone: Mapping[str, list[Sample]]) -> None:
    told = run(world_of(others=("other",)))
    assert any(port.startswith("other/") for port in told)
    assert_same(told, alone, len(alone))


def test_a_vehicle_that_goes_changes_nobody_elses_numbers() -> None:
    """Its rows in the arrays are given back."""
    both, left = world_of(others=("other",)), world_of(others=("other",))
    run(both, 60)
    run(left, 60)
    left.dismiss("other")
    told, rest = run(both), run(left)
    assert not any(port.startswith("other/") for port in rest)
    assert_same(rest, told, len(rest))


def test_who_is_switched_off_meanwhile_changes_nobody_elses_numbers(alone: Mapping[str, list[Sample]]) -> None:
    world = world_of()
    world.call("heavy/echosounder/deactivate")
    world.call("heavy/fog/deactivate")
    told = run(world)
    assert "heavy/fog" not in told
    assert_same(told, alone, len(alone) - 6)


def test_another_seed_changes_them(alone: Mapping[str, list[Sample]]) -> None:
    """Or else all of this would compare constants."""
    told = run(world_of(seed=6))
    random = ("imu", "tactical_imu", "ctd", "dvl", "shafts", "sonar", "svs", "echosounder")
    same = [name for name in random if repr(told.get(f"heavy/{name}")) == repr(alone.get(f"heavy/{name}"))]
    assert not same
