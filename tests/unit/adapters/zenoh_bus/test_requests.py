"""Puts and gets on a context, without a session."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from uwserver_adapters.zenoh_bus.codec import Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.requests import UNANSWERED, Put, Question, Requests

from uwserver.ports import Reply
from uwserver.testing import FakeContext

U = b'{"u":[0,0,0,0,0,0,0,0.5]}'


class Answers:
    """What one question got."""

    def __init__(self) -> None:
        self.replies: list[tuple[str, Any]] = []
        self.faults: list[Any] = []
        self.ends = 0

    def reply(self, key: str, payload: bytes, media: str, attachment: bytes | None = None) -> None:
        assert media == "application/json"
        self.replies.append((key, json.loads(payload)))

    def refuse(self, payload: bytes, media: str) -> None:
        self.faults.append(json.loads(payload))

    def end(self) -> None:
        self.ends += 1


class Desk:
    def __init__(self) -> None:
        self.context = FakeContext()
        self.keys = KeyScheme("uw", "s")
        self.told: list[tuple[str, Any]] = []
        self.codec = Codec("json")
        codecs: Any = {"json": self.codec, "msgpack": Codec("msgpack")}
        self.requests = Requests(
            self.context, self.keys, codecs, "json", 0.05,
            lambda key, message: self.told.append((key, json.loads(self.codec.encode(message)))),
        )  # fmt: skip

    def put(self, path: str, payload: bytes = U, attachment: bytes | None = None, media: str = "") -> None:
        self.requests.take_put(Put(self.keys.of(path), payload, media, attachment))

    def ask(
        self, path: str, payload: bytes | None = None, attachment: bytes | None = None, **parameters: str
    ) -> Answers:
        answers = Answers()
        key = self.keys.of(path)
        fits: Callable[[str], bool] = lambda other: other == key or "*" in key  # noqa: E731
        self.requests.take_question(Question(key, parameters, payload, "", attachment, answers, fits))
        return answers


def within_loop(test: Callable[[Desk], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(test(Desk()), 10)

    asyncio.run(bounded())


def test_a_put_is_a_command():
    async def test(desk: Desk) -> None:
        desk.put("rov/thrusters", attachment=b'{"client":"pilot"}')
        (command,) = desk.context.commands
        assert (command.port, command.source) == ("rov/thrusters", "pilot")
        assert command.value == ((0, 0, 0, 0, 0, 0, 0, 0.5),)

    within_loop(test)


@pytest.mark.parametrize(
    ("path", "payload", "code", "where"),
    [
        ("rov/thruster", U, "unknown_port", "unknown"),
        ("rov/imu", U, "bad_argument", "rov/imu"),
        ("rov/thrusters", b"{", "parse_error", "rov/thrusters"),
        ("rov/thrusters", b'{"u":[2,0,0,0,0,0,0,0]}', "out_of_range", "rov/thrusters"),
    ],
)
def test_a_refused_put_is_told_and_logged_once(path, payload, code, where, caplog):
    async def test(desk: Desk) -> None:
        for _ in range(3):
            desk.put(path, payload)
        assert [key for key, _ in desk.told] == [f"uw/s/@error/unnamed/{where}"] * 3
        assert {told["code"] for _, told in desk.told} == {code}
        assert desk.context.stats.errors == 3
        assert len(caplog.records) == 1

    within_loop(test)


def test_answers_of_services_and_ports():
    async def test(desk: Desk) -> None:
        for value in (0, False, [], None, {"a": 1}):
            answers = desk.ask("world/echo", json.dumps({"value": value}).encode())
            await asyncio.sleep(0)
            assert [reply["value"] for _, reply in answers.replies] == [value]
            assert answers.ends == 1
        command = desk.ask("rov/thrusters", U)
        await asyncio.sleep(0)
        assert command.replies == [("uw/s/rov/thrusters", {"tick": 0, "t_ns": 0, "conflict": False})]
        assert [key for key, _ in desk.ask("rov/*").replies] == ["uw/s/rov/imu", "uw/s/rov/depth"]
        assert [key for key, _ in desk.ask("rov/depth").replies] == ["uw/s/rov/depth"]
        assert desk.ask("@describe", pattern="rov/imu").replies[0][1]["ports"][0]["path"] == "rov/imu"

    within_loop(test)


def test_a_fault_of_ours_is_told(caplog):
    async def test(desk: Desk) -> None:
        desk.context.scripts["world/status"] = lambda _: 1 / 0
        answers = desk.ask("world/status")
        assert [fault["code"] for fault in answers.faults] == ["internal"]
        assert answers.ends == 1
        assert desk.requests._unanswered == 0

    within_loop(test)


def test_the_call_of_an_unnamed_caller_ends_with_its_time():
    async def test(desk: Desk) -> None:
        desk.context.held.add("world/run_until")
        answers = desk.ask("world/run_until", b'{"t_s":5}')
        assert answers.ends == 0
        await asyncio.sleep(0.2)
        assert [fault["code"] for fault in answers.faults] == ["timeout"]
        longer = desk.ask("world/run_until", b'{"t_s":5}', timeout_s="60")
        await asyncio.sleep(0.2)
        assert longer.ends == 0
        assert desk.ask("world/run_until", b'{"t_s":5}', timeout_s="-1").faults[0]["where"] == "timeout_s"
        assert desk.requests._unanswered == 1

    within_loop(test)


def test_a_named_client_cancels_hears_progress_and_leaves():
    async def test(desk: Desk) -> None:
        desk.context.held.add("world/run_until")
        hello = desk.ask("@hello", b'{"version":1,"client":"c1","name":"pilot"}')
        assert hello.replies[0][1]["encoding"] == "json"
        assert desk.context.joined == ["pilot"]
        first = desk.ask("world/run_until", b'{"t_s":5}', b'{"client":"c1","id":1}')
        second = desk.ask("world/run_until", b'{"t_s":5}', b'{"client":"c1","id":2}')
        desk.context.calls[0].progress(0.5)
        assert desk.told == [("uw/s/@progress/c1/1", {"id": 1, "fraction": 0.5, "t_ns": 0})]
        await asyncio.sleep(0.2)
        assert first.ends == second.ends == 0, "its token guards it, no time limit does"
        assert desk.ask("@cancel", attachment=b'{"client":"c1","id":1}').replies[0][1] == {"cancelled": True}
        assert desk.ask("@cancel", attachment=b'{"client":"c1","id":9}').replies[0][1] == {"cancelled": False}
        assert [fault["code"] for fault in first.faults] == ["preempted"]
        desk.requests.client_left("c1")
        assert desk.context.joined == []
        assert [fault["code"] for fault in second.faults] == ["preempted"]
        desk.requests.client_left("c1")

    within_loop(test)


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b'{"version":2,"client":"c1"}', "version"),
        (b"{}", "bad_argument"),
        (b'{"client":"a/b"}', "bad_argument"),
        (b'{"client":"c1","name":5}', "bad_argument"),
    ],
)
def test_wrong_hellos(payload, code):
    async def test(desk: Desk) -> None:
        assert [fault["code"] for fault in desk.ask("@hello", payload).faults] == [code]
        assert desk.context.joined == []

    within_loop(test)


def test_too_many_unanswered():
    async def test(desk: Desk) -> None:
        desk.context.held.add("rov/thrusters")
        for _ in range(UNANSWERED):
            desk.ask("rov/thrusters", U)
        assert [fault["code"] for fault in desk.ask("rov/thrusters", U).faults] == ["overload"]
        for call in desk.context.calls:
            call.finish(Reply(1, 4))
        await asyncio.sleep(0)
        desk.context.held.clear()
        again = desk.ask("rov/thrusters", U)
        await asyncio.sleep(0)
        assert again.replies

    within_loop(test)
