"""Each method of the native protocol: its answer, and every way to be refused."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from uwserver_adapters.native.session import SUBSCRIPTIONS

from uwserver.adapter import UNANSWERED
from uwserver.ports import Event, Refused, Reply

Stage = Callable[..., Any]


@pytest.fixture(params=["json", "msgpack"])
def encoding(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_hello(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.talker(encoding).send({"method": "ping"})
        talker = theatre.talker(encoding)
        result = await talker.result("hello", {"version": 1, "name": "pilot"})
        assert result == {
            "version": 1,
            "server": "uwserver test",
            "scenario": "fake",
            "session": 2,
            "encoding": encoding,
        }
        assert theatre.context.joined == ["pilot"]
        assert await talker.fault("hello", {"version": 1}) == (
            "invalid_request",
            '"hello" was said before: once is enough',
        )
        talker.transport.die()
        await asyncio.sleep(0)
        assert theatre.context.joined == []

    asyncio.run(scene())


def test_hello_without_a_name_takes_no_part_in_the_barrier(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        await theatre.talker().result("hello", {"version": 1})
        assert theatre.context.joined == []

    asyncio.run(scene())


def test_wrong_version_is_told_and_ends(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        talker = stage().talker(encoding)
        code, text = await talker.fault("hello", {"version": 2})
        assert code == "version"
        assert "version 1" in text
        assert talker.transport.eof_written

    asyncio.run(scene())


def test_describe(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        talker = stage().talker(encoding)
        everything = await talker.result("describe")
        assert [port["path"] for port in everything["ports"]] == ["rov/imu", "rov/depth", "rov/thrusters"]
        field = everything["ports"][0]["fields"][0]
        assert (field["name"], field["unit"], field["frame"], field["shape"]) == ("f_S", "m/s^2", "S", [3])
        some = await talker.result("describe", {"pattern": "rov/imu"})
        assert [port["path"] for port in some["ports"]] == ["rov/imu"]
        assert some["services"] == []

    asyncio.run(scene())


def test_subscribe_and_unsubscribe(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker(encoding)
        assert await talker.result("subscribe", {"pattern": "rov/imu"}) == {"subscription": 1, "ports": ["rov/imu"]}
        assert await talker.result("subscribe", {"pattern": "**", "fields": ["depth"]}) == {
            "subscription": 2,
            "ports": ["rov/depth"],
        }
        assert await talker.result("subscribe", {"pattern": "later/*", "rate_hz": 1, "delivery": "latest"}) == {
            "subscription": 3,
            "ports": [],
        }
        theatre.context.emit()
        imu, depth = talker.samples()
        assert imu == {
            "port": "rov/imu", "seq": 0, "t_ns": 4_000_000, "t_sent_ns": 4_000_000, "valid": True,
            "value": {"f_S": [0.0, 1.0, 2.0], "w_S": [100.0, 101.0, 102.0], "temperature": 200.0},
        }  # fmt: skip
        assert depth["value"] == {"depth": 0.0}
        assert await talker.result("unsubscribe", {"subscription": 1}) == {"removed": 1}
        assert await talker.result("unsubscribe", {"subscription": 1}) == {"removed": 0}
        assert await talker.result("unsubscribe", {"pattern": "**"}) == {"removed": 1}
        theatre.context.emit()
        assert talker.samples() == []

    asyncio.run(scene())


def test_command(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker(encoding)
        theatre.context.emit()
        ack = await talker.result("command", {"port": "rov/thrusters", "value": {"u": [0.5] * 8}})
        assert ack == {"tick": 1, "t_ns": 4_000_000, "conflict": False}
        await talker.result("hello", {"version": 1, "name": "pilot"})
        await talker.result("command", {"port": "rov/thrusters", "value": {"u": [0] * 8}})
        assert [command.source for command in theatre.context.commands] == ["1", "1 (pilot)"]
        assert theatre.context.commands[0].value == ((0.5,) * 8,)
        assert theatre.context.stats.commands == 2

    asyncio.run(scene())


def test_a_fault_found_later_is_told(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.context.held.add("rov/thrusters")
        talker = theatre.talker()
        for identity in ({"id": 7}, {}):
            talker.send({"method": "command", "params": {"port": "rov/thrusters", "value": {"u": [0] * 8}}} | identity)
        assert talker.heard() == []
        for call in theatre.context.calls:
            call.finish(Reply(1, 4, fault=Refused("denied", "deactivated", "rov/thrusters").fault))
        await asyncio.sleep(0)
        assert [(m["id"], m["error"]["data"]["code"]) for m in talker.heard()] == [(7, "denied"), (None, "denied")]

    asyncio.run(scene())


@pytest.mark.parametrize("value", [0, False, [], None, "", {}, 0.0, "text", [1, [2, {"a": None}]]])
def test_results_arrive_as_themselves(stage: Stage, encoding: str, value: object) -> None:
    async def scene() -> None:
        talker = stage().talker(encoding)
        result = await talker.result("call", {"service": "world/echo", "args": {"value": value}})
        assert result == {"tick": 0, "t_ns": 0, "value": value}
        assert type(result["value"]) is type(value)
        assert await talker.result("ping", value) == value

    asyncio.run(scene())


def test_step(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker(encoding)
        assert await talker.result("step") == {"tick": 0, "t_ns": 0}
        assert await talker.result("step", {"n": 5}) == {"tick": 0, "t_ns": 0}
        assert [(call.service, call.args) for call in theatre.context.calls] == [
            ("world/step", {"n": 1}),
            ("world/step", {"n": 5}),
        ]
        assert (await talker.fault("step", {"n": 0}))[0] == "out_of_range"

    asyncio.run(scene())


def test_progress_goes_to_the_caller_alone(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.context.held.add("world/run_until")
        talker, other = theatre.talker(encoding), theatre.talker(encoding)
        talker.send({"id": "a", "method": "call", "params": {"service": "world/run_until", "args": {"t_s": 5}}})
        talker.send({"method": "call", "params": {"service": "world/run_until", "args": {"t_s": 6}}})
        for call in theatre.context.calls:
            call.progress(0.25, 9)
            call.finish(Reply(3, 12, "done"))
        await asyncio.sleep(0)
        progress, reply = talker.heard()  # the notification gets neither
        assert (progress["method"], progress["params"]) == ("progress", {"id": "a", "fraction": 0.25, "t_ns": 9})
        assert (reply["id"], reply["result"]) == ("a", {"tick": 3, "t_ns": 12, "value": "done"})
        assert other.heard() == []

    asyncio.run(scene())


def test_cancel(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.context.held |= {"world/run_until", "world/step"}
        talker, other = theatre.talker(encoding), theatre.talker(encoding)
        talker.send({"id": "a", "method": "call", "params": {"service": "world/run_until", "args": {"t_s": 5}}})
        talker.send({"id": 1000, "method": "step"})
        assert (await other.fault("cancel", {"id": "a"}))[0] == "bad_argument", "it is not its own"
        talker.send({"id": 1000, "method": "step"})
        (twice,) = talker.heard()
        assert twice["error"]["data"]["code"] == "invalid_request"
        for identity in ("a", 1000):
            talker.send({"id": "c", "method": "cancel", "params": {"id": identity}})
            preempted, cancelled = talker.heard()
            assert (preempted["id"], preempted["error"]["data"]["code"]) == (identity, "preempted")
            assert cancelled["result"] == {"cancelled": True}
        assert (await talker.fault("cancel", {"id": "a"}))[0] == "bad_argument", "it is over"

    asyncio.run(scene())


def test_a_client_that_leaves_ends_its_long_calls_alone(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.context.held |= {"world/run_until", "world/pause"}
        talker = theatre.talker()
        talker.send({"method": "call", "params": {"service": "world/run_until", "args": {"t_s": 5}}})
        talker.send({"id": 2, "method": "call", "params": {"service": "world/pause"}})
        talker.transport.die()
        await asyncio.sleep(0)
        run_until, pause = theatre.context.calls
        assert run_until.is_done
        assert not pause.is_done
        pause.finish(Reply(1, 1))  # nobody is there: no error

    asyncio.run(scene())


def test_notifications_get_no_reply_but_their_faults(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker(encoding)
        talker.send({"method": "subscribe", "params": {"pattern": "rov/imu"}})
        talker.send({"method": "command", "params": {"port": "rov/thrusters", "value": {"u": [0] * 8}}})
        await asyncio.sleep(0)
        assert talker.heard() == []
        assert len(theatre.context.commands) == 1
        talker.send({"method": "subscribe", "params": {"pattern": "rov/nothing"}})
        (fault,) = talker.heard()
        assert fault["id"] is None
        assert fault["error"]["data"] == {"code": "unknown_port", "where": "rov/nothing"}

    asyncio.run(scene())


@pytest.mark.parametrize("shown", [{}, {"token": None}, {"token": ["sesame"]}, {"token": "sesam"}, {"token": ""}])
def test_who_does_not_show_the_token_is_not_let_in(stage: Stage, shown: dict[str, object]) -> None:
    async def scene() -> None:
        stranger, friend = (stage(token="sesame").talker() for _ in range(2))
        stranger.send({"id": 1, "method": "hello", "params": {"version": 1, **shown}})
        (answer,) = stranger.heard()
        assert answer["error"]["data"] == {"code": "denied", "where": "token"}
        assert stranger.transport.eof_written
        friend.send({"id": 1, "method": "hello", "params": {"version": 1, "token": "sesame"}})
        assert "result" in friend.heard()[0]

    asyncio.run(scene())


REFUSALS: list[tuple[str, object, str, str]] = [
    ("pong", None, "unknown_method", 'did you mean "ping"?'),
    ("hello", None, "bad_argument", 'needs "version": 1'),
    ("hello", {"version": 1, "name": ""}, "bad_argument", '"name"'),
    ("hello", {"version": 1, "tokn": "x"}, "bad_argument", 'did you mean "token"?'),
    ("describe", [1], "bad_argument", '"params" of "describe" must be a map'),
    ("describe", {"pattern": 5}, "bad_argument", '"pattern"'),
    ("describe", {"pattern": "**/" * 200}, "bad_argument", "256 characters"),
    ("subscribe", None, "bad_argument", '"pattern"'),
    ("subscribe", {"pattern": "rov/imo"}, "unknown_port", 'did you mean "rov/imu"?'),
    ("subscribe", {"pattern": "rov/thrusters"}, "bad_argument", "is an actuator"),
    ("subscribe", {"pattern": "**", "rate": 5}, "bad_argument", 'did you mean "rate_hz"?'),
    ("subscribe", {"pattern": "**", "rate_hz": 0}, "bad_argument", "above zero"),
    ("subscribe", {"pattern": "**", "rate_hz": True}, "bad_argument", "above zero"),
    ("subscribe", {"pattern": "**", "rate_hz": "5"}, "bad_argument", "above zero"),
    ("subscribe", {"pattern": "**", "fields": "depth"}, "bad_argument", "a list of texts"),
    ("subscribe", {"pattern": "**", "fields": []}, "bad_argument", "a list of texts"),
    ("subscribe", {"pattern": "**", "fields": [1]}, "bad_argument", "a list of texts"),
    ("subscribe", {"pattern": "**", "fields": ["dept"]}, "bad_argument", 'did you mean "depth"?'),
    ("subscribe", {"pattern": "**", "delivery": "fast"}, "bad_argument", "latest, ring, reliable"),
    ("subscribe", {"pattern": "**", "delivery": {}}, "bad_argument", "latest, ring, reliable"),
    ("unsubscribe", None, "bad_argument", 'either "subscription" or "pattern"'),
    ("unsubscribe", {"pattern": "**", "subscription": 1}, "bad_argument", "either"),
    ("unsubscribe", {"subscription": "1"}, "bad_argument", "must be the number"),
    ("unsubscribe", {"subscription": True}, "bad_argument", "must be the number"),
    ("command", {"port": "rov/thrusters"}, "bad_argument", '"value" must be a map'),
    ("command", {"port": "rov/thruster", "value": {}}, "unknown_port", 'did you mean "rov/thrusters"?'),
    ("command", {"port": "rov/imu", "value": {"x": 1}}, "bad_argument", "is a sensor"),
    ("command", {"port": "rov/thrusters", "value": {"u": [0.0] * 7}}, "bad_shape", "list of 8"),
    ("command", {"port": "rov/thrusters", "value": {"u": [2.0] * 8}}, "out_of_range", "at most 1"),
    ("command", {"port": "rov/thrusters", "value": {"v": 1}}, "bad_argument", 'no field "v"'),
    ("command", {"port": "x" * 300, "value": {"u": 1}}, "bad_argument", "256 characters"),
    ("call", {"service": "world/stop"}, "unknown_service", "world/stop"),
    ("call", {"service": "world/echo", "args": [1]}, "bad_argument", '"args" must be a map'),
    ("call", {"service": "world/run_until"}, "bad_argument", 'needs "t_s"'),
    ("call", {"service": "world/run_until", "args": {"t_s": "x"}}, "bad_shape", "must be a number"),
    ("step", {"m": 1}, "bad_argument", "it takes: n"),
    ("step", {"n": 1.5}, "bad_argument", "whole number"),
    ("cancel", {"id": True}, "bad_argument", "unfinished call or step"),
    ("cancel", {"id": [1]}, "bad_argument", "unfinished call or step"),
    ("cancel", None, "bad_argument", "unfinished call or step"),
]


@pytest.mark.parametrize(("method", "params", "code", "phrase"), REFUSALS)
def test_refusals_say_what_is_wrong_and_change_nothing(
    stage: Stage, encoding: str, method: str, params: object, code: str, phrase: str
) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker(encoding)
        found, text = await talker.fault(method, params)
        assert (found, phrase in text) == (code, True), text
        assert theatre.context.commands == []
        assert theatre.adapter.service.fanout._ports == {}
        assert await talker.result("ping", 1) == 1

    asyncio.run(scene())


def test_rates_that_json_cannot_say(stage: Stage) -> None:
    async def scene() -> None:
        talker = stage().talker("msgpack")
        for rate in (float("nan"), float("inf"), -1.0):
            assert (await talker.fault("subscribe", {"pattern": "**", "rate_hz": rate}))[0] == "bad_argument"
        lines = stage().talker()
        assert (await lines.fault("subscribe", {"pattern": "**", "rate_hz": 10**399}))[0] == "bad_argument"

    asyncio.run(scene())


def test_a_fault_of_ours_is_told_and_logged(stage: Stage, encoding: str, caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        theatre = stage()

        def broken(args: object) -> None:
            raise RuntimeError("our own fault")

        theatre.context.scripts["world/status"] = broken
        talker = theatre.talker(encoding)
        assert (await talker.fault("call", {"service": "world/status"}))[0] == "internal"
        theatre.context.scripts["world/status"] = lambda args: object()
        assert (await talker.fault("call", {"service": "world/status"}))[0] == "internal"
        assert await talker.result("ping", 5) == 5
        assert talker.connection._session.conversation.in_flight.count == 0

    asyncio.run(scene())
    assert "our own fault" in caplog.text


def test_unanswered_requests_and_subscriptions_are_bounded(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        theatre.context.held.add("rov/thrusters")
        talker = theatre.talker()
        for _ in range(UNANSWERED):
            talker.send({"method": "command", "params": {"port": "rov/thrusters", "value": {"u": [0] * 8}}})
        assert (await talker.fault("command", {"port": "rov/thrusters", "value": {"u": [0] * 8}}))[0] == "overload"
        for call in theatre.context.calls:
            call.finish(Reply(0, 0))
        for _ in range(SUBSCRIPTIONS):
            await talker.result("subscribe", {"pattern": "**"})
        assert (await talker.fault("subscribe", {"pattern": "**"}))[0] == "overload"

    asyncio.run(scene())


def test_events_reach_every_client(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        talkers = [theatre.talker("json"), theatre.talker("msgpack")]
        silent = theatre.talker()
        for talker in talkers:
            await talker.result("ping")
        theatre.context.say(Event("paused", 5, 20, "by the test"))
        for talker in talkers:
            (message,) = talker.heard()
            assert (message["method"], message["params"]) == (
                "event",
                {"event": "paused", "tick": 5, "t_ns": 20, "text": "by the test"},
            )
        assert silent.heard() == [], "its encoding is not known yet"

    asyncio.run(scene())
