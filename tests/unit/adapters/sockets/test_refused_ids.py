"""Whoever sends what cannot be decoded learns which of its requests that was, by every transport."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import pytest
from uwserver_adapters.native.codec import FRAME_LIMIT, LINE_LIMIT
from websockets.asyncio.client import connect

Serving = Callable[..., Any]
DEEP = "[" * 100 + "]" * 100
JSON = {
    "half a surrogate pair": (b'{"id":7,"method":"ping","params":"\\ud800"}', "parse_error"),
    "NaN": (b'{"method":"ping","params":{"id":1,"x":[NaN]},"id":7}', "parse_error"),
    "depth": (b'{"id":7,"method":"ping","params":%s}' % DEEP.encode(), "invalid_request"),
    "exponents": (b'{"id":7,"method":"ping","params":[%s1]}' % (b"1e300," * 5000), "too_large"),
    "two ids": (b'{"id":7,"method":"ping","params":NaN,"id":8}', "parse_error"),
    "a batch in it": (b'{"id":7,"method":["ping"]}', "invalid_request"),
}
MSGPACK = {
    "an extension": (msgpack.packb({"id": 7, "method": "ping", "params": msgpack.ExtType(5, b"x")}), "invalid_request"),
    "depth": (msgpack.packb({"id": 7, "params": json.loads(DEEP)}), "invalid_request"),
    "many values": (msgpack.packb({"id": 7, "params": [0] * 10_000}), "invalid_request"),
    "no UTF-8": (b"\x82\xa1a\xa1\xff\xa2id\x07", "parse_error"),
}
TOO_LONG_JSON = b'{"id":7,"method":"' + b"x" * LINE_LIMIT + b'"}'
TOO_LONG_MSGPACK = msgpack.packb({"id": 7, "params": b"x" * FRAME_LIMIT})


async def by_tcp(context: Any, body: bytes, encoding: str) -> Any:
    host, _, port = context.stats.address.rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        writer.write(body + b"\n" if encoding == "json" else struct.pack(">I", len(body)) + body)
        if encoding == "json":
            return json.loads(await reader.readline())
        (length,) = struct.unpack(">I", await reader.readexactly(4))
        return msgpack.unpackb(await reader.readexactly(length))
    finally:
        writer.close()


async def by_websocket(context: Any, body: bytes, encoding: str) -> Any:
    async with connect(f"ws://{context.stats.address}") as client:
        await client.send(body.decode() if encoding == "json" else body)
        answer = await client.recv()
        return json.loads(answer) if isinstance(answer, str) else msgpack.unpackb(answer)


@contextlib.contextmanager
def admitted(context: Any) -> Iterator[Callable[..., Any]]:
    """A client by UDP: sends bodies, and gives the answer to the last."""
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setblocking(False)
        host, _, port = context.stats.details["udp"].rpartition(":")
        sock.connect((host, int(port)))

        async def ask(*bodies: bytes) -> Any:
            for body in bodies:
                await loop.sock_sendall(sock, body)
            answer = await loop.sock_recv(sock, 1 << 16)
            return json.loads(answer) if answer.startswith(b"{") else msgpack.unpackb(answer)

        yield ask


async def enter(ask: Callable[..., Any]) -> None:
    hello = {"id": 1, "method": "hello", "params": {"version": 1}}
    hello["params"] |= await ask(json.dumps(hello).encode())  # type: ignore[operator]
    assert "result" in await ask(json.dumps(hello).encode())


async def by_datagram(context: Any, body: bytes, encoding: str) -> Any:
    with admitted(context) as ask:
        await enter(ask)
        return await ask(body)


WAYS = {"tcp": by_tcp, "websocket": by_websocket, "udp": by_datagram}
CASES = [
    *((way, "json", name, *case) for way in WAYS for name, case in JSON.items()),
    *((way, "msgpack", name, *case) for way in WAYS for name, case in MSGPACK.items()),
    *((way, "json", "too long", TOO_LONG_JSON, "too_large") for way in ("tcp", "websocket")),
    ("tcp", "msgpack", "too long", TOO_LONG_MSGPACK, "too_large"),
    ("websocket", "msgpack", "too long", TOO_LONG_MSGPACK[: LINE_LIMIT + 100], "too_large"),
]


@pytest.mark.parametrize(("way", "encoding", "name", "body", "code"), CASES, ids=[" ".join(case[:3]) for case in CASES])
def test_the_refusal_has_the_id(serving: Serving, way: str, encoding: str, name: str, body: bytes, code: str) -> None:
    async def whole() -> None:
        async with serving(udp_port=0) as context:
            answer = await asyncio.wait_for(WAYS[way](context, body, encoding), 120)
            assert (answer["id"], answer["error"]["data"]["code"]) == (7, code)

    asyncio.run(whole())


def test_a_second_request_under_the_id_of_an_unfinished_one_is_refused_under_it(serving: Serving) -> None:
    async def whole() -> None:
        async with serving(udp_port=0) as context:
            context.held.add("world/run_until")
            call = b'{"id":7,"method":"call","params":{"service":"world/run_until","args":{"t_s":5}}}'
            with admitted(context) as ask:
                await enter(ask)
                answer = await ask(call, call)
            assert (answer["id"], answer["error"]["data"]["where"]) == (7, "id")

    asyncio.run(whole())
