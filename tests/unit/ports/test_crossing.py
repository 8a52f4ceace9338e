"""What crosses between simulation and outside: a tick's output starts empty, and a call that is answered later tells only who waits for it."""

from __future__ import annotations

from uwserver.ports import Fault, Progress, Reply
from uwserver.ports.crossing import Answers, Later, TickOutput


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
