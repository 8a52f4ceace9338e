"""The shipped tasks of a pilot, carried out in lock-step by one who has but sticks, the camera's tilt and the button to mark, and sees the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

import uwserver
from uwserver.adapter import installed_adapters
from uwserver.frames import Vec3, rpy_from_quat
from uwserver.ports import Sample
from uwserver.scenario.load.scenario import load
from uwserver.sensors import TrainingConfig
from uwserver.sensors.onboard.tasks import Follow, Inspect
from uwserver.world.state import snapshot

TICKS = 24
"""Between two looks of the pilot: 0.1 s."""


def limited(value: float, most: float) -> float:
    return max(-most, min(most, value))


class Pilot:
    """Steers `rov` in depth hold."""

    def __init__(self, scenario: str) -> None:
        self.world = uwserver.load(scenario).core
        self.world.step(240)  # until its heading has settled
        self.world.call("rov/autopilot/set_mode", mode="depth_hold")
        self.world.call("rov/autopilot/arm")

    @property
    def told(self) -> Sample:
        return self.world.read("rov/training")

    def steer(self, goal: Vec3, heading: float, most: float = 0.7) -> float:
        """For a tenth of a second towards a place; how far away it is, m."""
        body = self.world.vehicles["rov"]
        _, _, yaw = rpy_from_quat(body.q_NB)
        north, east, down = (there - here for there, here in zip(goal, body.p_NB, strict=True))
        ahead, aside = math.cos(yaw) * north + math.sin(yaw) * east, math.cos(yaw) * east - math.sin(yaw) * north
        turn = math.atan2(math.sin(heading - yaw), math.cos(heading - yaw))
        surge, sway = limited(0.9 * (ahead - body.nu[0]), most), limited(0.9 * (aside - body.nu[1]), most)
        sticks = [surge, sway, limited(1.5 * down, 0.6), 0.0, 0.0, limited(1.2 * turn, 0.6)]
        self.world.command("rov/autopilot/pilot", u=sticks)
        self.world.step(TICKS)
        return math.dist(goal, body.p_NB)

    def fly(self, goal: Vec3, heading: float, is_there: Callable[[float], bool], seconds: float = 60.0) -> None:
        """Until something is so."""
        for _ in range(round(10 * seconds)):
            if is_there(self.steer(goal, heading)):
                return
        raise AssertionError(f"not there in {seconds:g} s: {self.told}")

    def looks(self, name: str) -> bool:
        return name in self.told.found.split(", ") or self.told.number > 1


def task_of(scenario: str, name: str) -> Any:
    config = load(scenario, adapters=installed_adapters()).vehicles["rov"].vehicle.sensors["training"]
    assert isinstance(config, TrainingConfig)
    return config.tasks[name]


SIDES: dict[str, tuple[tuple[float, float], tuple[Vec3, ...]]] = {
    "anode_1": ((-1.0, 0.0), ()),
    "anode_2": ((-1.0, 0.0), ()),
    "anode_3": ((0.0, 1.0), ((5.0, 5.0, 6.5),)),
    "anode_4": ((1.0, 0.0), ((13.0, 5.5, 8.5), (15.5, 4.0, 8.5))),
    "anode_5": ((1.0, 0.0), ((15.5, 0.0, 7.0),)),
    "anode_6": ((0.0, 1.0), ((15.5, 0.0, 3.0), (10.5, 0.0, 3.0), (10.5, 0.0, 8.0))),
}
"""Which way each anode faces, north and east, and how one gets there from the one before without a touch."""


@pytest.mark.slow
def test_the_anodes_can_be_inspected() -> None:
    pilot, task = Pilot("inspect_the_anodes"), task_of("inspect_the_anodes", "anodes")
    assert isinstance(task, Inspect)
    assert set(task.structures) == set(SIDES)
    places = load("inspect_the_anodes", adapters=installed_adapters()).scenario.structures
    for count, (name, ((north, east), ways)) in enumerate(SIDES.items()):
        told = pilot.told
        assert (told.state, told.missing) == ("ready" if count == 0 else "running", 6 - count)
        heading = math.atan2(-east, -north)
        for way in ways:
            pilot.fly(way, heading, lambda away: away < 0.5)
        n, e, d = places[name].position_ned_m
        pilot.fly((n + 1.4 * north, e + 1.4 * east, d), heading, lambda away, name=name: pilot.looks(name))
    assert (pilot.told.number, pilot.told.score, pilot.told.collisions) == (2, 600.0, 0)
    pilot.fly((10.5, 0.0, 3.0), 0.0, lambda away: away < 0.5)
    pilot.fly((3.0, 0.0, 4.0), 0.0, lambda away: pilot.told.state == "done")
    end = pilot.told
    assert (end.collisions, end.lost) == (0, 0.0)
    assert end.score == pytest.approx(650.0 + end.left)
    assert end.left > 100.0  # enough for a learner


def test_an_anode_behind_its_leg_is_not_inspected() -> None:
    """From the south, right distance, camera on it and still: but the leg is between, for anode 5, on its north side."""
    pilot = Pilot("inspect_the_anodes")
    north, east, down = (13.0 + 0.45, -2.5, 7.0)
    stand = (north - 1.9, east, down)
    pilot.fly((10.5, 0.0, 3.0), 0.0, lambda away: away < 0.5)
    pilot.fly((10.5, 0.0, 7.0), 0.0, lambda away: away < 0.5)
    pilot.fly(stand, 0.0, lambda away: away < 0.15)
    hints = set()
    for _ in range(60):
        pilot.steer(stand, 0.0)
        hints.add(pilot.told.hint)
    assert "it is hidden: go round" in hints
    assert pilot.told.found == ""


def test_steel_that_is_touched_costs_points() -> None:
    pilot = Pilot("inspect_the_anodes")
    for _ in range(300):
        pilot.steer((8.0, -2.5, 5.0), 0.0)  # inside a leg
        if pilot.told.collisions:
            break
    assert pilot.told.collisions == 1
    assert pilot.told.score == -25.0


def test_a_saved_state_goes_on_in_the_middle_of_a_look() -> None:
    pilot, stand = Pilot("inspect_the_anodes"), (6.2, -2.5, 7.0)
    pilot.fly(stand, 0.0, lambda away: pilot.told.held > 1.0)
    kept, ends = snapshot.take(pilot.world), []
    for _ in range(2):
        pilot.fly(stand, 0.0, lambda away: pilot.looks("anode_1"), 10.0)
        ends.append(pilot.told)
        snapshot.restore(pilot.world, kept)
    assert ends[0] == ends[1]
    assert ends[0].found == "anode_1"


def test_the_first_finding_of_the_pipe_is_reached_and_marked() -> None:
    pilot, _ = along_the_pipe(lambda pilot: bool(pilot.told.found))
    told = pilot.told
    assert (told.state, told.collisions, told.lost) == ("running", 0, 0.0)
    assert 0.0 < told.part < 0.5
    assert told.score > 0.0


@pytest.mark.slow
def test_the_pipe_can_be_followed_and_its_findings_are_marked() -> None:
    pilot, task = along_the_pipe(lambda pilot: False)
    end = pilot.told
    assert (end.state, end.part, end.missing, end.collisions, end.lost) == ("done", 1.0, 0, 0, 0.0)
    assert set(end.found.split(", ")) == set(task.findings)
    assert end.score == pytest.approx(600.0 + 150.0 + 0.5 * end.left)
    assert end.left > 200.0


def along_the_pipe(is_enough: Callable[[Pilot], bool]) -> tuple[Pilot, Follow]:
    """Follow the pipe, and mark what is found, until it is enough or done."""
    pilot, task = Pilot("follow_the_pipe"), task_of("follow_the_pipe", "pipe")
    assert isinstance(task, Follow)
    pilot.world.command("rov/camera_tilt", tilt=-0.5)
    begin = task.path_ned_m[0]
    pilot.fly((begin[0], begin[1], begin[2] - 1.5), 0.0, lambda away: away < 0.5)
    left = dict(task.findings)
    while pilot.told.state == "running" and not is_enough(pilot):
        p = pilot.world.vehicles["rov"].p_NB
        here = task.nearest(p)
        (north, east, _), ahead = task.at(here.s + 1.0), task.at(here.s + 2.5)
        pilot.steer((north, east, here.p[2] - 1.5), math.atan2(ahead[1] - p[1], ahead[0] - p[0]), 0.45)
        for name, finding in list(left.items()):
            if abs(task.nearest(finding.position_ned_m).s - here.s - 2.0) < 0.2:
                pilot.world.call("rov/training/set", mark=True)
                del left[name]
    return pilot, task


def test_the_way_of_the_task_is_the_axis_of_the_pipe() -> None:
    scenario = load("follow_the_pipe", adapters=installed_adapters())
    path = task_of("follow_the_pipe", "pipe").path_ned_m
    for k, (a, b) in enumerate(pairwise(path), 1):
        pipe = scenario.scenario.structures[f"pipe_{k}"]
        middle = [0.5 * (u + v) for u, v in zip(a, b, strict=True)]
        assert pipe.position_ned_m == pytest.approx(middle, abs=0.006)
        assert pipe.length_m == pytest.approx(math.dist(a, b), abs=0.001)
