"""What crosses between simulation and outside: outputs of ticks, answers that come later, and what a stop withdraws."""

from __future__ import annotations

import pytest

from uwserver.ports import Call, Command, Fault, Progress, Reply
from uwserver.ports.crossing import Answers, Later, TickOutput, is_stop, is_withdrawn


def test_outputs_of_two_ticks_share_nothing():
    one, other = TickOutput(1, 4, []), TickOutput(2, 8, [])
    one.replies.append((print, Reply(1, 4)))
    assert (other.replies, other.events) == ([], [])


def test_answers_go_to_who_asked_in_their_order():
    answers: Answers = []
    later = Later(answers)
    later.on_reply = print
    later.progress(0.5, 100)
    later.finish(7, 200, {"reached": True})
    assert answers == [(print, Progress(0.5, 100)), (print, Reply(7, 200, {"reached": True}))]


def test_a_call_that_failed_says_why():
    answers: Answers = []
    later = Later(answers)
    later.on_reply = print
    fault = Fault("preempted", "another goto", "rov/autopilot/goto")
    later.finish(7, 200, fault=fault)
    assert answers == [(print, Reply(7, 200, fault=fault))]


def test_nobody_is_told_where_nobody_waits():
    answers: Answers = []
    later = Later(answers)
    later.progress(0.5, 100)
    later.finish(7, 200)
    assert answers == []


@pytest.mark.parametrize(
    ("service", "expected"),
    [
        ("rov/autopilot/disarm", True), ("rov/thrusters/deactivate", True), ("world/pause", True),
        ("rov/autopilot/arm", False), ("world/resume", False), ("rov/pause", False), ("", False),
    ],
)  # fmt: skip
def test_which_services_stop(service: str, expected: bool) -> None:
    assert is_stop(service) is expected


@pytest.mark.parametrize(
    ("item", "by_disarm", "by_deactivate"),
    [
        (Command("rov/thrusters", (), "a"), True, True),
        (Command("rov/lights", (), "a"), True, False),
        (Command("rov/autopilot/depth", (), "a"), True, False),
        (Command("rover/thrusters", (), "a"), False, False),
        (Call("rov/autopilot/arm", {}, "a"), True, False),
        (Call("rov/thrusters/activate", {}, "a"), False, True),
        (Call("rov/autopilot/set_mission", {}, "a"), False, False),
        (Call("rov/autopilot/disarm", {}, "a"), False, False),
        (Call("world/reset", {}, "a"), False, False),
    ],
)
def test_what_a_stop_withdraws(item: Command | Call, by_disarm: bool, by_deactivate: bool) -> None:
    assert is_withdrawn(item, "rov/autopilot/disarm") is by_disarm
    assert is_withdrawn(item, "rov/thrusters/deactivate") is by_deactivate
