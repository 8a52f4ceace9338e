"""UDP: cookies, leases, numbers, and what is refused; with plain sockets on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import msgpack
import pytest
from uwserver_adapters.native.messages import JSON, MSGPACK, Malformed, Request, ResultMessage
from uwserver_adapters.sockets import datagrams
from uwserver_adapters.sockets.datagrams import DATAGRAM_LIMIT, numbered, parse_datagram

from uwserver.adapter import CannotListen, access, connection
from uwserver.ports import Event, Field, Port
from uwserver.testing import FakeContext, TcpPeer, sample_of

Serving = Callable[..., Any]
HELLO = {"id": 1, "method": "hello", "params": {"version": 1}}


class Talker:
    """One UDP socket."""

    def __init__(self, context: FakeContext) -> None:
        host, _, port = str(context.stats.details["udp"]).rpartition(":")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect((host, int(port)))

    def send(self, message: object) -> None:
        self.socket.send(message if isinstance(message, bytes) else json.dumps(message).encode())

    async def raw(self) -> bytes:
        return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(self.socket, 1 << 17), 60)

    async def hear(self) -> Any:
        data = await self.raw()
        return json.loads(data) if data.startswith(b"{") else msgpack.unpackb(data)

    async def cookie(self) -> str:
        self.send(HELLO)
        answer = await self.hear()
        assert list(answer) == ["cookie"]
        return answer["cookie"]

    async def enter(self, **params: object) -> Any:
        self.send({"id": 1, "method": "hello", "params": {"version": 1, "cookie": await self.cookie()} | params})
        return await self.hear()

    async def ask(self, method: str, params: object = None) -> Any:
        self.send({"id": 2, "method": method, "params": params})
        return await self.hear()

    async def silent(self, seconds: float = 0.05) -> None:
        await asyncio.sleep(seconds)
        with pytest.raises(BlockingIOError):
            self.socket.recv(1)


def play(serving: Serving, scene: Callable[..., Any], count: int = 1, **config: Any) -> None:
    async def whole() -> None:
        async with serving(udp_port=0, **config) as context:
            talkers = [Talker(context) for _ in range(count)]
            try:
                await asyncio.wait_for(scene(context, *talkers), 120)
            finally:
                for talker in talkers:
                    talker.socket.close()

    asyncio.run(whole())


def test_samples_are_numbered_without_a_gap(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        assert (await talker.enter())["n"] == 0
        assert context.stats.peers == 1
        reply = await talker.ask("subscribe", {"pattern": "rov/depth"})
        assert (reply["result"]["ports"], reply["n"]) == (["rov/depth"], 1)
        for number in range(300):
            context.emit("rov/depth")
            message = await talker.hear()
            assert (message["params"]["seq"], message["n"]) == (number, number + 2)
        assert (await talker.ask("command", {"port": "rov/thrusters", "value": {"u": [0.1] * 8}}))["result"][
            "tick"
        ] == 300
        assert (await talker.ask("unsubscribe", {"pattern": "rov/depth"}))["result"] == {"removed": 1}
        context.emit("rov/depth")
        context.say(Event("paused", 1, 1, "by the test"))
        assert (await talker.hear())["params"]["event"] == "paused"

    play(serving, scene)


def test_msgpack(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        talker.send(msgpack.packb(HELLO))
        cookie = (await talker.hear())["cookie"]
        talker.send(msgpack.packb({"id": 1, "method": "hello", "params": {"version": 1, "cookie": cookie}}))
        reply = await talker.hear()
        assert (reply["result"]["encoding"], reply["n"]) == ("msgpack", 0)
        talker.send(msgpack.packb({"id": 2, "method": "subscribe", "params": {"pattern": "rov/imu"}}))
        await talker.hear()
        context.emit("rov/imu")
        assert (await talker.raw())[0] & 0xF0 == 0x80

    play(serving, scene)


def test_a_stranger_gets_nothing_larger_than_it_sent(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        for data in (b"{}", b"x", b"\x81\xa1a\x01", b'{"method":"describe"}'):
            talker.send(data)
            await talker.silent()
        for data in (b"x" * 100, b"\x80" * 100, b'{"id":1,"method":"describe","params":null}', b"x" * 60_000):
            talker.send(data)
            answer = await talker.raw()
            assert b"cookie" in answer
            assert len(answer) <= len(data)
        assert context.stats.peers == 0
        assert context.described == []

    play(serving, scene)


def test_a_cookie_is_of_one_address(serving: Serving) -> None:
    async def scene(context: Any, owner: Talker, thief: Talker) -> None:
        cookie = await owner.cookie()
        thief.send({"id": 1, "method": "hello", "params": {"version": 1, "cookie": cookie}})
        assert list(await thief.hear()) == ["cookie"]
        assert context.stats.details["refused"] == {"cookie": 1}
        await owner.enter()
        thief.send({"id": 9, "method": "unsubscribe", "params": {"pattern": "**"}})
        assert list(await thief.hear()) == ["cookie"], "another port is another client"
        await owner.silent()

    play(serving, scene, count=2)


def test_a_cookie_grows_old(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        cookie = await talker.cookie()
        monkeypatch.setattr(datagrams, "COOKIE_S", 1e-3)
        await asyncio.sleep(0.01)
        talker.send({"id": 1, "method": "hello", "params": {"version": 1, "cookie": cookie}})
        assert (await talker.hear())["cookie"] != cookie

    play(serving, scene)


def test_a_silent_client_is_forgotten_and_any_datagram_keeps_it(serving: Serving) -> None:
    async def scene(context: Any, keeps: Talker, vanishes: Talker) -> None:
        for talker in (keeps, vanishes):
            await talker.enter()
            await talker.ask("subscribe", {"pattern": "rov/depth"})
        while context.stats.peers == 2:
            await asyncio.sleep(0.05)
            assert (await keeps.ask("ping", 1))["result"] == 1
        assert (await vanishes.hear())["error"]["data"]["code"] == "timeout"
        context.emit("rov/depth")
        assert (await keeps.hear())["params"]["port"] == "rov/depth"
        await vanishes.silent()
        assert list(await vanishes.ask("ping", "x" * 50)) == ["cookie"]
        assert "result" in await vanishes.enter()

    play(serving, scene, count=2, udp_lease_s=1.5)


def test_a_repeated_hello_begins_anew(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        cookie = await talker.cookie()
        hello = {"id": 1, "method": "hello", "params": {"version": 1, "cookie": cookie}}
        for _ in range(3):
            talker.send(hello)
            reply = await talker.hear()
            assert (reply["result"]["version"], reply["n"]) == (1, 0)
        assert context.stats.peers == 1

    play(serving, scene)


def test_the_token_is_needed_too(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        assert (await talker.enter(token="x"))["error"]["data"]["code"] == "denied"
        assert context.stats.peers == 0
        assert list(await talker.ask("ping", "x" * 50)) == ["cookie"]
        assert "result" in await talker.enter(token="sesame")

    play(serving, scene, token="sesame")


def test_a_host_that_tries_tokens_is_not_heard_for_a_while(
    serving: Serving, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(access, "LOCKOUT_S", 2.0)

    async def scene(context: Any, talker: Talker, guest: Talker) -> None:
        assert "result" in await guest.enter(token="sesame")
        for _ in range(access.WRONG_TOKENS + 1):
            assert (await talker.enter(token="x"))["error"]["data"]["code"] == "denied"
        talker.send(HELLO)
        await talker.silent()
        assert (await guest.ask("ping", 5))["result"] == 5, "who is inside already stays"
        assert context.stats.details["refused"] == {"denied": access.WRONG_TOKENS + 1, "lockout": 1}
        assert caplog.text.count("wrong tokens of one host") == 1
        assert caplog.text.count("refused (denied)") == 1
        await asyncio.sleep(2.0)
        assert "result" in await talker.enter(token="sesame")

    play(serving, scene, count=2, token="sesame")


def test_the_hosts_that_are_remembered_are_bounded() -> None:
    lockout = access.Lockout()
    for host in range(3 * access.LOCKOUT_HOSTS):
        assert not lockout.wrong(host, 0.0)
    assert len(lockout._hosts) == access.LOCKOUT_HOSTS
    assert not lockout.is_out("nobody", 0.0)


@pytest.mark.parametrize("params", [{"version": 2}, {"prams": 1}, {"name": 5}])
def test_a_bad_hello_leaves_nothing(serving: Serving, params: dict[str, Any]) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        assert "error" in await talker.enter(**params)
        assert context.stats.peers == 0

    play(serving, scene)


def test_garbage_of_a_client_is_refused_and_it_stays(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        await talker.enter()
        for data in (b"", b"\x00", b"\xff" * 60, b"{" * 5000, b"\x81\xa1", b"NaN", b"[]", b"x" * DATAGRAM_LIMIT):
            talker.send(data)
            assert (await talker.hear())["error"]["message"]
        assert (await talker.ask("ping", 5))["result"] == 5

    play(serving, scene)


def test_what_no_datagram_carries(serving: Serving) -> None:
    large = Port("rov/image", "sensor", "image", (Field("pixels", "1", "grey", shape=(40_000,)),), "Large.")

    async def scene(context: Any, talker: Talker) -> None:
        await talker.enter()
        context.set_ports([*context.ports.values(), large])
        await talker.ask("subscribe", {"pattern": "**"})
        for seq in range(3):
            context.put([sample_of(large, seq)])
        refusal = await talker.hear()
        while "error" not in refusal:
            refusal = await talker.hear()
        assert refusal["error"]["data"]["code"] == "too_large"
        assert context.stats.dropped == 3
        context.emit("rov/depth")
        assert (await talker.hear())["params"]["port"] == "rov/depth", "told once"
        context.scripts["world/echo"] = lambda _: "x" * 70_000
        reply = await talker.ask("call", {"service": "world/echo"})
        assert (reply["id"], reply["error"]["data"]["code"]) == (2, "too_large")

    play(serving, scene)


def test_reliable_and_floods_are_refused(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        await talker.enter()
        fault = (await talker.ask("subscribe", {"pattern": "**", "delivery": "reliable"}))["error"]
        assert fault["data"]["code"] == "bad_argument"
        for _ in range(30):
            talker.send({"id": 2, "method": "ping"})
            await asyncio.sleep(0)
        codes = [(await talker.hear()).get("error", {}).get("data", {}).get("code") for _ in range(9)]
        assert codes == [None] * 8 + ["overload"]
        await talker.silent()

    play(serving, scene, max_requests_per_s=10)


def test_a_large_datagram_counts_as_many_requests(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        await talker.enter()
        large = {"id": 2, "method": "ping", "params": "x" * (1024 + 40 * 64)}
        for _ in range(4):
            talker.send(large)
            await asyncio.sleep(0)
        codes = [(await talker.hear()).get("error", {}).get("data", {}).get("code") for _ in range(3)]
        assert codes == [None, None, "overload"]
        await talker.silent()

    play(serving, scene, max_requests_per_s=100)


def test_a_flood_is_not_even_decoded(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[bytes] = []

    def counted(data: bytes) -> Any:
        decoded.append(data)
        return parse_datagram(data)

    monkeypatch.setattr(datagrams, "parse_datagram", counted)
    monkeypatch.setattr(datagrams, "STRANGERS_PER_S", 20)

    async def scene(context: Any, client: Talker, stranger: Talker) -> None:
        await client.enter()
        for _ in range(50):
            client.send(b'{"id":1,"method":"ping","params":"of the client"}')
            stranger.send(b'{"id":1,"method":"ping","params":"of a stranger"}')
            await asyncio.sleep(0)
        await until_quiet(decoded)
        assert sum(b"client" in data for data in decoded) <= 10
        assert sum(b"stranger" in data for data in decoded) <= 20

    play(serving, scene, 2, max_requests_per_s=10)


def test_what_comes_at_once_is_worked_off_in_turns(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing holds datagrams back: a client whose costly ones are within its rate must not have all of them carried out at once."""
    decoded: list[tuple[float, bytes]] = []

    def counted(data: bytes) -> Any:
        decoded.append((time.monotonic(), data))
        return parse_datagram(data)

    async def scene(context: Any, crowd: Talker, other: Talker) -> None:
        await crowd.enter()
        await other.enter()
        monkeypatch.setattr(datagrams, "parse_datagram", counted)
        for n in range(6):
            crowd.send({"id": n, "method": "ping"})
        other.send({"id": 7, "method": "ping"})
        replies = [await other.hear(), *[await crowd.hear() for _ in range(6)]]
        assert [reply["id"] for reply in replies] == [7, 0, 1, 2, 3, 4, 5]
        assert 7 in [json.loads(data)["id"] for _, data in decoded[:3]], "each client in turn"
        assert all(after[0] - before[0] >= 0.04 for before, after in pairwise(decoded)), "after each there is a rest"

    monkeypatch.setattr(connection, "TURN_S", 1e-9)
    monkeypatch.setattr(connection, "REST_S", 0.04)
    play(serving, scene, 2)


def test_bytes_back_are_never_more_than_bytes_sent_before_a_cookie_has_come_back(serving: Serving) -> None:
    """Whatever is sent: a forged sender's address must not be made to receive more than was spent on it."""
    told = {"version": 1, "cookie": "A" * 16, "token": "sesame", "name": "x"}
    messages: list[object] = [
        HELLO,
        {"id": 1, "method": "hello", "params": told},
        {"id": "x" * 300, "method": "hello", "params": {"version": 2}},
        {"method": "describe"},
        {"id": 1, "method": "subscribe", "params": {"pattern": "**"}},
        [HELLO] * 3,
        {"cookie": 1},
        None,
    ]
    bodies = [encode(message) for message in messages for encode in (json.dumps, msgpack.packb)]
    sent = [body.encode() if isinstance(body, str) else body for body in bodies]
    sent += [body[:cut] for body in sent for cut in (1, 10, len(body) - 1)]
    sent += [b"", b"\x00", b"GET / HTTP/1.1\r\n\r\n", b"{" * 2048, b"x" * 2049, b"\x80" * 60_000, b"\xde\xff\xff"]

    async def scene(context: Any, talker: Talker) -> None:
        back = 0
        for data in sent:
            talker.send(data)
            await asyncio.sleep(0.005)
            with contextlib.suppress(BlockingIOError):
                while answer := talker.socket.recv(1 << 17):
                    back += len(answer)
                    assert len(answer) <= len(data), (data[:100], answer)
        assert back > 0
        assert context.stats.bytes_sent == back
        assert context.stats.peers == 0

    play(serving, scene, token="sesame")


async def until_quiet(heard: list[bytes]) -> None:
    count = -1
    while len(heard) != count:
        count = len(heard)
        await asyncio.sleep(0.02)


def test_clients_of_all_transports_are_counted(serving: Serving) -> None:
    async def scene(context: Any, talker: Talker) -> None:
        peer = await TcpPeer.connect(context)
        await peer.send(b'{"id":1,"method":"ping"}\n')
        assert await peer.hear()
        assert (await talker.enter())["error"]["data"]["code"] == "overload"
        await peer.close()

    play(serving, scene, max_clients=1)


def test_the_end_closes_the_socket(serving: Serving) -> None:
    async def whole() -> None:
        async with serving(udp_port=0) as context:
            talker = Talker(context)
            await talker.enter()
        assert context.stats.peers == 0
        talker.socket.close()

    asyncio.run(whole())


def test_a_udp_port_in_use(serving: Serving) -> None:
    async def whole() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            with pytest.raises(CannotListen, match="udp_port = 0"):
                async with serving(udp_port=taken.getsockname()[1]):
                    pass

    asyncio.run(whole())


@pytest.mark.parametrize("number", [0, 127, 128, 2**16, 2**40])
def test_numbers(number: int) -> None:
    for encoding, decode in ((JSON, json.loads), (MSGPACK, msgpack.unpackb)):
        message = encoding.encode(ResultMessage(5, {"a": 1}))
        assert decode(numbered(encoding, message, number)) == decode(message) | {"n": number}
        assert len(numbered(encoding, message, number)) - len(message) <= 24


@pytest.mark.parametrize(
    ("data", "encoding", "kind"),
    [
        (b' {"method":"ping"}\n', JSON, Request),
        (msgpack.packb({"method": "ping"}), MSGPACK, Request),
        (b"\xde\x00\x01\xa6method\xa4ping", MSGPACK, Request),
        (b"", JSON, Malformed),
        (b"\x90", JSON, Malformed),
    ],
)
def test_the_first_byte_decides(data: bytes, encoding: Any, kind: type) -> None:
    found, event = parse_datagram(data)
    assert found is encoding
    assert isinstance(event, kind)
