"""A pilot's training: when a task is met, when time begins and ends, what a collision costs, and that a saved state goes on."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import pytest

import uwserver
from uwserver.sensors import Pose, TrainingConfig
from uwserver.sensors.onboard.tasks import Gate, HoldDepth, Moment, Reach
from uwserver.sensors.onboard.training import Training, TrainingMemory
from uwserver.sensors.wiring import Touch
from uwserver.world.state import snapshot

S = 1_000_000_000
NAMES = [field.name for field in Training.fields]


class Hull:
    electrics: ClassVar = {}

    def __init__(self, impulse: float) -> None:
        self.impulse = impulse

    def touches(self):
        return [Touch(-1, (0.0, 0.0, 0.0), (0.0, self.impulse, 0.0))] if self.impulse else []


@pytest.fixture
def judge(scope):
    """What is told at a place and a time (s), touched so hard (N s)."""

    def make(limit_s=100.0, **tasks):
        sensor = TrainingConfig(rate_hz=10, tasks=tasks, limit_s=limit_s, collision_points=7.0).build(Pose())

        def told(t, p, impulse=0.0):
            reading = sensor.sense(replace(scope(p_NB=p), t_ns=round(t * S), wiring=Hull(impulse)))
            assert reading.valid
            return dict(zip(NAMES, reading.values, strict=True))

        told.sensor = sensor
        return told

    return make


GATE = Gate(position_ned_m=(10.0, 0.0, 5.0), size_m=(1.0, 2.0, 1.0), heading_deg=90.0, points=40.0)


def test_time_begins_when_thrusters_push(scope):
    class Wired(Hull):
        electrics: ClassVar = {"t1": None}
        drawn = 0.0

        def power(self):
            return self.drawn

    wiring, sensor = Wired(0.0), TrainingConfig(rate_hz=10, tasks={"gate": GATE}).build(Pose())
    for drawn, state in ((0.0, "ready"), (0.5, "ready"), (20.0, "running"), (0.0, "running")):
        wiring.drawn = drawn
        assert sensor.sense(replace(scope(p_NB=(9.0, 0.0, 0.0)), wiring=wiring)).values[0] == state


def test_without_thrusters_time_begins_when_the_vehicle_moves(judge):
    told = judge(reach=Reach(position_ned_m=(5.0, 0.0, 0.0), text="There"))
    assert (told(3.0, (0.0, 0.0, 0.0))["state"], told(4.0, (0.2, 0.0, 0.0))["time"]) == ("ready", 0.0)
    begun = told(6.0, (0.4, 0.0, 0.0))
    assert (begun["state"], begun["time"], begun["task"]) == ("running", 0.0, "There")
    after = told(8.0, (0.4, 0.0, 0.0))
    assert (after["time"], after["left"], after["distance"]) == (2.0, 98.0, pytest.approx(4.6))


def test_a_depth_is_kept_without_a_break(judge):
    told = judge(hold=HoldDepth(depth_m=5.0, tolerance_m=0.5, for_s=3.0))
    told(0.0, (0.0, 0.0, 0.0))
    assert told(1.0, (0.0, 0.0, 4.6))["held"] == 0.0
    assert told(3.0, (0.0, 0.0, 5.4))["held"] == 2.0
    assert told(3.5, (0.0, 0.0, 5.6))["held"] == 0.0  # a break
    assert told(5.0, (9.0, 9.0, 5.0))["goal_p_NB"] == (9.0, 9.0, 5.0)
    assert told(7.9, (0.0, 0.0, 5.0))["state"] == "running"
    assert told(8.0, (0.0, 0.0, 5.0))["state"] == "done"


@pytest.mark.parametrize(
    ("way", "is_passed"),
    [
        (((10.0, -1.0, 5.0), (10.0, 1.0, 5.0)), True),
        (((10.0, 1.0, 5.0), (10.0, -1.0, 5.0)), False),  # the wrong way
        (((8.5, -1.0, 5.0), (8.5, 1.0, 5.0)), False),  # beside it
        (((8.5, -1.0, 5.0), (10.5, 1.0, 5.0)), True),  # at an angle, through its edge
        (((10.0, -1.0, 5.6), (10.0, 1.0, 5.6)), False),  # under it
        (((10.0, -1.0, 5.0), (10.0, -0.1, 5.0)), False),  # not yet
    ],
)
def test_a_gate_is_passed_the_way_it_points_and_inside_the_opening(way, is_passed):
    assert GATE.judge(Moment(*way), (False,), -1).piece == (0 if is_passed else -1)


def test_tasks_follow_one_another_and_time_left_counts(judge):
    told = judge(gate=GATE, reach=Reach(position_ned_m=(10.0, 3.0, 5.0), size_m=(1.0, 1.0, 1.0)))
    told(0.0, (10.0, -2.0, 5.0))
    assert told(1.0, (10.0, -1.0, 5.0))["number"] == 1
    passed = told(2.0, (10.0, 1.0, 5.0))
    assert (passed["number"], passed["count"], passed["task"], passed["score"]) == (2, 2, "reach", 40.0)
    done = told(11.0, (10.0, 2.6, 5.0))
    assert (done["state"], done["time"], done["left"], done["score"]) == ("done", 10.0, 90.0, 40.0 + 100.0 + 90.0)
    later = told(50.0, (0.0, 0.0, 0.0), impulse=9.0)
    assert (later["time"], later["score"], later["collisions"]) == (10.0, 230.0, 0)


def test_collisions_are_counted_once_each_and_cost_points(judge):
    told = judge(reach=Reach(position_ned_m=(50.0, 0.0, 0.0)))
    told(0.0, (0.0, 0.0, 0.0))
    told(1.0, (1.0, 0.0, 0.0))
    assert told(1.1, (1.1, 0.0, 0.0), impulse=0.4)["collisions"] == 0  # too weak
    assert [told(t, (1.1, 0.0, 0.0), impulse=2.0)["collisions"] for t in (2.0, 2.5, 3.4, 4.5)] == [1, 1, 1, 2]
    assert told(5.0, (1.1, 0.0, 0.0))["score"] == -14.0


def test_when_the_time_is_over_it_has_failed_and_may_be_begun_anew(judge):
    told = judge(limit_s=10.0, reach=Reach(position_ned_m=(50.0, 0.0, 0.0)))
    told(0.0, (0.0, 0.0, 0.0))
    told(1.0, (1.0, 0.0, 0.0))
    over = told(11.5, (50.0, 0.0, 0.0))
    assert (over["state"], over["left"], over["score"]) == ("failed", 0.0, 0.0)
    told.sensor.change({"running": True})
    assert told(12.0, (20.0, 0.0, 0.0))["state"] == "ready"
    assert told(13.0, (21.0, 0.0, 0.0))["state"] == "running"
    told.sensor.change({"running": False})
    assert told(14.0, (50.0, 0.0, 0.0))["state"] == "off"


def test_a_memory_of_other_tasks_is_refused(judge):
    sensor = judge(gate=GATE).sensor
    sensor.valid(TrainingMemory(step=1, begun_ns=0, ended_ns=1, done=(True,)))
    with pytest.raises(ValueError, match="all tasks are done, but the training has not ended"):
        sensor.valid(TrainingMemory(step=1))
    with pytest.raises(ValueError, match="2 tasks are done, but there are 1"):
        sensor.valid(TrainingMemory(step=2))
    with pytest.raises(ValueError, match='"done" has 2 numbers, here it needs 1'):
        sensor.valid(TrainingMemory(done=(False, False)))
    with pytest.raises(ValueError, match="piece 1 is met, but its task has only 1"):
        sensor.valid(TrainingMemory(done=(False,), piece=1))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: TrainingConfig(rate_hz=1, tasks={}), "1 to 64 tasks, not 0"),
        (lambda: TrainingConfig(rate_hz=1, tasks={"a, b": GATE}), '"a, b" cannot name a task'),
        (lambda: TrainingConfig(rate_hz=1, tasks={"x" * 61: GATE}), "cannot name a task"),
        (lambda: HoldDepth(depth_m=3.0), "needs for_s"),
    ],
)
def test_what_would_be_no_task_is_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


def test_the_shipped_lesson_can_be_learned_and_a_snapshot_goes_on():
    """The autopilot keeps the depth of the first task; the state in the middle of it gives the same end."""
    world = uwserver.load("pilot_training").core
    world.step(24)
    assert world.read("rov/training").state == "ready"
    world.call("rov/autopilot/set_mode", mode="depth_hold")
    world.call("rov/autopilot/arm")
    world.command("rov/autopilot/depth", depth=4.0)
    world.step(240 * 12)
    kept, ends = snapshot.take(world), []
    assert world.read("rov/training").state == "running"
    for _ in range(2):
        world.step(240 * 14)
        ends.append(world.read("rov/training"))
        snapshot.restore(world, kept)
    assert (ends[0].number, ends[0].task) == (2, "North through the first gate")
    assert ends[0].score == 100.0
    assert ends[0] == ends[1]
