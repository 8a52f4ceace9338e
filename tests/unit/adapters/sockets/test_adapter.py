"""The adapter on a real socket of the loopback interface."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import re
import socket
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from kernel_buffers import keep_small
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_adapters.sockets.connection import SocketsConfig

from uwserver.adapter import CannotListen, accepting
from uwserver.testing import FakeContext, TcpPeer

Serving = Callable[..., Any]


async def line(peer: TcpPeer) -> dict[str, Any]:
    return json.loads(await asyncio.wait_for(peer.reader.readline(), 60))


async def ask(peer: TcpPeer, method: str, params: object = None) -> dict[str, Any]:
    await peer.send(json.dumps({"id": 1, "method": method, "params": params}).encode() + b"\n")
    while (message := await line(peer)).get("id") != 1:
        pass
    return message


def test_two_clients_in_two_encodings(serving: Serving, pack: Callable[..., bytes]) -> None:
    async def scene() -> None:
        async with serving() as context:
            assert re.fullmatch(r"127\.0\.0\.1:\d+", context.stats.address)
            lines, frames = await TcpPeer.connect(context), await TcpPeer.connect(context)
            assert (await ask(lines, "subscribe", {"pattern": "rov/depth"}))["result"]["ports"] == ["rov/depth"]
            await frames.send(pack({"id": 1, "method": "subscribe", "params": {"pattern": "rov/imu"}}, "msgpack"))
            length = int.from_bytes(await frames.reader.readexactly(4), "big")
            assert msgspec.msgpack.decode(await frames.reader.readexactly(length))["result"]["ports"] == ["rov/imu"]
            assert context.stats.peers == 2
            context.emit()
            assert (await line(lines))["params"]["port"] == "rov/depth"
            length = int.from_bytes(await frames.reader.readexactly(4), "big")
            assert msgspec.msgpack.decode(await frames.reader.readexactly(length))["params"]["port"] == "rov/imu"
            assert context.stats.samples_sent == 2
            await lines.close()
            await frames.close()

    asyncio.run(scene())


def test_half_close_as_nc_does_it(serving: Serving) -> None:
    async def scene() -> None:
        async with serving() as context:
            peer = await TcpPeer.connect(context)
            await peer.send(b'{"id":1,"method":"step"}\n')
            peer.writer.write_eof()
            assert json.loads(await asyncio.wait_for(peer.reader.read(), 60))["id"] == 1
            await peer.close()

    asyncio.run(scene())


def test_a_client_that_never_reads_delays_no_other(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_small(monkeypatch)

    async def scene() -> None:
        async with serving(queue_samples=50) as context:
            never, reads = await TcpPeer.connect(context), await TcpPeer.connect(context)
            for peer in (never, reads):
                await ask(peer, "subscribe", {"pattern": "rov/imu"})
            seen = 0
            while context.stats.dropped < 300:
                context.emit("rov/imu")
                assert (await line(reads))["params"]["seq"] == seen
                seen += 1
                assert seen < 100_000, "nothing was ever dropped"
            assert context.stats.peers == 2
            for peer in (never, reads):
                await peer.close()

    asyncio.run(scene())


def test_the_last_words_reach_a_client_that_goes_on_sending(serving: Serving) -> None:
    async def scene() -> None:
        async with serving(token="sesame") as context:
            peer = await TcpPeer.connect(context)
            for _ in range(50):
                with contextlib.suppress(OSError):
                    await peer.send(b"x" * 1000 + b"\n")
            text = await asyncio.wait_for(peer.reader.read(), 60)
            assert b"too many messages" in text
            await peer.close()

    asyncio.run(scene())


def test_clients_are_closed_at_the_end(serving: Serving) -> None:
    async def scene() -> None:
        async with serving() as context:
            peer = await TcpPeer.connect(context)
            await ask(peer, "ping")
        assert await asyncio.wait_for(peer.reader.read(), 60) == b""
        assert context.stats.peers == 0
        assert context.stats.state == "stopped"
        await peer.close()

    asyncio.run(scene())


def test_a_port_in_use_says_which_and_what_to_do(serving: Serving) -> None:
    async def scene() -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            with pytest.raises(CannotListen) as caught:
                async with serving(port=port):
                    pass
        assert str(port) in str(caught.value)
        assert "port = 0" in str(caught.value)

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("code", "phrase"),
    [(errno.EACCES, "above 1023"), (errno.EADDRNOTAVAIL, "no such address"), (errno.EIO, "cannot listen")],
)
def test_other_faults_of_the_address(monkeypatch: pytest.MonkeyPatch, code: int, phrase: str) -> None:
    async def scene() -> None:
        async def refuse(*_: object, **__: object) -> None:
            raise OSError(code, "refused by the test")

        monkeypatch.setattr(accepting, "_bound", refuse)
        with pytest.raises(CannotListen, match=phrase):
            await SocketsAdapter(SocketsConfig(port=80), FakeContext()).run(asyncio.Event())

    asyncio.run(scene())


def test_an_open_address_makes_a_token_and_says_how_to_connect(
    serving: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene() -> None:
        async with serving(bind="0.0.0.0") as context:
            port = context.stats.address.rpartition(":")[2]
            found = re.search(r"uwclient --host 127\.0\.0\.1 --port (\d+) --token (\S+) topics", caplog.text)
            assert found is not None
            assert found[1] == port
            assert len(found[2]) >= 32
            peer = await TcpPeer.connect(context)
            assert (await ask(peer, "ping"))["error"]["data"]["code"] == "denied"
            assert "result" in await ask(peer, "hello", {"version": 1, "token": found[2]})
            await peer.close()

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("bind", "is_open"),
    [
        ("127.0.0.1", False),
        ("127.1.2.3", False),
        ("::1", False),
        ("localhost", False),
        ("0.0.0.0", True),
        ("::", True),
        ("example", True),
    ],
)
def test_what_needs_a_token(bind: str, is_open: bool) -> None:
    async def scene() -> None:
        adapter = SocketsAdapter(SocketsConfig(bind=bind), FakeContext())
        assert (adapter.service.token is not None) == is_open

    asyncio.run(scene())


def test_a_given_token_is_not_printed(serving: Serving, caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        async with serving(bind="0.0.0.0", token="open sesame"):
            pass

    asyncio.run(scene())
    assert "sesame" not in caplog.text


@pytest.mark.parametrize(
    "table",
    [
        {"port": -1},
        {"port": 65536},
        {"bind": ""},
        {"token": ""},
        {"queue_samples": 0},
        {"max_clients": 0},
        {"hello_timeout_s": 0},
        {"prt": 1},
    ],
)
def test_bad_tables_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"kind": "sockets"} | table, SocketsConfig)
