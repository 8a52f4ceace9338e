"""A peer of the `sockets` adapter without a socket: says requests, hears messages, reads only when the test wants it."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Callable
from typing import Any

import msgpack
import pytest
from uwserver_adapters.sockets import SocketsAdapter, connection
from uwserver_adapters.sockets.connection import Connection

from uwserver.testing import FakeContext, Loopback


def packed(message: object, encoding: str = "json") -> bytes:
    """One framed message, made by other encoders than the adapter's."""
    if encoding == "json":
        return json.dumps(message).encode() + b"\n"
    body = msgpack.packb(message)
    return struct.pack(">I", len(body)) + body


def unpacked(data: bytes, encoding: str = "json") -> list[dict[str, Any]]:
    """All framed messages, which must be complete."""
    if encoding == "json":
        assert data == b"" or data.endswith(b"\n")
        return [json.loads(line, parse_constant=_refuse_constant) for line in data.splitlines()]
    messages = []
    while data:
        (length,) = struct.unpack_from(">I", data)
        messages.append(msgpack.unpackb(data[4 : 4 + length]))
        data = data[4 + length :]
    return messages


def _refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


class Talker:
    """One peer in memory."""

    def __init__(self, adapter: SocketsAdapter, encoding: str = "json") -> None:
        self.encoding = encoding
        self.connection = Connection(adapter)
        self.transport = Loopback(self.connection)
        self.ids = 0

    def send(self, message: object) -> None:
        self.transport.feed(packed(message, self.encoding))

    def heard(self) -> list[dict[str, Any]]:
        return unpacked(self.transport.take(), self.encoding)

    def samples(self) -> list[dict[str, Any]]:
        return [message["params"] for message in self.heard() if message.get("method") == "sample"]

    async def ask(self, method: str, params: object = None) -> dict[str, Any]:
        """Send a request and return its reply."""
        self.ids += 1
        self.send({"jsonrpc": "2.0", "id": self.ids, "method": method, "params": params})
        for _ in range(3):
            replies = [message for message in self.heard() if message.get("id") == self.ids]
            if replies:
                (reply,) = replies
                return reply
            await asyncio.sleep(0)
        raise AssertionError(f"no reply to {method}")

    async def result(self, method: str, params: object = None) -> Any:
        return (await self.ask(method, params))["result"]

    async def fault(self, method: str, params: object = None) -> tuple[str, str]:
        """Code and text of the refusal."""
        error = (await self.ask(method, params))["error"]
        return error["data"]["code"], error["message"]


class Stage:
    """A context, an adapter that does not listen, and its peers."""

    def __init__(self, **config: Any) -> None:
        self.context = FakeContext()
        self.adapter = SocketsAdapter(SocketsAdapter.Config(port=0, **config), self.context)
        self.detach = self.context.attach(self.adapter.fanout)

    def talker(self, encoding: str = "json") -> Talker:
        return Talker(self.adapter, encoding)


@pytest.fixture(autouse=True)
def _no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)


@pytest.fixture(autouse=True)
def _no_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine must not split a test's requests over several turns; the tests of turns set their own."""
    monkeypatch.setattr(connection, "TURN_S", 1000.0)


@pytest.fixture
def stage() -> Callable[..., Stage]:
    """Makes a Stage; call it within the loop."""
    return Stage


@pytest.fixture
def pack() -> Callable[..., bytes]:
    return packed


@pytest.fixture
def unpack() -> Callable[..., list[dict[str, Any]]]:
    return unpacked
