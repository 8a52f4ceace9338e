"""What a peer may do to its connection: in memory, with a peer that reads only when it wants. Also of uwserver.testing.loopback."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest
from uwserver_adapters.native.codec import FRAME_LIMIT, LINE_LIMIT
from uwserver_adapters.native.outbox import REPLIES
from uwserver_adapters.sockets.connection import TRIES

from uwserver.adapter import LOCKOUT_S, STRANGER_LIMIT, WRONG_TOKENS, connection, peers
from uwserver.ports import Event
from uwserver.testing import sample_of
from uwserver.testing.fake_context import DEPTH, IMU

Stage = Callable[..., Any]
PING = {"id": 1, "method": "ping"}


@pytest.fixture(autouse=True)
def _short_linger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "LINGER_S", 0.02)


async def turns(count: int = 5) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def until(condition: Callable[[], object]) -> None:
    end = asyncio.get_running_loop().time() + 60.0
    while not condition():
        assert asyncio.get_running_loop().time() < end
        await asyncio.sleep(0.002)
    await turns()  # in which the end of a connection is told


def last_error(talker: Any) -> tuple[str, str]:
    error = talker.heard()[-1]["error"]
    return error["data"]["code"], error["message"]


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("size", [1, 3, 1000])
def test_requests_in_pieces(stage: Stage, pack: Any, encoding: str, size: int) -> None:
    async def scene() -> None:
        talker = stage().talker(encoding)
        data = b"".join(pack({"id": number, "method": "ping", "params": number}, encoding) for number in range(20))
        for start in range(0, len(data), size):
            talker.transport.feed(data[start : start + size])
        await turns()
        assert [(message["id"], message["result"]) for message in talker.heard()] == [(n, n) for n in range(20)]

    asyncio.run(scene())


def test_replies_of_one_piece_are_one_write(stage: Stage, pack: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TURN_S", 1000.0)

    async def scene() -> None:
        talker = stage().talker()
        talker.send(PING)
        writes: list[bytes] = []
        talker.transport.write = writes.append
        talker.transport.feed(pack(PING) * 20)
        assert [data.count(b"\n") for data in writes] == [20]

    asyncio.run(scene())


def test_late_replies_of_one_turn_are_one_write(stage: Stage, pack: Any) -> None:
    async def scene() -> None:
        talker = stage().talker()
        writes: list[bytes] = []
        talker.transport.write = writes.append
        for number in range(5):
            talker.send({"id": number, "method": "step"})
        await turns()
        assert [data.count(b"\n") for data in writes] == [5]

    asyncio.run(scene())


def test_a_long_piece_is_worked_off_in_turns(stage: Stage, pack: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TURN_S", 0.0)
    monkeypatch.setattr(connection, "REST_S", 0.0)

    async def scene() -> None:
        theatre = stage()
        busy, other = theatre.talker(), theatre.talker()
        busy.transport.feed(pack(PING) * 50)
        assert not busy.transport.is_reading()
        other.send(PING)
        assert len(other.heard()) == 1, "another client has its turn in between"
        assert len(busy.heard()) < 50
        busy.transport.feed(pack(PING) * 10)
        await turns(70)
        assert busy.transport.is_reading()
        assert theatre.context.stats.errors == 0
        await turns(70)
        assert len(busy.heard()) >= 50

    asyncio.run(scene())


def test_garbage_gets_errors_and_the_connection_goes_on(stage: Stage) -> None:
    async def scene() -> None:
        talker = stage().talker()
        for garbage in (
            b"hello\n",
            b"\xff\xfe\n",
            b"[" * 4096 + b"\n",
            b"{}\n",
            b"[]\n",
            b"x" * 4096 + b"\n",
            b"NaN\n",
        ):
            talker.transport.feed(garbage)
            (message,) = talker.heard()
            assert message["id"] is None
            assert message["error"]["message"]
        assert await talker.result("ping", 5) == 5

    asyncio.run(scene())


def test_a_huge_line_gets_one_error_and_the_connection_goes_on(stage: Stage) -> None:
    async def scene() -> None:
        talker = stage().talker()
        for _ in range(3 * LINE_LIMIT // 65536):
            talker.transport.feed(b"x" * 65536)
        talker.transport.feed(b"\n")
        (message,) = talker.heard()
        assert message["error"]["data"]["code"] == "too_large"
        assert await talker.result("ping", 5) == 5

    asyncio.run(scene())


def test_a_huge_frame_is_told_and_ends_the_connection(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker("msgpack")
        talker.send(PING)
        talker.transport.feed((FRAME_LIMIT + 1).to_bytes(4, "big") + b"x" * 1000)
        assert last_error(talker)[0] == "too_large"
        assert talker.transport.eof_written
        await until(lambda: talker.transport.is_lost)
        assert theatre.context.stats.peers == 0

    asyncio.run(scene())


def test_a_browser_is_told(stage: Stage) -> None:
    async def scene() -> None:
        talker = stage().talker()
        talker.transport.feed(b"GE")
        talker.transport.feed(b"T / HTTP/1.1\r\nHost: x\r\n\r\n")
        assert talker.transport.take().startswith(b"HTTP/1.1 426 ")
        await until(lambda: talker.transport.is_lost)

    asyncio.run(scene())


@pytest.mark.parametrize(
    "half", [b"", b"G", b"\x00", b"\x00\x00\x10\x00abc", b'{"id":1,"me', b'{"id":1,"method":"step"}']
)
def test_dying_mid_message(stage: Stage, half: bytes) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.transport.feed(half)
        talker.transport.die(ConnectionResetError())
        await turns()
        assert theatre.context.stats.peers == 0
        assert theatre.context.calls == []

    asyncio.run(scene())


# -- peers that do not read ---------------------------------------------------------------------------------------------------------


def test_ring_for_a_peer_that_does_not_read(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(queue_samples=100)
        slow, quick = theatre.talker(), theatre.talker()
        for talker in (slow, quick):
            await talker.result("subscribe", {"pattern": "rov/depth"})
        slow.transport.stall()
        got = 0
        for _ in range(5000):
            theatre.context.emit("rov/depth")
            got += len(quick.samples())
        assert got == 5000, "the other client gets every sample"
        assert slow.transport.get_write_buffer_size() < 2 * connection.HIGH_WATER
        slow.transport.drain()
        numbers = [sample["seq"] for sample in slow.samples()]
        assert numbers[-100:] == list(range(4900, 5000)), "the newest wait"
        assert len(numbers) + theatre.context.stats.dropped == 5000, "each is sent or counted"
        assert numbers == sorted(numbers)

    asyncio.run(scene())


def test_latest_for_a_peer_that_does_not_read(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "**", "delivery": "latest"})
        talker.transport.stall()
        talker.connection.pause_writing()
        for seq in range(1000):
            theatre.context.put([sample_of(IMU, seq), sample_of(DEPTH, seq)])
        talker.connection.resume_writing()
        talker.transport.drain()
        assert [(sample["port"], sample["seq"]) for sample in talker.samples()] == [
            ("rov/imu", 999),
            ("rov/depth", 999),
        ]
        assert theatre.context.stats.dropped == 2 * 999

    asyncio.run(scene())


def test_reliable_for_a_peer_that_does_not_read(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(queue_samples=10)
        slow, quick = theatre.talker(), theatre.talker()
        for talker in (slow, quick):
            await talker.result("subscribe", {"pattern": "rov/depth", "delivery": "reliable"})
        slow.connection.pause_writing()
        slow.transport.stall()
        for _ in range(20):
            theatre.context.emit("rov/depth")
        assert len(quick.samples()) == 20
        slow.transport.drain()
        code, text = last_error(slow)
        assert code == "overload"
        assert "queue_samples" in text
        await until(lambda: theatre.context.stats.peers == 1)
        theatre.context.emit("rov/depth")
        assert len(quick.samples()) == 1

    asyncio.run(scene())


def test_replies_to_a_peer_that_does_not_read(stage: Stage, pack: Any) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.transport.stall()
        sent = 0
        while not talker.transport.eof_written:
            talker.transport.feed(pack({"id": sent, "method": "ping", "params": "x" * 1000}))
            sent += 1
            assert sent < 2 * REPLIES
            await asyncio.sleep(0)
        assert sent > REPLIES
        assert talker.transport.get_write_buffer_size() < 3 * connection.HIGH_WATER
        await until(lambda: talker.transport.is_lost)
        assert theatre.context.stats.peers == 0

    asyncio.run(scene())


def test_the_last_text_names_the_remedy(stage: Stage, pack: Any) -> None:
    async def scene() -> None:
        talker = stage().talker()
        talker.transport.feed(pack(PING))
        talker.connection.pause_writing()
        for _ in range(REPLIES + 1):
            talker.transport.feed(pack(PING))
            await asyncio.sleep(0)
        code, text = last_error(talker)
        assert code == "overload"
        assert "read the replies" in text

    asyncio.run(scene())


def test_events_for_a_peer_that_does_not_read_are_bounded(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.send(PING)
        talker.connection.pause_writing()
        for tick in range(REPLIES + 1):
            theatre.context.say(Event("conflict", tick, tick, "x"))
        await until(lambda: theatre.context.stats.peers == 0)

    asyncio.run(scene())


def test_replies_come_before_waiting_samples(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(queue_samples=5)
        talker = theatre.talker()
        await talker.result("subscribe", {"pattern": "rov/depth"})
        talker.connection.pause_writing()
        for _ in range(50):
            theatre.context.emit("rov/depth")
        talker.send({"id": "after", "method": "ping"})
        talker.connection.resume_writing()
        messages = talker.heard()
        assert messages[0]["id"] == "after"
        assert [m["params"]["seq"] for m in messages[1:]] == [45, 46, 47, 48, 49]

    asyncio.run(scene())


# -- floods -------------------------------------------------------------------------------------------------------------------------


def test_a_flood_is_refused_and_then_not_even_read(stage: Stage, pack: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "WINDOW_S", 0.2)
    monkeypatch.setattr(connection, "TURN_S", 1000.0)

    async def scene() -> None:
        theatre = stage(max_requests_per_s=10)
        flood, other = theatre.talker(), theatre.talker()
        flood.transport.feed(b"".join(pack({"id": number, "method": "ping"}) for number in range(30)))
        messages = flood.heard()
        assert [message["id"] for message in messages] == list(range(30)), "each gets exactly one answer"
        assert sum("result" in message for message in messages) == 10
        assert {message["error"]["data"]["code"] for message in messages[10:]} == {"overload"}
        assert not flood.transport.is_reading()
        assert await other.result("ping", 1) == 1
        await asyncio.sleep(0.4)
        assert flood.transport.is_reading()
        assert await flood.result("ping", 1) == 1

    asyncio.run(scene())


def test_too_many_clients(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(max_clients=2)
        first, second, third = (theatre.talker() for _ in range(3))
        assert await first.result("ping", 1) == await second.result("ping", 1) == 1
        third.send(PING)
        assert last_error(third) == (
            "overload",
            "2 clients are connected: close some, or raise max_clients of the adapter",
        )
        third.send(PING)
        assert third.heard() == []
        await until(lambda: third.transport.is_lost)
        assert await first.result("ping", 1) == await second.result("ping", 1) == 1
        first.transport.die()
        await turns()
        assert await theatre.talker().result("ping", 1) == 1

    asyncio.run(scene())


# -- half-closed connections --------------------------------------------------------------------------------------------------------


def test_a_peer_that_ends_its_side_gets_what_it_is_owed(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.send({"id": 7, "method": "step"})
        talker.transport.feed_eof()
        assert not talker.transport.is_closing()
        await turns()
        assert [message["id"] for message in talker.heard()] == [7]
        assert talker.transport.is_lost

    asyncio.run(scene())


def test_a_subscriber_that_ends_its_side_stays_but_makes_way(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(max_clients=1)
        talker = theatre.talker()
        await talker.result("hello", {"version": 1, "name": "pilot"})
        await talker.result("subscribe", {"pattern": "rov/depth"})
        talker.transport.feed_eof()
        assert theatre.context.joined == [], "it can grant no further tick"
        theatre.context.emit()
        assert len(talker.samples()) == 1
        assert await theatre.talker().result("ping", 1) == 1
        assert talker.transport.is_lost

    asyncio.run(scene())


@pytest.mark.parametrize("before", [b"", b"G", b'{"id":1', b"\n"])
def test_a_peer_that_wants_nothing_is_closed_at_its_end(stage: Stage, before: bytes) -> None:
    async def scene() -> None:
        talker = stage().talker()
        talker.transport.feed(before)
        talker.transport.feed_eof()
        assert talker.transport.is_lost

    asyncio.run(scene())


def test_the_end_waits_for_the_requests_before_it(stage: Stage, pack: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TURN_S", 0.0)
    monkeypatch.setattr(connection, "REST_S", 0.0)

    async def scene() -> None:
        talker = stage().talker()
        talker.transport.feed(pack(PING) * 10)
        talker.transport.feed_eof()
        await turns(30)
        assert len(talker.heard()) == 10
        assert talker.transport.is_lost

    asyncio.run(scene())


def test_what_waits_is_sent_before_the_end(stage: Stage) -> None:
    async def scene() -> None:
        talker = stage().talker()
        talker.send(PING)
        talker.heard()
        talker.connection.pause_writing()
        talker.send({"id": 2, "method": "ping"})
        talker.transport.feed_eof()
        assert not talker.transport.is_closing()
        talker.connection.resume_writing()
        assert [message["id"] for message in talker.heard()] == [2]
        assert talker.transport.is_lost

    asyncio.run(scene())


# -- tokens -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_with_a_token_nothing_is_answered_before_hello(stage: Stage, encoding: str) -> None:
    async def scene() -> None:
        theatre = stage(token="sesame")
        talker = theatre.talker(encoding)
        for method, params in (("describe", None), ("command", {"port": "rov/thrusters", "value": {"u": [1] * 8}})):
            assert (await talker.fault(method, params))[0] == "denied"
        theatre.context.emit()
        theatre.context.say(Event("paused", 0, 0, ""))
        assert talker.heard() == []
        assert theatre.context.commands == []
        assert (await talker.result("hello", {"version": 1, "token": "sesame"}))["session"] == 1
        assert await talker.result("ping", "x" * 70_000) == "x" * 70_000, "the small limit is lifted"
        assert len(theatre.adapter.service.fanout.sessions) == 1

    asyncio.run(scene())


@pytest.mark.parametrize("token", [None, "", "Sesame", "sesame ", 5, ["sesame"]])
def test_a_wrong_token_is_told_and_ends(stage: Stage, token: object) -> None:
    async def scene() -> None:
        talker = stage(token="sesame").talker()
        code, text = await talker.fault("hello", {"version": 1, "token": token})
        assert code == "denied"
        assert "sesame" not in text
        talker.send({"id": 9, "method": "hello", "params": {"version": 1, "token": "sesame"}})
        assert talker.heard() == []
        await until(lambda: talker.transport.is_lost)

    asyncio.run(scene())


@pytest.mark.parametrize("message", [b'{"id":1,"method":"ping"}\n', b"garbage\n"])
def test_a_stranger_has_few_tries(stage: Stage, message: bytes) -> None:
    async def scene() -> None:
        talker = stage(token="sesame").talker()
        talker.transport.feed(message * 100)
        codes = [entry["error"]["data"]["code"] for entry in talker.heard()]
        assert codes == ["denied"] * (TRIES + 1)
        await until(lambda: talker.transport.is_lost)

    asyncio.run(scene())


def test_a_stranger_may_not_fill_the_memory(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(token="sesame")
        lines, frames = theatre.talker(), theatre.talker("msgpack")
        lines.transport.feed(b"x" * (STRANGER_LIMIT + 1))
        assert last_error(lines)[0] == "denied"
        frames.transport.feed((STRANGER_LIMIT + 1).to_bytes(4, "big"))
        assert last_error(frames)[0] == "denied"
        await until(lambda: frames.transport.is_lost)

    asyncio.run(scene())


def test_a_stranger_has_little_time(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(token="sesame", hello_timeout_s=0.5)
        mute, known = theatre.talker(), theatre.talker()
        await known.result("hello", {"version": 1, "token": "sesame"})
        await until(lambda: mute.transport.is_lost)
        assert json.loads(mute.transport.take())["error"]["data"]["code"] == "denied"
        assert await known.result("ping", 1) == 1

    asyncio.run(scene())


def test_who_says_nothing_is_ended_where_no_token_is_set_too(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(hello_timeout_s=0.5)
        mute, babbling, known = theatre.talker(), theatre.talker(), theatre.talker()
        babbling.transport.feed(b"no JSON\n")
        await known.result("ping", 1)
        for talker in (mute, babbling):
            await until(lambda talker=talker: talker.transport.is_lost)
            assert last_error(talker)[0] == "timeout"
        assert await known.result("ping", 1) == 1

    asyncio.run(scene())


def test_a_host_that_tries_tokens_is_not_heard_for_a_while(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scene() -> None:
        theatre = stage(token="sesame")
        known, waiting = theatre.talker(), theatre.talker()
        await known.result("hello", {"version": 1, "token": "sesame"})
        for number in range(WRONG_TOKENS + 1):
            talker = theatre.talker()
            assert (await talker.fault("hello", {"version": 1, "token": str(number)}))[0] == "denied"
        late = theatre.talker()
        assert last_error(late)[0] == "denied"
        assert late.transport.eof_written
        waiting.send({"id": 1, "method": "hello", "params": {"version": 1, "token": "sesame"}})
        assert "wrong tokens of one host" in last_error(waiting)[1], "nor is the right one"
        assert await known.result("ping", 1) == 1, "who is in stays"
        assert theatre.context.stats.details["refused"]["lockout"] == 1
        now = asyncio.get_running_loop().time() + LOCKOUT_S
        monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now)
        assert "result" in await theatre.talker().ask("hello", {"version": 1, "token": "sesame"})

    asyncio.run(scene())


def test_the_token_of_the_environment(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scene() -> None:
        monkeypatch.setenv("UWSERVER_TOKEN", "from outside")
        assert (await stage().talker().fault("ping"))[0] == "denied"
        assert stage(token="own").adapter.service.token == "own"
        monkeypatch.setenv("UWSERVER_TOKEN", "")
        assert await stage().talker().result("ping", 1) == 1

    asyncio.run(scene())


def test_the_limits_of_a_client_are_configurable(stage: Stage) -> None:
    async def scene() -> None:
        theatre = stage(max_subscriptions=2, max_unanswered=1)
        talker = theatre.talker()
        for _ in range(2):
            await talker.result("subscribe", {"pattern": "**"})
        assert (await talker.fault("subscribe", {"pattern": "**"}))[0] == "overload"
        theatre.context.held.add("world/run_until")
        talker.send({"id": 50, "method": "call", "params": {"service": "world/run_until", "args": {"t_s": 1.0}}})
        assert (await talker.fault("step"))[0] == "overload"

    asyncio.run(scene())


def test_refusals_are_counted_and_logged_once_a_cause(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        theatre = stage()
        for _ in range(3):
            talker = theatre.talker()
            talker.transport.feed(b"no JSON\n[]\n")
            assert len(talker.heard()) == 2
        assert theatre.context.stats.details["refused"] == {"parse_error": 3, "invalid_request": 3}
        assert len([record for record in caplog.records if "refused" in record.getMessage()]) == 2

    asyncio.run(scene())
