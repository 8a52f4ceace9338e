"""WebSocket on the adapter's port: against the client of the websockets library, and against bytes made by hand."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import websockets
from uwserver_adapters.sockets import connection
from uwserver_adapters.sockets.codec import LINE_LIMIT, NEED_DATA
from uwserver_adapters.sockets.encoding import Encoding
from uwserver_adapters.sockets.requests import Malformed, Request
from uwserver_adapters.sockets.websocket import LOCAL_ORIGINS, Handshake, allows
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from uwserver.testing.codecs import read_all

Serving = Callable[..., Any]
KEY = "dGhlIHNhbXBsZSBub25jZQ=="
REQUEST = (
    f"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {KEY}\r\n"
    "Sec-WebSocket-Version: 13\r\n\r\n"
).encode()
ACCEPT = base64.b64encode(hashlib.sha1(f"{KEY}258EAFA5-E914-47DA-95CA-C5AB0DC85B11".encode()).digest())


@pytest.fixture(autouse=True)
def _short_linger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "LINGER_S", 0.2)


def masked(opcode: int, body: bytes, fin: bool = True) -> bytes:
    """A frame as a client sends it, made by hand."""
    mask = b"\x12\x34\x56\x78"
    size = bytes([128 | len(body)]) if len(body) < 126 else b"\xfe" + len(body).to_bytes(2, "big")
    return bytes([opcode | 128 * fin]) + size + mask + bytes(byte ^ mask[i % 4] for i, byte in enumerate(body))


def frames(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of the server's frames, which are whole and short."""
    while data:
        assert data[0] & 128
        size, start = data[1], 2
        if size == 126:
            size, start = int.from_bytes(data[2:4], "big"), 4
        yield data[0] & 15, data[start : start + size]
        data = data[start + size :]


async def ask(client: Any, method: str, params: object = None, identity: int = 1) -> dict[str, Any]:
    await client.send(json.dumps({"id": identity, "method": method, "params": params}))
    while (message := json.loads(await asyncio.wait_for(client.recv(), 5))).get("id") != identity:
        pass
    return message


def play(serving: Serving, scene: Callable[[Any, str], Any], **config: Any) -> None:
    async def whole() -> None:
        async with serving(**config) as context:
            await asyncio.wait_for(scene(context, f"ws://{context.stats.address}"), 20)

    asyncio.run(whole())


# -- the library's client -----------------------------------------------------------------------------------------------------------


def test_text_is_json_and_binary_is_msgpack(serving: Serving) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url) as text, connect(url) as binary:
            assert (await ask(text, "hello", {"version": 1}))["result"]["encoding"] == "json"
            assert (await ask(text, "subscribe", {"pattern": "rov/depth"}))["result"]["ports"] == ["rov/depth"]
            await binary.send(msgpack.packb({"id": 1, "method": "hello", "params": {"version": 1}}))
            assert msgpack.unpackb(await binary.recv())["result"]["encoding"] == "msgpack"
            await binary.send(msgpack.packb({"id": 2, "method": "subscribe", "params": {"pattern": "rov/depth"}}))
            assert msgpack.unpackb(await binary.recv())["id"] == 2
            context.emit()
            a, b = json.loads(await text.recv()), msgpack.unpackb(await binary.recv())
            assert a == b
            assert a["params"]["port"] == "rov/depth"
            assert text.response.headers.get("Sec-WebSocket-Extensions") is None, "no compression"

    play(serving, scene)


def test_fragments_pings_and_an_orderly_end(serving: Serving) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url) as client:
            whole = json.dumps({"id": 7, "method": "ping", "params": "é" * 3000})
            await client.send(whole[start : start + 100] for start in range(0, len(whole), 100))
            assert json.loads(await client.recv()) == {"jsonrpc": "2.0", "id": 7, "result": "é" * 3000}
            await asyncio.wait_for(await client.ping(b"there?"), 5)
            assert context.stats.peers == 1
        assert client.close_code == 1000
        while context.stats.peers:
            await asyncio.sleep(0.01)

    play(serving, scene)


@pytest.mark.parametrize(
    ("message", "code", "error"),
    [
        (b"\x80" * (1 << 17), None, "invalid_request"),
        (b"x" * ((16 << 20) + 1), 1009, "too_large"),
        ("x" * (LINE_LIMIT + 1), None, "too_large"),
        ("no JSON", None, "parse_error"),
        (b"", None, "invalid_request"),
    ],
)
def test_messages_that_are_refused(serving: Serving, message: Any, code: int | None, error: str) -> None:
    async def scene(context: Any, url: str) -> None:
        client = await connect(url, max_size=None)
        await client.send(message)
        raw = await client.recv()
        answer = json.loads(raw) if isinstance(raw, str) else msgpack.unpackb(raw)
        assert answer["error"]["data"]["code"] == error
        if code is None:
            await asyncio.wait_for(await client.ping(), 5)
            await client.close()
        else:
            with pytest.raises(ConnectionClosed):
                await client.recv()
            assert client.close_code == code
            assert client.close_reason
        assert context.stats.details["refused"] == {error: 1}

    play(serving, scene)


def test_bad_utf8_ends_with_1007(serving: Serving) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url) as client:
            await client.send(b'{"a":"\xff"}', text=True)
            assert json.loads(await client.recv())["error"]["data"]["code"] == "parse_error"
            with pytest.raises(ConnectionClosed):
                await client.recv()
            assert client.close_code == 1007

    play(serving, scene)


def test_a_wrong_token_ends_with_1008(serving: Serving, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(context: Any, url: str) -> None:
        for _ in range(3):
            async with connect(url) as client:
                assert (await ask(client, "hello", {"version": 1, "token": "x"}))["error"]["data"]["code"] == "denied"
                with pytest.raises(ConnectionClosed):
                    await client.recv()
                assert client.close_code == 1008
                assert "token" in client.close_reason
        async with connect(url) as client:
            assert "result" in await ask(client, "hello", {"version": 1, "token": "sesame"})
        assert context.stats.details["refused"]["denied"] == 3
        assert caplog.text.count("refused (denied)") == 1, "logged once per cause"

    play(serving, scene, token="sesame")


def test_the_server_says_when_it_goes(serving: Serving) -> None:
    async def whole() -> None:
        async with serving() as context:
            client = await connect(f"ws://{context.stats.address}")
        with pytest.raises(ConnectionClosed):
            await client.recv()
        assert client.close_code == 1001

    asyncio.run(whole())


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://localhost", "http://localhost.evil.example"]
)
def test_other_pages_are_refused(serving: Serving, origin: str, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(context: Any, url: str) -> None:
        for _ in range(2):
            with pytest.raises(InvalidStatus) as caught:
                await connect(url, origin=websockets.Origin(origin))
            assert caught.value.response.status_code == 403
            assert b"allowed_origins" in caught.value.response.body
        assert caplog.text.count("refused (origin)") == 1

    play(serving, scene)


@pytest.mark.parametrize(
    ("config", "origin"),
    [
        ({}, None),
        ({}, "http://localhost:8000"),
        ({}, "http://127.0.0.1"),
        ({"allowed_origins": ["https://dive.example"]}, "https://dive.example"),
        ({"allowed_origins": ["*"]}, "null"),
    ],
)
def test_pages_that_may_connect(serving: Serving, config: dict[str, Any], origin: Any) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url, origin=origin) as client:
            assert (await ask(client, "ping", 5))["result"] == 5

    play(serving, scene, **{key: tuple(value) for key, value in config.items()})


def test_a_slow_reader_is_no_burden(serving: Serving) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url, max_queue=1) as client:
            await ask(client, "subscribe", {"pattern": "rov/imu"})
            for _ in range(100_000):
                context.emit("rov/imu")
                if context.stats.dropped > 1000:
                    break
                await asyncio.sleep(0)
            assert context.stats.dropped > 1000
            client.transport.abort()

    play(serving, scene, queue_samples=50)


# -- bytes made by hand -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_the_handshake_in_pieces(stage: Any, size: int) -> None:
    async def scene() -> None:
        talker = stage().talker()
        data = REQUEST + masked(1, b'{"id":1,"method":"ping"}') + masked(9, b"hi")
        for start in range(0, len(data), size):
            talker.transport.feed(data[start : start + size])
        await asyncio.sleep(0)
        head, _, rest = talker.transport.take().partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 101 ")
        assert b"Sec-WebSocket-Accept: " + ACCEPT in head
        assert [(opcode, body) for opcode, body in frames(rest)] == [
            (1, b'{"jsonrpc":"2.0","id":1,"result":null}'),
            (10, b"hi"),
        ]

    asyncio.run(scene())


def test_a_page_gets_a_friendly_text(stage: Any) -> None:
    async def scene() -> None:
        talker = stage().talker()
        talker.transport.feed(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        answer = talker.transport.take()
        assert answer.startswith(b"HTTP/1.1 426 ")
        assert b"new WebSocket" in answer

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        (REQUEST.replace(b"13", b"12"), b"HTTP/1.1 400 "),
        (REQUEST.replace(KEY.encode(), b"x"), b"HTTP/1.1 400 "),
        (REQUEST.replace(b"Upgrade: websocket", b"Upgrade: h2c"), b"HTTP/1.1 426 "),
        (
            REQUEST.replace(b"\r\n\r\n", b"\r\nOrigin: http://evil.example\r\nOrigin: http://localhost\r\n\r\n"),
            b"HTTP/1.1 403 ",
        ),
        (b"GET nonsense\r\n\r\n", b"HTTP/1.1 426 "),
        (b"GET /" + b"x" * 10_000, b"HTTP/1.1 4"),
        (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 1000, b"HTTP/1.1 4"),
    ],
)
def test_bad_handshakes_are_answered_and_ended(stage: Any, request_bytes: bytes, answer: bytes) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.transport.feed(request_bytes)
        assert talker.transport.take().startswith(answer)
        assert talker.transport.eof_written
        await asyncio.sleep(0.3)
        assert theatre.context.stats.peers == 0

    asyncio.run(scene())


def test_an_endless_handshake_is_ended(stage: Any) -> None:
    async def scene() -> None:
        theatre = stage(hello_timeout_s=0.05)
        talker = theatre.talker()
        talker.transport.feed(REQUEST[:-2])
        await asyncio.sleep(0.15)
        assert talker.transport.is_lost
        finished = theatre.talker()
        finished.transport.feed(REQUEST)
        await asyncio.sleep(0.15)
        assert not finished.transport.is_lost, "the handshake was in time"

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\x81\x02{}", 1002),  # without a mask
        (masked(3, b""), 1002),
        (masked(0, b"x"), 1002),
        (masked(1, b"x", fin=False) + masked(1, b"x"), 1002),
        (masked(9, b"x" * 200), 1002),
        (masked(0xC1 & 0x7F, b"x"), 1002),
        (bytes([0x82, 0xFF]) + (1 << 40).to_bytes(8, "big"), 1009),
        (masked(1, b"\xc3"), 1007),
    ],
)
def test_broken_frames_end_with_their_code(stage: Any, data: bytes, code: int) -> None:
    async def scene() -> None:
        theatre = stage()
        talker = theatre.talker()
        talker.transport.feed(REQUEST + data)
        _, _, rest = talker.transport.take().partition(b"\r\n\r\n")
        (_, message), (opcode, close) = frames(rest)
        assert json.loads(message)["error"]["message"]
        assert opcode == 8
        assert int.from_bytes(close[:2], "big") == code
        talker.transport.die()
        await asyncio.sleep(0)
        assert theatre.context.stats.peers == 0

    asyncio.run(scene())


def test_a_stranger_sends_no_long_message(stage: Any) -> None:
    async def scene() -> None:
        talker = stage(token="sesame").talker()
        talker.transport.feed(REQUEST + bytes([0x82, 0xFF]) + (1 << 20).to_bytes(8, "big") + b"abcd")
        for _ in range(80):
            talker.transport.feed(b"x" * 1024)
        _, _, rest = talker.transport.take().partition(b"\r\n\r\n")
        assert [opcode for opcode, _ in frames(rest)][-1] == 8
        assert talker.transport.eof_written

    asyncio.run(scene())


def test_many_small_frames_leave_others_their_turn(stage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TURN_S", 0.0)

    async def scene() -> None:
        theatre = stage()
        busy, other = theatre.talker(), theatre.talker()
        busy.transport.feed(REQUEST)
        busy.transport.feed(masked(9, b"") * 40_000)
        other.send({"id": 1, "method": "ping"})
        assert len(other.heard()) == 1
        assert len(busy.transport.take()) < 40_000
        busy.transport.die()
        await asyncio.sleep(0)

    asyncio.run(scene())


def test_both_framings_share_one_encoding(stage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    real = Encoding.sample
    monkeypatch.setattr(Encoding, "sample", lambda *args: made.append(1) or real(*args))

    async def scene() -> None:
        theatre = stage()
        lines, web = theatre.talker(), theatre.talker()
        await lines.result("subscribe", {"pattern": "rov/imu"})
        web.transport.feed(REQUEST + masked(1, b'{"id":1,"method":"subscribe","params":{"pattern":"rov/imu"}}'))
        web.transport.take()
        theatre.context.emit("rov/imu")
        ((_, body),) = frames(web.transport.take())
        assert [json.loads(body)] == lines.heard()
        assert len(made) == 1

    asyncio.run(scene())


def test_fuzz() -> None:
    """Whatever comes after the handshake, in whatever pieces: events are the same, and nothing is raised."""
    draw = np.random.default_rng(1)
    good = [
        masked(1, b'{"id":1,"method":"ping"}'),
        masked(2, msgpack.packb({"id": 2, "method": "ping"})),
        masked(9, b"x"),
    ]
    good += [masked(1, b'{"id":3,', fin=False) + masked(0, b'"method":"ping"}'), masked(8, b"\x03\xe8")]
    for _ in range(3000):
        data = bytearray(b"".join(good[draw.integers(len(good))] for _ in range(draw.integers(1, 5))))
        for _ in range(draw.integers(4)):
            data[draw.integers(len(data))] = draw.integers(256)
        cut = int(draw.integers(len(data)))
        whole, pieces = opened(), opened()
        first = [e for e in read_all(whole, [bytes(data)], NEED_DATA) if isinstance(e, Request | Malformed)]
        second = read_all(pieces, [bytes(data[:cut]), bytes(data[cut:])], NEED_DATA)
        assert repr(first) == repr([e for e in second if isinstance(e, Request | Malformed)]), bytes(data)


def opened() -> Any:
    handshake = Handshake(LOCAL_ORIGINS)
    assert handshake.receive(REQUEST + b"rest") == b"rest"
    assert handshake.codec is not None
    return handshake.codec


def test_patterns_of_origins() -> None:
    assert allows(("http://a:*",), "http://a:80")
    assert not allows(("http://a:*",), "http://a:80.evil")
    assert not allows(("http://a:*",), "http://a")
    assert not allows((), "http://a")


# -- the page of docs/how-to/browser.md ---------------------------------------------------------------------------------------------


def test_the_protocol_steps_of_the_page_work(serving: Serving) -> None:
    page = (Path(__file__).parents[4] / "docs/how-to/browser.md").read_text()
    sent = [json.loads(text.replace("'", '"')) for text in re.findall(r"JSON\.stringify\((\{.*?\})\)\)", page)]
    assert {message["method"] for message in sent} >= {"subscribe", "command"}

    async def scene(context: Any, url: str) -> None:
        async with connect(url, origin=websockets.Origin("http://localhost:8000")) as client:
            for message in sent:
                await client.send(json.dumps(message).replace("bluerov2/", "rov/"))
            seen: list[Any] = []
            while len(seen) < len(sent):
                seen.append(json.loads(await asyncio.wait_for(client.recv(), 5)))
            assert all("result" in message for message in seen), seen
            context.emit("rov/depth")
            assert "depth" in json.loads(await client.recv())["params"]["value"]

    play(serving, scene)
