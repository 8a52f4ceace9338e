"""What was posted is carried out in its order, with one reply each, whatever happens."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from uwserver.ports import Argument, Call, Command, Refused, Reply, Service
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.world.stepping.commands import Commands
from uwserver.world.stepping.requests import Requests


class Rig:
    """Requests of a world without actuators, at tick 5."""

    def __init__(self, **services: Any) -> None:
        self.now = [5, 50]
        self.known: dict[str, Service] = {}
        self.commands = Commands({}, Fraction(10), lambda *_: None)
        self.requests = Requests(self.commands, services, lambda: (self.now[0], self.now[1]), self.known.get)

    def run(self, *items: Command | Call) -> list[Reply]:
        output, heard = TickOutput(5, 50, []), list[Any]()
        self.requests.posted += [Posted(item, heard.append) for item in items]
        self.requests.carry_out(output)
        for on_reply, reply in output.replies:
            on_reply(reply)
        return heard


def fail(args: Any) -> None:
    raise ValueError("oops")


def refuse(args: Any) -> None:
    raise Refused("busy", "not now", "what")


def test_replies_come_in_order_and_name_the_tick() -> None:
    rig = Rig(twice=lambda args: 2 * args["x"])
    assert rig.run(Call("twice", {"x": 1}), Call("twice", {"x": 4})) == [Reply(5, 50, 2), Reply(5, 50, 8)]
    assert rig.run() == []


@pytest.mark.parametrize(
    ("item", "code", "where"),
    [
        (Call("gone", {}), "unknown_service", "gone"),
        (Call("refuse", {}), "busy", "what"),
        (Call("fail", {}), "internal", "fail"),
        (Command("rov/gone", ((1.0,),)), "unknown_port", "rov/gone"),
    ],
)
def test_what_cannot_be_done_is_answered_and_the_next_is_carried_out(item: Any, code: str, where: str) -> None:
    rig = Rig(fail=fail, refuse=refuse, ok=lambda _: "fine")
    bad, good = rig.run(item, Call("ok", {}))
    assert bad.fault is not None
    assert (bad.fault.code, bad.fault.where) == (code, where)
    assert good.result == "fine"


def test_one_that_is_answered_later_learns_whom_to_answer() -> None:
    answers: Any = []
    later = Later(answers)
    rig = Rig(goto=lambda _: later)
    assert rig.run(Call("goto", {})) == []
    later.finish(9, 90, "there")
    assert answers[0][1] == Reply(9, 90, "there")


def test_replies_after_a_jump_in_time_name_the_new_tick() -> None:
    rig = Rig(reset=lambda _: rig.now.__setitem__(slice(None), [0, 0]), tick=lambda _: rig.now[0])
    first, second = rig.run(Call("reset", {}), Call("tick", {}))
    assert (first.tick, second.tick, second.result) == (5, 0, 0)


def test_what_a_service_posts_waits_for_the_next_tick() -> None:
    rig = Rig(more=lambda _: rig.requests.posted.append(Posted(Call("more", {}), None)))
    rig.run(Call("more", {}))
    assert len(rig.requests.posted) == 1


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"x": 3.0}, ""),
        ({"x": None}, ""),
        ({"x": 9.0}, "at most 5"),
        ({"x": "far"}, "must be a number"),
        ({}, "takes other arguments than when this was sent"),
        ({"y": 1.0}, "takes other arguments than when this was sent"),
    ],
)
def test_a_call_that_was_checked_for_another_component_is_checked_again(args: Any, text: str) -> None:
    done = []
    rig = Rig(**{"rov/sonar/set": done.append})
    argument = Argument("x", "float", "reach", "m", required=False, maximum=5.0)
    rig.known["rov/sonar/set"] = Service("rov/sonar/set", "Change it.", (argument,))
    (reply,) = rig.run(Call("rov/sonar/set", args))
    assert (reply.fault.text if reply.fault else "").count(text)
    assert done == ([] if text else [args])
