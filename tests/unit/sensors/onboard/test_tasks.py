"""Tasks that are met at one place, and the camera through which a pilot looks.

What counts as inspected and as followed: distance, view, what is between, motion; and what a mark means.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import ClassVar

import msgspec
import pytest
from msgspec import structs

from uwserver.frames import quat_from_rpy
from uwserver.sensors import Pose, TrainingConfig
from uwserver.sensors.base import Outline
from uwserver.sensors.onboard.tasks import (
    Eye,
    Finding,
    Follow,
    Gate,
    HoldDepth,
    Inspect,
    Moment,
    Reach,
    Task,
    eye_at,
    is_hidden,
)
from uwserver.sensors.onboard.training import Training
from uwserver.testing.fake_geometry import FakeGeometry, Sphere
from uwserver.units import rad

AHEAD = Eye((0.0, 0.0, 5.0), (1.0, 0.0, 0.0), 0.8660254)
"""Looks north and sees 30 degrees to each side."""


@pytest.mark.parametrize(
    ("p", "is_in_view"),
    [
        ((3.0, 0.0, 5.0), True),
        ((3.0, 1.7, 5.0), True),  # 29.5 degrees
        ((3.0, 1.8, 5.0), False),  # 31 degrees
        ((3.0, 0.0, 6.8), False),
        ((-3.0, 0.0, 5.0), False),  # behind
        ((0.0, 0.0, 5.0), True),  # at the lens
    ],
)
def test_a_camera_sees_a_cone(p, is_in_view):
    assert AHEAD.has_in_view(p) is is_in_view


def test_a_box_is_reached_inside_its_edges():
    task = Reach(position_ned_m=(5.0, 2.0, 3.0), size_m=(2.0, 1.0, 4.0), points=30.0)
    assert task.worth() == (30.0,)
    for p, piece in (((5.9, 2.4, 4.9), 0), ((6.1, 2.0, 3.0), -1), ((5.0, 2.6, 3.0), -1), ((5.0, 2.0, 5.1), -1)):
        assert task.judge(Moment(p, p), (False,), -1) == (piece, (5.0, 2.0, 3.0), "")


def test_a_depth_lies_below_the_vehicle():
    task = HoldDepth(depth_m=4.0, tolerance_m=0.5, for_s=1.0)
    assert task.judge(Moment((7.0, 8.0, 1.0), (7.0, 8.0, 1.0)), (False,), -1) == (-1, (7.0, 8.0, 4.0), "")
    assert task.judge(Moment((7.0, 8.0, 3.6), (7.0, 8.0, 3.6)), (False,), -1).piece == 0


def test_a_task_of_one_piece_is_over_when_it_is_done():
    task: Task = Reach()
    assert (task.is_over((False,)), task.is_over((True,))) == (False, True)
    assert (task.part((False,)), task.part((True,))) == (0.0, 1.0)
    assert (task.names(), task.has_marks(), task.marked(Moment((0.0,) * 3, (0.0,) * 3), (False,))) == (("",), False, -1)


def test_a_gate_cannot_be_held():
    with pytest.raises(ValueError, match="a gate is passed at once: remove for_s"):
        Gate(for_s=2.0)


S = 1_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
NORTH, EAST = Outline((5.0, 0.0, 3.0), LEVEL, (0.1, 0.1, 0.1)), Outline((0.0, 5.0, 3.0), LEVEL, (0.1, 0.1, 0.1))
BALLS = Sphere((5.0, 0.0, 3.0), 0.12), Sphere((0.0, 5.0, 3.0), 0.12)
"""What stands there: a ball in each box, a little larger than that, so that any ray at the box meets it."""
TASK = Inspect(structures=("north", "east"), points=80.0, distance_m=(0.5, 2.5), max_speed_mps=0.2, max_turn_degps=10.0)


def moment(p, yaw=0.0, pitch=0.0, things=BALLS, **more):
    eye = eye_at(p, quat_from_rpy(0.0, rad(pitch), rad(yaw)), 60.0)
    return Moment(p, p, eye, geometry=FakeGeometry(things), outlines={"north": NORTH, "east": EAST}, **more)


@pytest.mark.parametrize(
    ("seen", "piece", "hint"),
    [
        (moment((3.0, 0.0, 3.0)), 0, "keep looking"),
        (moment((2.6, 0.0, 3.0)), 0, "keep looking"),
        (moment((2.4, 0.0, 3.0)), -1, "go nearer"),
        (moment((4.6, 0.0, 3.0)), -1, "too near: back off"),
        (moment((3.0, 0.0, 3.0), yaw=28.0), 0, "keep looking"),
        (moment((3.0, 0.0, 3.0), yaw=32.0), -1, "turn the camera to it"),
        (moment((3.0, 0.0, 3.0), yaw=180.0), -1, "turn the camera to it"),
        (moment((3.3, 0.0, 1.6)), -1, "turn the camera to it"),  # 39 degrees below
        (moment((3.3, 0.0, 1.6), pitch=-30.0), 0, "keep looking"),  # tilted down
        (moment((3.0, 0.0, 3.0), things=(*BALLS, Sphere((4.0, 0.0, 3.0), 0.3))), -1, "it is hidden: go round"),
        (moment((3.0, 0.0, 3.0), things=(*BALLS, Sphere((6.0, 0.0, 3.0), 0.3))), 0, "keep looking"),  # behind it
        (moment((3.0, 0.0, 3.0), speed=0.25), -1, "hold still"),
        (moment((3.0, 0.0, 3.0), turning=rad(12.0)), -1, "hold still"),
        (moment((0.0, 3.0, 3.0), yaw=90.0), 1, "keep looking"),
    ],
)
def test_what_counts_as_looked_at(seen, piece, hint):
    verdict = TASK.judge(seen, (False, False), -1)
    assert (verdict.piece, verdict.hint) == (piece, hint)


def test_half_of_it_has_to_be_seen():
    """A wall of balls from one side: it hides nothing, the lower samples, all of it."""
    eye = (3.0, 0.0, 3.0)
    assert not is_hidden(eye, NORTH, FakeGeometry((*BALLS, Sphere((4.0, 0.0, 3.3), 0.22))))
    assert is_hidden(eye, NORTH, FakeGeometry((*BALLS, Sphere((4.0, 0.0, 3.2), 0.22))))
    assert is_hidden(eye, NORTH, FakeGeometry(()))  # nothing of it is there


def test_what_is_done_is_done_and_the_goal_is_what_is_left():
    near_north = moment((3.0, 0.0, 3.0))
    assert TASK.judge(near_north, (False, False), -1).goal == NORTH.p
    assert TASK.judge(near_north, (True, False), -1) == (-1, EAST.p, "go nearer")
    assert TASK.judge(near_north, (True, True), -1) == (-1, near_north.p, "")


def test_one_that_is_looked_at_stays_the_one():
    """Two side by side: the farther one is not given up half-way for the nearer."""
    near, far = Outline((2.0, 0.3, 3.0), LEVEL, (0.1,) * 3), Outline((2.2, -0.3, 3.0), LEVEL, (0.1,) * 3)
    things = FakeGeometry((Sphere(near.p, 0.12), Sphere(far.p, 0.12)))
    seen = replace_moment(moment((0.5, 0.0, 3.0)), geometry=things, outlines={"north": near, "east": far})
    assert TASK.judge(seen, (False, False), -1).piece == 0
    assert TASK.judge(seen, (False, False), 1).piece == 1


def replace_moment(seen, **more):
    return seen._replace(**more)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"structures": ("a",), "distance_m": (2.0, 1.0)}, "2 m at least is not less than 1 m"),
        ({"structures": ("a", "b", "a")}, '"a" is named twice'),
    ],
)
def test_what_cannot_be_inspected_is_refused(keys, text):
    with pytest.raises(ValueError, match=text):
        Inspect(**keys)


# -- a pipe -------------------------------------------------------------------------------------------------------------------------------

PIPE = Follow(
    path_ned_m=((0.0, 0.0, 10.0), (6.0, 0.0, 10.0), (6.0, 4.0, 11.0)), points=100.0, aside_m=1.0, height_m=(0.5, 2.5), max_speed_mps=0.8,
    findings={"dent": Finding(position_ned_m=(4.0, 0.0, 10.0), within_m=3.0, points=40.0)},
)  # fmt: skip
NONE = (False,) * 11


def test_its_pieces_are_metres_and_findings():
    assert (PIPE.length, PIPE.metres) == (10.0, 10)
    assert PIPE.worth() == (10.0,) * 10 + (40.0,)
    assert PIPE.names() == ("",) * 10 + ("dent",)
    assert (PIPE.part((True,) * 4 + NONE[4:]), PIPE.part((*NONE[:10], True))) == (0.4, 0.0)
    assert PIPE.is_over((*NONE[:9], True, False))
    assert not PIPE.is_over((*((True,) * 9), False, True))


@pytest.mark.parametrize(
    ("p", "s", "place", "aside"),
    [
        ((2.5, 0.5, 1.0), 2.5, (2.5, 0.0, 10.0), 0.5),
        ((-3.0, 0.0, 9.0), 0.0, (0.0, 0.0, 10.0), 3.0),
        ((7.0, 2.0, 9.0), 8.0, (6.0, 2.0, 10.5), 1.0),
        ((6.0, 9.0, 9.0), 10.0, (6.0, 4.0, 11.0), 5.0),
    ],
)
def test_the_nearest_place_of_a_pipe_is_seen_from_above(p, s, place, aside):
    assert PIPE.nearest(p) == (pytest.approx(s), pytest.approx(place), pytest.approx(aside))


def test_a_way_goes_straight_on_beyond_its_end():
    assert PIPE.at(8.0) == pytest.approx((6.0, 2.0, 10.5))
    assert PIPE.at(12.0) == pytest.approx((6.0, 6.0, 11.5))


@pytest.mark.parametrize(
    ("seen", "piece", "hint"),
    [
        (moment((2.5, 0.5, 8.8)), 2, "follow it"),
        (moment((2.5, 1.1, 8.8)), -1, "too far to the side"),
        (moment((2.5, 0.0, 7.4)), -1, "too high above it"),
        (moment((2.5, 0.0, 9.6)), -1, "too low"),
        (moment((2.5, 0.0, 8.8), yaw=180.0), -1, "turn the camera to it"),
        (moment((2.5, 0.0, 8.8), pitch=40.0), -1, "turn the camera to it"),
        (moment((2.5, 0.0, 8.8), speed=0.9), -1, "too fast"),
        (moment((6.0, 3.9, 9.8), yaw=90.0), 9, "follow it"),  # at its end one looks along it too
    ],
)
def test_a_metre_counts_in_the_corridor_alone(seen, piece, hint):
    verdict = PIPE.judge(seen, (True, *NONE[1:]), -1)
    assert (verdict.piece, verdict.hint) == (piece, hint)


def test_the_next_place_is_ahead_in_the_middle_of_the_corridor():
    assert PIPE.judge(moment((-5.0, 0.0, 8.0)), NONE, -1) == (-1, (0.0, 0.0, 8.5), "go to where it begins")
    assert PIPE.judge(moment((1.0, 0.0, 8.5)), NONE, -1).goal == pytest.approx((4.0, 0.0, 8.5))
    assert PIPE.judge(moment((2.0, 3.0, 8.5)), (True, *NONE[1:]), -1).goal == pytest.approx((2.0, 0.0, 8.5))


@pytest.mark.parametrize(
    ("seen", "piece"),
    [
        (moment((1.6, 0.0, 8.8)), 10),
        (moment((0.5, 0.0, 8.8)), -1),  # too far away
        (moment((1.6, 0.0, 8.8), yaw=90.0), -1),  # looked elsewhere
        (moment((4.0, 0.0, 8.8)), -1),  # below the view
        (moment((4.0, 0.0, 8.8), pitch=-80.0), 10),
    ],
)
def test_a_finding_is_marked_in_view_and_from_near_by(seen, piece):
    assert PIPE.has_marks()
    assert PIPE.marked(seen, NONE) == piece


def test_a_mark_is_for_a_finding_that_has_none_yet():
    """Two in one view: once more marks the one behind, and not the first again."""
    behind = Finding(position_ned_m=(PIPE.findings["dent"].position_ned_m[0] + 0.5, 0.0, 10.0))
    pipe = structs.replace(PIPE, findings={**PIPE.findings, "crack": behind})
    seen, none = moment((1.6, 0.0, 8.8)), (False,) * len(pipe.names())
    first = pipe.marked(seen, none)
    second = pipe.marked(seen, tuple(k == first for k in range(len(none))))
    assert {pipe.names()[first], pipe.names()[second]} == {"dent", "crack"}
    assert pipe.names()[first] == "dent"
    assert pipe.marked(seen, tuple(k >= pipe.metres for k in range(len(none)))) == first


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"height_m": (2.0, 1.0)}, "2 m at least is not less than 1 m"),
        ({"for_s": 1.0}, "followed, not held: remove for_s"),
        ({"path_ned_m": ((0.0, 0.0, 0.0), (0.0, 0.0, 50.0))}, "horizontal length is 0.0 m; it has to be 1 to 2000 m"),
        ({"path_ned_m": ((0.0, 0.0, 0.0), (3000.0, 0.0, 0.0))}, "length is 3000.0 m"),
    ],
)
def test_what_cannot_be_followed_is_refused(keys, text):
    with pytest.raises(ValueError, match=text):
        Follow(**({"path_ned_m": ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0))} | keys))


# -- as the judge counts them -------------------------------------------------------------------------------------------------------------


class Hull:
    electrics: ClassVar = {}

    def touches(self):
        return []


class Judge:
    """A training whose vehicle is at a place at a time (s), with its bow to a heading (deg)."""

    def __init__(self, scope, **tasks):
        self.sensor = TrainingConfig(rate_hz=10, tasks=tasks, limit_s=1000.0, points_per_s_left=0.0).build(Pose())
        self.sensor.outlines = {"north": NORTH, "east": EAST}
        self._scope, self.names = scope, [field.name for field in Training.fields]
        self(0.0, (50.0, 50.0, 3.0))
        self(0.1, (51.0, 50.0, 3.0))  # it has begun

    def __call__(self, t, p, yaw=0.0, pitch=0.0, v=0.0, things=BALLS):
        q = quat_from_rpy(0.0, rad(pitch), rad(yaw))
        scope = self._scope(p_NB=p, q_NB=q, v_NB_B=(v, 0.0, 0.0), geometry=FakeGeometry(things))
        reading = self.sensor.sense(replace(scope, t_ns=round(t * S), wiring=Hull()))
        return dict(zip(self.names, reading.values, strict=True))


def test_each_is_looked_at_without_a_break_and_scores_its_part(scope):
    told = Judge(scope, look=TASK)
    first = told(1.0, (3.0, 0.0, 3.0))
    assert (first["found"], first["missing"], first["hold"], first["goal_p_NB"]) == ("", 2, 3.0, NORTH.p)
    assert told(3.9, (3.0, 0.0, 3.0))["held"] == pytest.approx(2.9)
    assert told(3.95, (3.0, 0.0, 3.0), v=0.5)["held"] == 0.0  # it moved: a break
    assert told(4.0, (3.0, 0.0, 3.0))["score"] == 0.0
    one = told(7.0, (3.0, 0.0, 3.0))
    assert (one["found"], one["missing"], one["part"], one["score"], one["state"]) == ("north", 1, 0.5, 40.0, "running")
    told(8.0, (0.0, 3.0, 3.0), yaw=90.0)
    both = told(11.0, (0.0, 3.0, 3.0), yaw=90.0)
    assert (both["found"], both["missing"], both["score"], both["state"]) == ("north, east", 0, 80.0, "done")


def test_one_that_is_hidden_never_counts(scope):
    told = Judge(scope, look=TASK)
    between = (*BALLS, Sphere((4.0, 0.0, 3.0), 0.4))
    for t in range(1, 20):
        assert told(t, (3.0, 0.0, 3.0), things=between)["hint"] == "it is hidden: go round"
    assert told(20.0, (3.0, 0.0, 3.0), things=between)["score"] == 0.0


def test_metres_left_out_cost_their_points(scope):
    told = Judge(scope, pipe=PIPE)
    for k in range(100):
        east = 0.0 if not 20 <= k < 40 else 2.0  # aside of the third and the fourth metre
        p = (0.1 * k, east, 8.8) if k < 60 else (6.0, 0.1 * (k - 60), 8.8 + 0.025 * (k - 60))
        last = told(1.0 + 0.2 * k, p, yaw=0.0 if k < 58 else 90.0, pitch=-20.0)
    assert (last["state"], last["part"], last["score"]) == ("done", pytest.approx(0.8), pytest.approx(80.0))


def test_marks_score_once_and_cost_where_nothing_is(scope):
    told = Judge(scope, pipe=PIPE)
    sensor = told.sensor
    told(1.0, (0.2, 0.0, 8.8))
    sensor.change({"mark": True})
    assert sensor.properties() == {"running": True, "mark": True}
    wrong = told(1.1, (0.2, 0.0, 8.8))  # 4 m from the dent
    assert (wrong["found"], wrong["lost"], wrong["score"]) == ("", 20.0, -10.0)
    assert sensor.properties()["mark"] is False
    sensor.change({"mark": True})
    right = told(1.2, (1.6, 0.0, 8.8))
    assert (right["found"], right["missing"], right["lost"], right["score"]) == ("dent", 0, 20.0, 40.0)
    sensor.change({"mark": True})
    assert told(1.3, (1.7, 0.0, 8.8))["score"] == 40.0  # once more: neither
    sensor.change({"running": True})
    anew = told(2.0, (1.7, 0.0, 8.8))
    assert (anew["found"], anew["lost"], anew["score"], anew["state"]) == ("", 0.0, 0.0, "ready")


def test_marks_before_the_begin_and_in_other_tasks_cost_nothing(scope):
    sensor = TrainingConfig(rate_hz=10, tasks={"pipe": PIPE}).build(Pose())
    sensor.change({"mark": True})
    assert sensor.sense(replace(scope(p_NB=(30.0, 0.0, 8.8)), wiring=Hull())).values[11] == 0.0
    told = Judge(scope, look=TASK)
    told.sensor.change({"mark": True})
    assert told(1.0, (3.0, 0.0, 3.0))["score"] == 0.0


def test_it_looks_from_its_mount_as_that_is_tilted(scope):
    class Servo:
        memory: ClassVar = type("Memory", (), {"tilt": 0.0})()

    mount = Pose((0.2, 0.0, 0.0), quat_from_rpy(0.0, 0.0, math.pi / 2))  # to starboard
    sensor = TrainingConfig(rate_hz=10, tasks={"look": TASK}).build(mount)
    sensor.outlines = {"east": EAST}
    sensor.joint = Servo()
    at = scope(p_NB=(-0.2, 4.0, 2.0), geometry=FakeGeometry(BALLS))  # 45 degrees above it
    hint = [field.name for field in Training.fields].index("hint")
    assert sensor.sense(at).values[hint] == "turn the camera to it"
    Servo.memory.tilt = -0.7
    assert sensor.sense(at).values[hint] == "keep looking"


@pytest.mark.parametrize(
    "task",
    [
        {"kind": "follow", "path_ned_m": [[0, 0, 0], [1e308, 0, 0], [0, 0, 0]]},
        {"kind": "follow", "path_ned_m": [[0, 0, 0], [9, 0, 0]], "height_m": [-1e308, 1e308]},
        {"kind": "follow", "path_ned_m": [[0, 0, 0], [9, 0, 0]], "wrong_mark_points": 1e308},
        {"kind": "reach", "points": 1.7e308},
    ],
)
def test_numbers_whose_sums_are_none_are_refused_by_their_keys(task):
    table = {"kind": "training", "rate_hz": 60, "tasks": {"a": task}}
    with pytest.raises(msgspec.ValidationError, match=rf"1000000.0 - at .*{list(task)[-1]}"):
        msgspec.convert(table, TrainingConfig)


def test_all_that_may_be_scored_and_lost_can_be_told_and_saved(scope):
    """Whoever marks at the highest price for hours, gets no state that cannot be loaded again."""
    pipe = Follow(
        path_ned_m=((0, 0, 5), (10, 0, 5)), wrong_mark_points=1e6, findings={"crack": Finding(position_ned_m=(9, 9, 9))}
    )
    told = Judge(scope, pipe=pipe)
    told.sensor.memory = structs.replace(told.sensor.memory, lost=1e12 - 1.0)
    told.sensor.change({"mark": True})
    last = told(1.0, (0.2, 0.0, 8.8))
    assert (last["lost"], last["score"]) == (1e12, -1e12)
    memory = told.sensor.memory
    assert msgspec.convert(msgspec.to_builtins(memory), type(memory)) == memory


def test_a_long_way_is_worked_out_once():
    """A judge that reads 60 times a second and more must not go through a thousand points in Python each time."""
    way = Follow(path_ned_m=tuple((1.9 * k, 0.1 * (k % 2), 5.0) for k in range(1000)))
    seen = moment((1000.0, 0.0, 4.0), yaw=180.0, pitch=-90.0)
    way.judge(seen, (False,) * len(way.worth()), -1)
    calls = 0

    def count(frame, event, argument):
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        way.judge(seen, (False,) * way.metres, -1)
    finally:
        sys.setprofile(None)
    assert calls < 1000
