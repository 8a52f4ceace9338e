"""Puts and gets on a context, without a session."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine
from itertools import pairwise
from typing import Any

import msgspec
import pytest
from uwserver_adapters.zenoh_bus.codec import PAYLOAD_LIMIT, Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.requests import AT_ONCE, Put, Question, Requests

from uwserver.adapter import UNANSWERED, turns
from uwserver.ports import Fault, Reply
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import DEPTH

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
        self.faults.append(json.loads(payload) if media == "application/json" else msgspec.msgpack.decode(payload))

    def end(self) -> None:
        self.ends += 1


class Desk:
    def __init__(self) -> None:
        self.context = FakeContext()
        self.keys = KeyScheme("uw", "s")
        self.told: list[tuple[str, Any]] = []
        self.looked: list[int] = []
        self.codec = Codec("json")
        codecs: Any = {"json": self.codec, "msgpack": Codec("msgpack")}
        self.requests = Requests(
            self.context, self.keys, codecs, "json", 0.05,
            lambda key, message: self.told.append((key, json.loads(self.codec.encode(message)))),
            lambda: self.looked.append(len(self.told)),
        )  # fmt: skip

    def put(self, path: str, payload: bytes = U, attachment: bytes | None = None, media: str = "") -> None:
        self.requests.take_put(Put(self.keys.of(path), payload, media, attachment))

    def ask(
        self,
        path: str,
        payload: bytes | None = None,
        attachment: bytes | None = None,
        media: str = "",
        **parameters: str,
    ) -> Answers:
        answers = Answers()
        key = self.keys.of(path)
        fits: Callable[[str], bool] = lambda other: other == key or "*" in key  # noqa: E731
        self.requests.take_question(Question(key, parameters, payload, media, attachment, answers, fits))
        return answers


def within_loop(test: Callable[[Desk], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(test(Desk()), 120)

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


def test_puts_that_wait_for_the_world_are_bounded():
    """All peers share one limit, with what they ask: a peer has no connection of its own by which it could be told apart."""

    async def test(desk: Desk) -> None:
        desk.context.held.add("rov/thrusters")
        for k in range(UNANSWERED):
            desk.put("rov/thrusters", attachment=b'{"client":"c%d"}' % (k % 3))
        assert desk.told == []
        desk.put("rov/thrusters")
        ((key, told),) = desk.told
        assert (key, told["code"]) == ("uw/s/@error/unnamed/rov/thrusters", "overload")
        assert (len(desk.context.commands), desk.context.stats.commands) == (UNANSWERED, UNANSWERED + 1)
        desk.context.calls[0].finish(Reply(1, 1))
        desk.put("rov/thrusters")
        assert len(desk.context.commands) == UNANSWERED + 1
        desk.context.calls[1].finish(Reply(1, 1, fault=Fault("denied", "held by the autopilot", "rov/thrusters")))
        assert (desk.told[1][0], desk.told[1][1]["code"]) == ("uw/s/@error/c1/rov/thrusters", "denied")

    within_loop(test)


LARGE = b'{"u":"' + b"x" * PAYLOAD_LIMIT + b'"}'
BAD_INPUT: list[tuple[str, dict[str, Any], str]] = [
    ("rov/thrusters", {"payload": b"\xff\xfe{"}, "parse_error"),
    ("rov/thrusters", {"payload": b'{"u":[0,0,0'}, "parse_error"),
    ("rov/thrusters", {"payload": b"[1,2]"}, "invalid_request"),
    ("rov/thrusters", {"payload": b'{"u":' + b"[" * 40 + b"]" * 40 + b"}"}, "invalid_request"),
    ("rov/thrusters", {"payload": U, "media": "application/msgpack"}, "invalid_request"),
    ("rov/thrusters", {"payload": U, "media": "image/png"}, "bad_argument"),
    ("rov/thrusters", {"payload": U, "media": "application/cdr"}, "bad_argument"),
    ("rov/thrusters", {"payload": LARGE}, "too_large"),
    ("rov/thrusters", {"payload": U, "attachment": bytes(33)}, "invalid_request"),  # as rmw_zenoh sends it
    ("rov/thrusters", {"payload": U, "attachment": b'{"client":5}'}, "bad_argument"),
    ("rov/thrusters", {"payload": U, "attachment": b'{"client":"a/b"}'}, "bad_argument"),
    ("rov/thrusters", {"payload": U, "attachment": b"{" + b" " * 2000 + b"}"}, "too_large"),
    ("rov/thrusters", {"payload": b'{"v":[0]}'}, "bad_argument"),
    ("rov/thrusters", {"payload": b'{"u":[0]}'}, "bad_shape"),
    ("rov/thrusters", {"payload": b'{"u":[9,0,0,0,0,0,0,0]}'}, "out_of_range"),
    ("rov/imu", {"payload": U}, "bad_argument"),
]


@pytest.mark.parametrize(("path", "sent", "code"), BAD_INPUT)
@pytest.mark.parametrize("way", ["put", "get"])
def test_bad_input_is_refused_with_its_reason_logged_once_and_disturbs_nothing(way, path, sent, code, caplog):
    async def test(desk: Desk) -> None:
        faults = []
        for _ in range(3):
            if way == "put":
                desk.put(path, **sent)
                faults.append(desk.told[-1][1])
            else:
                faults += desk.ask(path, **sent).faults
        assert [fault["code"] for fault in faults] == [code] * 3
        assert all(20 < len(fault["message"]) < 1000 for fault in faults), "a reason, and no echo of a megabyte"
        assert len(caplog.records) == 1
        assert desk.context.stats.errors == 3
        assert desk.context.commands == []
        desk.put("rov/thrusters", attachment=b"")
        assert len(desk.context.commands) == 1, "and without an attachment a command is taken"

    within_loop(test)


def test_keys_that_do_not_exist_are_one_cause_however_many(caplog):
    async def test(desk: Desk) -> None:
        for number in range(1000):
            desk.put(f"rov/nothing{number}")
            assert desk.told[-1][1]["code"] == "unknown_port"
            assert desk.ask(f"rov/nothing{number}", U).faults[0]["code"] == "unknown_service"
        assert len(caplog.records) == 2
        desk.put("rov/thrusters", b"{")
        assert len(caplog.records) == 3

    within_loop(test)


@pytest.mark.parametrize(
    ("payload", "media", "dropped"),
    [
        (b'{"samples":5}', "", 5),
        (b"\x81\xa7samples\x05", "application/msgpack", 5),
        (b'{"samples":-5}', "", 0),
        (b'{"samples":true}', "", 0),
        (b'{"samples":1e3}', "", 0),
        (b'{"samples":4294967296}', "", 0),
        (b"{", "", 0),
        (b'{"samples":5}', "image/png", 0),
    ],
)
def test_losses_that_clients_report_are_counted_and_nonsense_is_not(payload, media, dropped, caplog):
    async def test(desk: Desk) -> None:
        for _ in range(2):
            desk.requests.take_loss(Put("uw/s/@lost/c1", payload, media, None))
        assert desk.context.stats.dropped == 2 * dropped
        assert desk.context.stats.errors == (0 if dropped else 2)
        assert len(caplog.records) == (0 if dropped else 1)

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
        wild = desk.ask("rov/*")
        while not wild.ends:
            await asyncio.sleep(0)
        assert [key for key, _ in wild.replies] == ["uw/s/rov/imu", "uw/s/rov/depth"]
        one = desk.ask("rov/depth")
        while not one.ends:
            await asyncio.sleep(0)
        assert [key for key, _ in one.replies] == ["uw/s/rov/depth"]
        assert desk.ask("@describe", pattern="rov/imu").replies[0][1]["ports"][0]["path"] == "rov/imu"

    within_loop(test)


def test_last_values_of_many_ports_are_answered_in_pieces(monkeypatch):
    """Those of 600 ports took 3 ms of the loop in one piece."""
    monkeypatch.setattr(turns, "TURN_S", 0.0)
    monkeypatch.setattr(turns, "REST_S", 0.0)

    async def test(desk: Desk) -> None:
        ports = {f"v{n}/depth": msgspec.structs.replace(DEPTH, path=f"v{n}/depth") for n in range(200)}
        context = desk.context = FakeContext(ports=ports)
        codecs: Any = {"json": desk.codec}
        desk.requests = Requests(context, desk.keys, codecs, "json", 1.0, lambda *_: None, lambda: None)
        answers = desk.ask("**")
        seen = [len(answers.replies)]
        while not answers.ends:
            await asyncio.sleep(0)
            seen.append(len(answers.replies))
        assert len(answers.replies) == 200
        assert max(after - before for before, after in pairwise(seen)) <= AT_ONCE
        assert answers.ends == 1

    within_loop(test)


def test_questions_that_wait_at_the_end_are_left():
    async def test(desk: Desk) -> None:
        answers = desk.ask("**")
        desk.requests.close()
        await asyncio.sleep(0.01)
        assert answers.replies == []

    within_loop(test)


@pytest.mark.parametrize("asked", ["@describe", "rov/imu", "**"])
def test_who_subscribes_is_known_before_a_question_is_answered(asked):
    async def test(desk: Desk) -> None:
        desk.ask(asked)
        assert desk.looked

    within_loop(test)


def test_a_fault_of_ours_is_told(caplog):
    async def test(desk: Desk) -> None:
        desk.context.scripts["world/status"] = lambda _: 1 / 0
        answers = desk.ask("world/status")
        assert [fault["code"] for fault in answers.faults] == ["internal"]
        assert answers.ends == 1
        assert desk.requests._in_flight.count == 0

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
        assert desk.requests._in_flight.count == 1

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
def test_wrong_hellos(payload, code, caplog):
    async def test(desk: Desk) -> None:
        for _ in range(3):
            assert [fault["code"] for fault in desk.ask("@hello", payload).faults] == [code]
        assert desk.context.joined == []
        assert len(caplog.records) == 1
        assert "@hello" in caplog.text

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
