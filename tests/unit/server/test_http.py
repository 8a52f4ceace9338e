"""/health and /metrics over HTTP: statuses and texts, and peers that are slow, silent or hostile."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import pytest

from uwserver.adapter import AdapterStats, CannotListen, Refusals
from uwserver.server import http
from uwserver.testing.adapter_kit import Traces, assert_no_traces

STATUS: dict[str, Any] = {"failure": "", "tick": 7}


def no_status() -> dict[str, Any]:
    raise RuntimeError("our own fault")


@contextlib.asynccontextmanager
async def server(
    status: Callable[[], dict[str, Any]] = lambda: STATUS, metrics: Callable[[], bytes] = lambda: b"ticks 7\n"
) -> AsyncIterator[int]:
    async with http.serve_http("127.0.0.1", 0, status, metrics) as port:
        yield port


async def said(port: int, data: bytes, eof: bool = False) -> bytes:
    """Everything that the server answers until it closes."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(data)
    if eof:
        writer.write_eof()
    try:
        return await reader.read()
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


async def asked(port: int, path: str, method: str = "GET", version: str = "1.1") -> tuple[int, dict[str, str], bytes]:
    answer = await said(port, f"{method} {path} HTTP/{version}\r\nHost: localhost\r\n\r\n".encode())
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    return int(first.split()[1]), dict(line.split(": ", 1) for line in lines), body


def run(scene: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        before = Traces.now()
        await asyncio.wait_for(scene(), 20)
        await assert_no_traces(before, "the HTTP server")

    asyncio.run(bounded())


@pytest.mark.parametrize("version", ["1.1", "1.0"])
def test_statuses_and_texts(version: str):
    async def scene() -> None:
        async with server() as port:
            code, headers, body = await asked(port, "/health", version=version)
            assert (code, headers["Content-Type"], json.loads(body)) == (200, "application/json", STATUS)
            assert headers["Connection"] == "close"
            code, headers, body = await asked(port, "/metrics")
            assert (code, headers["Content-Type"]) == (200, "text/plain; version=0.0.4; charset=utf-8")
            assert body == b"ticks 7\n"
            for path in ("/", "/metrics/", "/health?verbose", "/../health"):
                code, headers, body = await asked(port, path)
                assert (code, body) == (404, b"there are /health and /metrics here\n")

    run(scene)


def test_after_a_failure_it_is_not_well():
    async def scene() -> None:
        async with server(lambda: STATUS | {"failure": "diverged"}) as port:
            code, _, body = await asked(port, "/health")
            assert (code, json.loads(body)["failure"]) == (503, "diverged")

    run(scene)


def test_head_has_the_head_alone():
    async def scene() -> None:
        async with server() as port:
            code, headers, body = await asked(port, "/metrics", "HEAD")
            assert (code, headers["Content-Length"], body) == (200, "8", b"")

    run(scene)


def test_nothing_becomes_a_websocket():
    async def scene() -> None:
        async with server() as port:
            upgrade = (
                b"GET %s HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
            )
            assert (await said(port, upgrade % b"/")).startswith(b"HTTP/1.1 404")
            assert (await said(port, upgrade % b"/health")).startswith(b"HTTP/1.1 200")

    run(scene)


def test_a_fault_of_ours_is_told_and_logged_and_the_next_is_served(caplog: pytest.LogCaptureFixture):
    async def scene() -> None:
        async with server(no_status) as port:
            code, _, body = await asked(port, "/health")
            assert (code, body) == (500, b"the server failed to answer: see its log\n")
            assert (await asked(port, "/metrics"))[0] == 200

    run(scene)
    assert "our own fault" in caplog.text


@pytest.mark.parametrize(
    "junk",
    [
        b"\x00" * 100,
        b"\xff\xfe\r\n\r\n",
        b"hello\r\n\r\n",
        b"GET /health\r\n\r\n",
        b"GET /health HTTP/9.9\r\n\r\n",
        b"GET /health HTTP/1.1\r\nno header\r\n\r\n",
        b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\n\r\n",
        b"GET /health HTTP/1.1\r\n" + b"x: " + b"y" * 100_000 + b"\r\n\r\n",
        b"GET /health HTTP/1.1\r\n" + b"x: y\r\n" * 10_000 + b"\r\n",
        b"{" * 1_000_000,
    ],
)
def test_nonsense_ends_at_once_and_leaves_no_word_in_the_log(junk: bytes, caplog: pytest.LogCaptureFixture):
    async def scene() -> None:
        async with server() as port:
            answer = await said(port, junk, eof=True)
            assert not answer.startswith(b"HTTP/1.1 2")
            assert (await asked(port, "/health"))[0] == 200

    with caplog.at_level(logging.INFO):
        run(scene)
    assert caplog.text == ""


@pytest.mark.parametrize("begun", [b"", b"GET /hea", b"GET /health HTTP/1.1\r\nHost: he"])
def test_who_does_not_finish_its_request_is_ended(begun: bytes, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(http, "REQUEST_TIMEOUT_S", 0.05)

    async def scene() -> None:
        async with server() as port:
            assert await said(port, begun) == b""

    run(scene)


def test_who_does_not_read_is_ended(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(http, "REQUEST_TIMEOUT_S", 0.05)
    body = b"x" * (16 << 20)

    async def scene() -> None:
        async with server(metrics=lambda: body) as port:
            with socket.create_connection(("127.0.0.1", port)) as peer:
                before = len(Traces.now().files)
                peer.send(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")
                while len(Traces.now().files) == before:
                    await asyncio.sleep(0.001)
                while len(Traces.now().files) > before:
                    await asyncio.sleep(0.001)  # its connection ends without being read
            assert (await asked(port, "/health"))[0] == 200

    run(scene)


def test_the_end_waits_for_nobody():
    async def scene() -> None:
        async with server() as port:
            peers = [await asyncio.open_connection("127.0.0.1", port) for _ in range(5)]
            peers[0][1].write(b"GET /heal")
            await asyncio.sleep(0.05)
        for reader, writer in peers:
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            writer.close()

    run(scene)


def test_an_address_in_use_is_said():
    async def scene() -> None:
        async with server() as port:
            with pytest.raises(CannotListen, match=str(port)):
                async with http.serve_http("127.0.0.1", port, lambda: STATUS, lambda: b""):
                    pass

    run(scene)


def test_no_head_takes_long_and_a_bare_line_feed_is_refused():
    service = http.Service(lambda: STATUS, lambda: b"", (), Refusals("x", AdapterStats(), time.monotonic))
    for value, status in ((" " * 900 + "\n", b"400"), ("a\nHost: b", b"400"), ("a" + " " * 15_000 + "b", b"200")):
        took_s = []
        for _ in range(5):  # something else may be done meanwhile, as a collection of garbage
            before = time.process_time()
            assert (
                service.answer(f"GET /health HTTP/1.1\r\nx:{value}\r\nHost: \t localhost ".encode()).split()[1]
                == status
            )
            took_s.append(time.process_time() - before)
        assert min(took_s) < 0.05


@pytest.mark.parametrize("name", ["Host", "host", "HOST", "hOsT"])
def test_a_name_that_is_not_known_is_refused_however_its_header_is_written(name: str):
    service = http.Service(lambda: STATUS, lambda: b"", (), Refusals("x", AdapterStats(), time.monotonic))
    assert service.answer(f"GET /health HTTP/1.1\r\n{name}: evil.example".encode()).split()[1] == b"421"
    assert service.answer(f"GET /health HTTP/1.1\r\n{name}: localhost".encode()).split()[1] == b"200"
