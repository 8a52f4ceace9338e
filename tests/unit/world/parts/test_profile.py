"""Where the time of ticks goes: each thing counts once, ticks add up, and a world that is measured does the same as one that is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import uwserver
from uwserver.ports import Call, Sample
from uwserver.world import Diverged, World
from uwserver.world.parts.part import Part, Stage, State
from uwserver.world.parts.profile import STAGES, Line, Profile, Report, untimed


class Acts(Part):
    """Does something in each tick."""

    state_type = State

    def __init__(self, path: str, stage: Stage) -> None:
        self.name, self.stage, self.next_tick = path, stage, 0  # type: ignore[misc]  # classes of their own elsewhere

    @property
    def path(self) -> str:
        return self.name

    def before(self, tick: int, t_ns: int) -> None: ...

    def save(self) -> State:
        return State()

    def load(self, state: Any) -> None: ...


class Clock:
    """Time that passes when it is told to, and 1 us with each look."""

    def __init__(self, looks_ns: int = 0) -> None:
        self.now, self.looks_ns = 0, looks_ns

    def __call__(self) -> int:
        self.now += self.looks_ns
        return self.now

    def work(self, us: int) -> None:
        self.now += 1000 * us


def lines(report: Report) -> dict[tuple[str, str], Line]:
    return {(line.stage, line.what): line for line in report.lines}


def test_what_runs_within_another_counts_there_alone() -> None:
    clock = Clock()
    profile = Profile(clock)
    inner = profile.timed("contact", "response", lambda: clock.work(5))

    def respond(us: int) -> str:
        clock.work(us)
        inner()
        inner()
        return "done"

    outer = profile.timed("physics", "bodies", respond)
    window = profile.open()
    profile.begin()
    clock.work(2)
    assert outer(3) == "done"
    profile.end()
    report = profile.close(window)
    assert (report.ticks, report.mean_us, report.worst_us) == (1, 15.0, 15.0)
    assert report.lines == (
        Line("physics", "bodies", 1, 0, 3.0, 3.0),
        Line("contact", "response", 2, 0, 10.0, 10.0),
        Line("tick", "the rest", 1, 0, 2.0, 2.0),
    )


def test_what_fails_is_measured_too_and_spoils_no_later_tick() -> None:
    clock = Clock()
    profile = Profile(clock)

    def fail() -> None:
        clock.work(7)
        raise ValueError("by the test")

    failing, window = profile.timed("requests", "requests", fail), profile.open()
    profile.begin()
    with pytest.raises(ValueError, match="by the test"):
        failing()
    clock.work(1)  # of a tick that never ends
    profile.begin()
    clock.work(4)
    profile.end()
    told = lines(profile.close(window))
    assert told["requests", "requests"].worst_us == 7.0
    assert told["tick", "the rest"].worst_us == 4.0


def test_means_and_worst_are_of_a_tick_and_what_follows_one_belongs_to_it() -> None:
    clock = Clock()
    profile = Profile(clock)
    publish = profile.timed("publishing", "to the loop", clock.work)
    read = profile.timed("sensors", "imu", clock.work, 3)
    publish(100)  # before anybody measures
    window = profile.open()
    for us in (1, 6, 2):
        profile.begin()
        read(us)
        read(us)
        profile.end()
        publish(10 * us)
    report = profile.close(window)
    told = lines(report)
    assert (report.ticks, report.mean_us, report.worst_us) == (3, 36.0, 72.0)
    assert told["sensors", "imu"] == Line("sensors", "imu", 6, 18, 6.0, 12.0)
    assert told["publishing", "to the loop"] == Line("publishing", "to the loop", 3, 0, 30.0, 60.0)


def test_windows_do_not_disturb_each_other() -> None:
    clock = Clock()
    profile = Profile(clock)

    def tick(us: int) -> None:
        profile.begin()
        clock.work(us)
        profile.end()

    tick(50)
    assert not profile.is_needed
    long = profile.open()
    tick(9)
    short = profile.open()
    tick(3)
    assert profile.report(long).worst_us == 9.0
    found = profile.close(short)
    assert (found.ticks, found.worst_us, found.seconds) == (1, 3.0, 3e-6)
    tick(1)
    assert profile.is_needed
    found = profile.close(long)
    assert (found.ticks, found.worst_us, found.seconds) == (3, 9.0, 13e-6)
    assert not profile.is_needed


def test_a_report_is_for_programs_and_for_people() -> None:
    report = Report(
        2.0, 480, 41.66666, 80.0, (Line("sensors", "imu", 240, 4800, 25.0, 60.0), Line("sensors", "dvl", 16, 320, 16.66666, 70.0))
    )  # fmt: skip
    assert report.as_json() == {
        "seconds": 2.0, "ticks": 480, "mean_us": 41.667, "worst_us": 80.0,
        "lines": [
            {"stage": "sensors", "what": "imu", "calls": 240, "readings": 4800, "mean_us": 25.0, "worst_us": 60.0},
            {"stage": "sensors", "what": "dvl", "calls": 16, "readings": 320, "mean_us": 16.667, "worst_us": 70.0},
        ],
    }  # fmt: skip
    title, head, first, second = report.table().splitlines()
    assert title == "profile of 480 ticks in 2.0 s: a tick takes 41.7 us, the worst 80 us; 1 % of the time"
    assert first.split() == ["sensors", "imu", "25.00", "60.0", "60.0", "240", "50.00", "4800", "2.50"]
    assert second.split() == ["dvl", "16.67", "40.0", "70.0", "16", "500.00", "320", "25.00"]
    assert len(head) == len(first) == len(second)
    assert Report(1.5, 0, 0.0, 0.0, ()).table() == "profile: no tick in 1.5 s"


# -- a world --------------------------------------------------------------------------------------------------------------------------------


def measured(world: World, ticks: int, looks_ns: int = 1000) -> tuple[Report, list[Sample]]:
    profile = Profile(Clock(looks_ns))
    world.watch(profile)
    window = profile.open()
    samples = world.step(ticks)
    world.watch(None)
    return profile.close(window), samples


def test_each_stage_and_kind_has_its_line(make_world) -> None:
    world = make_world(vehicles=2)
    world.call("rov/imu/get")
    world.add(Acts("test/faults", Stage.FAULTS))
    world.add(Acts("world/tethers", Stage.FORCES))
    world.submit(Call("world/state_hash", {}, "me"))
    report, _ = measured(world, 48)
    told = lines(report)
    assert report.ticks == 48
    assert told["physics", "bodies"].calls == told["tick", "the rest"].calls == 48
    assert told["faults", "test_profile"].calls == told["forces", "tethers"].calls == 48
    assert told["requests", "requests"].calls == 1
    # Two vehicles: an IMU of the vehicle file at 120 Hz, and one of the test at 60.
    assert told["sensors", "imu"].readings == 2 * (24 + 12)
    # A pressure and a depth sensor at 48 Hz.
    assert told["sensors", "pressure"].readings == 2 * 2 * 9
    assert told["delivery", "errors, delays"].calls >= told["samples", "for readers"].calls > 0
    assert [line.stage for line in report.lines] == sorted((line.stage for line in report.lines), key=STAGES.index)
    assert sum(line.mean_us for line in report.lines) == pytest.approx(report.mean_us)


def test_autopilots_have_theirs_and_so_has_who_hears() -> None:
    world = uwserver.load("bluerov2_qgc").core
    report, _ = measured(world, 48)
    told = lines(report)
    assert told["autopilots", "autopilots"].calls == 48 / 4
    assert told["listening", "autopilots"].calls > 12
    assert told["sensors", "dvl"].readings > 0


def test_contact_is_told_apart_from_the_bodies() -> None:
    world = uwserver.load("push_the_crate").core
    world.step(120)  # until it lies
    told = lines(measured(world, 10)[0])
    assert told["contact", "detection"].calls == told["contact", "response"].calls == 10
    assert ("physics", "bodies") not in told, "they move within the response"


def test_who_comes_while_it_is_measured_is_measured() -> None:
    world = uwserver.load("bluerov2_pool").core
    profile = Profile(Clock(1000))
    world.watch(profile)
    window = profile.open()
    world.step(48)
    before = lines(profile.report(window))["sensors", "imu"].readings
    name = next(iter(world.vehicles))
    world.dismiss(name)
    world.step(48)
    assert lines(profile.close(window))["sensors", "imu"].readings == before > 0


def test_a_measured_world_does_the_same(make_world) -> None:
    one, other = make_world(vehicles=2), make_world(vehicles=2)
    for world in (one, other):
        world.command("rov/thrusters", u=[0.3] * 8)
    _, samples = measured(one, 60)
    assert samples == other.step(60)
    assert np.array_equal(one.hydro.state, other.hydro.state)
    assert one.step(30) == other.step(30)
    assert one.call("world/state_hash") == other.call("world/state_hash")


def test_nothing_is_paid_when_nobody_measures(world) -> None:
    def function() -> None: ...

    assert untimed("physics", "bodies", function) is function
    clock = Clock(1)
    profile = Profile(clock)
    world.watch(profile)
    world.step(2)
    looked = clock.now
    assert looked > 0
    world.watch(None)
    world.step(20)
    assert clock.now == looked


def test_a_tick_that_diverges_is_measured_until_then(world) -> None:
    profile = Profile(Clock(1000))
    world.watch(profile)
    window = profile.open()
    world.step(3)
    world.hydro.state[0, 7] = np.nan
    with pytest.raises(Diverged):
        world.step(1)
    told = lines(profile.close(window))
    assert told["physics", "bodies"].calls == 4
    assert told["tick", "the rest"].calls == 3
