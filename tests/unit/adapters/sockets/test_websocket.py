"""WebSocket on the adapter's port: against the client of the websockets library."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
import websockets
from kernel_buffers import keep_small
from uwserver_adapters.native.codec import LINE_LIMIT
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus

from uwserver.adapter import WRONG_TOKENS, connection

Serving = Callable[..., Any]


@pytest.fixture(autouse=True)
def _short_linger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "LINGER_S", 0.2)


async def ask(client: Any, method: str, params: object = None, identity: int = 1) -> dict[str, Any]:
    await client.send(json.dumps({"id": identity, "method": method, "params": params}))
    while (message := json.loads(await asyncio.wait_for(client.recv(), 60))).get("id") != identity:
        pass
    return message


def play(serving: Serving, scene: Callable[[Any, str], Any], **config: Any) -> None:
    async def whole() -> None:
        async with serving(**config) as context:
            await asyncio.wait_for(scene(context, f"ws://{context.stats.address}"), 120)

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
            await asyncio.wait_for(await client.ping(b"there?"), 60)
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
            await asyncio.wait_for(await client.ping(), 60)
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


def test_wrong_tokens_by_websocket_lock_the_host_out(serving: Serving) -> None:
    async def scene(context: Any, url: str) -> None:
        for number in range(WRONG_TOKENS + 1):
            async with connect(url) as client:
                answer = await ask(client, "hello", {"version": 1, "token": str(number)})
                assert answer["error"]["data"]["code"] == "denied"
        with pytest.raises((InvalidMessage, ConnectionClosed)):
            await connect(url)
        assert context.stats.details["refused"]["lockout"] == 1

    play(serving, scene, token="sesame")


@pytest.mark.parametrize("host", ["localhost:7600", "127.0.0.1", "[::1]:7600", "sim.example"])
def test_a_host_that_a_client_may_call(serving: Serving, host: str) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url, additional_headers={"Host": host}) as client:
            assert (await ask(client, "ping", 5))["result"] == 5

    play(serving, scene, allowed_hosts=("sim.example",))


def test_a_number_that_the_encoding_of_answers_does_not_have_is_refused(serving: Serving) -> None:
    """A client whose first message was msgpack may send JSON too, which has integers of any size; it is answered in msgpack."""

    async def scene(context: Any, url: str) -> None:
        async with connect(url) as client:
            await client.send(msgpack.packb({"id": 1, "method": "ping", "params": 2**64 - 1}))
            assert msgpack.unpackb(await client.recv())["result"] == 2**64 - 1
            await client.send(f'{{"id": 2, "method": "ping", "params": {2**64}}}')
            answer = msgpack.unpackb(await client.recv())
            assert answer["error"]["data"]["code"] == "bad_argument"
            assert "no msgpack encoding" in answer["error"]["message"]

    play(serving, scene)


@pytest.mark.parametrize("origin", [None, "null"])
def test_names_that_were_made_to_point_here_are_refused(serving: Serving, origin: Any) -> None:
    async def scene(context: Any, url: str) -> None:
        with pytest.raises(InvalidStatus) as caught:
            await connect(url, origin=origin, additional_headers={"Host": "evil.example:7600"})
        assert caught.value.response.status_code == 403
        assert b"allowed_hosts" in caught.value.response.body
        assert context.stats.details["refused"] == {"host": 1}

    play(serving, scene, allowed_origins=("null",))


def test_the_server_says_when_it_goes(serving: Serving) -> None:
    async def whole() -> None:
        async with serving() as context:
            client = await connect(f"ws://{context.stats.address}")
        with pytest.raises(ConnectionClosed):
            await client.recv()
        assert client.close_code == 1001

    asyncio.run(whole())


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://localhost:8000",
        "http://127.0.0.1",
        "null",
        "https://localhost",
        "http://localhost.evil.example",
    ],
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
        ({"allowed_origins": ["http://localhost:8000"]}, "http://localhost:8000"),
        ({"allowed_origins": ["http://127.0.0.1", "http://localhost:*"]}, "http://localhost:8000"),
        ({"allowed_origins": ["https://dive.example"]}, "https://dive.example"),
        ({"allowed_origins": ["*"]}, "null"),
    ],
)
def test_pages_that_may_connect(serving: Serving, config: dict[str, Any], origin: Any) -> None:
    async def scene(context: Any, url: str) -> None:
        async with connect(url, origin=origin) as client:
            assert (await ask(client, "ping", 5))["result"] == 5

    play(serving, scene, **{key: tuple(value) for key, value in config.items()})


def test_a_slow_reader_is_no_burden(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_small(monkeypatch)

    async def scene(context: Any, url: str) -> None:
        async with connect(url, max_queue=1) as client:
            await ask(client, "subscribe", {"pattern": "rov/imu"})
            for _ in range(100_000):
                context.emit("rov/imu")
                if context.stats.dropped > 300:
                    break
                await asyncio.sleep(0)
            assert context.stats.dropped > 300
            client.transport.abort()

    play(serving, scene, queue_samples=50)


# -- the page of docs/how-to/browser.md ---------------------------------------------------------------------------------------------


def test_the_protocol_steps_of_the_page_work(serving: Serving) -> None:
    page = (Path(__file__).parents[4] / "docs/how-to/browser.md").read_text()
    sent = [json.loads(text.replace("'", '"')) for text in re.findall(r"JSON\.stringify\((\{.*?\})\)\)", page)]
    assert {message["method"] for message in sent} >= {"subscribe", "command"}
    (origin,) = re.findall(r"--allow-origin (\S+)", page)
    assert f"Open `{origin}/depth.html`" in page

    async def scene(context: Any, url: str) -> None:
        async with connect(url, origin=websockets.Origin(origin)) as client:
            for message in sent:
                await client.send(json.dumps(message).replace("bluerov2/", "rov/"))
            seen: list[Any] = []
            while len(seen) < len(sent):
                seen.append(json.loads(await asyncio.wait_for(client.recv(), 60)))
            assert all("result" in message for message in seen), seen
            context.emit("rov/depth")
            assert "depth" in json.loads(await client.recv())["params"]["value"]

    play(serving, scene, allowed_origins=(origin,))


@pytest.mark.parametrize(
    ("host", "accept", "status"),
    [("127.0.0.1:7600", "text/html,*/*", 307), ("localhost:7600", "text/html", 307), ("[::1]:7600", "text/html", 307),
     ("127.0.0.1:7600", "text/html\r\nSec-Fetch-Site: none", 307), ("127.0.0.1:7600", "text/html\r\nSec-Fetch-Site: cross-site", 426),
     ("sim.example:7600", "text/html", 426), ("10.0.0.7:7600", "text/html", 426), ("127.0.0.1:7600", "*/*", 426)],
)  # fmt: skip
def test_a_browser_that_came_to_the_wrong_port_is_sent_to_the_page(
    serving: Serving, host: str, accept: str, status: int
) -> None:
    async def scene(context: Any, url: str) -> None:
        page = "http://127.0.0.1:7680/"
        context.scripts["world/status"] = lambda args: {
            "adapters": {
                "tcp": {"state": "running", "address": "127.0.0.1:7600"},
                "web": {"state": "running", "address": page},
            }
        }
        where, _, port = url.removeprefix("ws://").rpartition(":")
        reader, writer = await asyncio.open_connection(where, int(port))
        writer.write(f"GET / HTTP/1.1\r\nHost: {host}\r\nAccept: {accept}\r\n\r\n".encode())
        answer = (await reader.read()).decode()
        writer.close()
        assert answer.startswith(f"HTTP/1.1 {status} ")
        assert (f"Location: {page}\r\n" in answer) == (status == 307)
        assert page in answer.partition("\r\n\r\n")[2], "whoever reads it is told"

    play(serving, scene)


def test_who_comes_from_elsewhere_is_not_sent_to_an_address_of_this_machine(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwserver.adapter.connection.host_of", lambda address: "172.17.0.1")

    async def scene(context: Any, url: str) -> None:
        web = {"state": "running", "address": "http://127.0.0.1:7680/"}
        context.scripts["world/status"] = lambda args: {"adapters": {"web": web}}
        where, _, port = url.removeprefix("ws://").rpartition(":")
        reader, writer = await asyncio.open_connection(where, int(port))
        writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1:7600\r\nAccept: text/html\r\n\r\n")
        answer = (await reader.read()).decode()
        writer.close()
        assert answer.startswith("HTTP/1.1 426 ")
        assert "7680" not in answer

    play(serving, scene)
