"""A peer of the `sockets` adapter without a socket: says requests, hears messages, reads only when the test wants it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import ssl
import struct
import subprocess
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_adapters.sockets.connection import Connection, SocketsConfig

from uwserver.adapter import connection
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
        self.connection = Connection(adapter.service, adapter.config, adapter.peers)
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
        self.detach = self.context.attach(self.adapter.service.fanout)

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


@contextlib.asynccontextmanager
async def run_adapter(**config: Any) -> AsyncIterator[FakeContext]:
    context = FakeContext()
    ready = asyncio.Event()
    task = asyncio.create_task(SocketsAdapter(SocketsConfig(**({"port": 0} | config)), context).run(ready))
    done, _ = await asyncio.wait(
        [task, asyncio.create_task(ready.wait())], timeout=60, return_when=asyncio.FIRST_COMPLETED
    )
    assert done
    if task.done():
        task.result()
    try:
        yield context
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


@pytest.fixture
def serving() -> Callable[..., Any]:
    """The adapter on a real socket: ``async with serving(**config) as context``."""
    return run_adapter


def make_certificate(folder: Path, name: str) -> tuple[str, str]:
    """A certificate signed by itself, for 127.0.0.1: file names of certificate and key."""
    cert, key = folder / f"{name}.pem", folder / f"{name}.key"
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    command += [
        "-subj",
        f"/CN={name}",
        "-addext",
        "subjectAltName=IP:127.0.0.1",
        "-keyout",
        str(key),
        "-out",
        str(cert),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return str(cert), str(key)


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Of the server: file names of certificate and key."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate")
    return make_certificate(tmp_path_factory.mktemp("tls"), "server")


@pytest.fixture(scope="session")
def client_certificate(tmp_path_factory: pytest.TempPathFactory, certificate: tuple[str, str]) -> tuple[str, str]:
    """Of a client."""
    return make_certificate(tmp_path_factory.mktemp("tls"), "client")


@pytest.fixture
def trusting(certificate: tuple[str, str]) -> ssl.SSLContext:
    """The TLS of a client that trusts the server's certificate."""
    return ssl.create_default_context(cafile=certificate[0])
