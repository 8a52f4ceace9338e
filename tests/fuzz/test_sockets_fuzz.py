"""Mutated and raw traffic against both codecs and a whole connection: no exception, no endless events, nothing left behind.

`UWSERVER_FUZZ_SECONDS` bounds the run of every day, for each encoding; the marked slow one takes a million inputs.
"""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from dice import SECONDS, for_seconds, seed_of_the_day
from targets import texts
from uwserver_adapters.native.codec import Codec, JsonCodec, MsgpackCodec
from uwserver_adapters.native.messages import Malformed, Request
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_adapters.sockets.connection import Connection

from uwserver.adapter import connection
from uwserver.testing import FakeContext, Loopback
from uwserver.testing.codecs import read_all

MILLION = 1_000_000
FIRST = 1000
MESSAGES: list[Any] = [
    {"jsonrpc": "2.0", "id": 1, "method": "hello", "params": {"version": 1, "name": "pilot", "token": "x"}},
    {"jsonrpc": "2.0", "id": 2, "method": "describe", "params": {"pattern": "rov/*"}},
    {"jsonrpc": "2.0", "id": "s", "method": "subscribe", "params": {"pattern": "**", "rate_hz": 10.5, "fields": ["depth"], "delivery": "latest"}},
    {"jsonrpc": "2.0", "id": 3, "method": "subscribe", "params": {"pattern": "rov/imu", "delivery": "reliable"}},
    {"jsonrpc": "2.0", "id": 4, "method": "unsubscribe", "params": {"subscription": 1}},
    {"jsonrpc": "2.0", "id": 5, "method": "unsubscribe", "params": {"pattern": "**"}},
    {"jsonrpc": "2.0", "id": 6, "method": "command", "params": {"port": "rov/thrusters", "value": {"u": [0.1, -0.2, 1, -1, 0, 0, 1e-9, 0.5]}}},
    {"jsonrpc": "2.0", "method": "command", "params": {"port": "rov/thrusters", "value": {"u": [[0.0]] * 8}}},
    {"jsonrpc": "2.0", "id": 7, "method": "call", "params": {"service": "world/echo", "args": {"value": [None, True, {"a": "\u00e9\n\\\""}]}}},
    {"jsonrpc": "2.0", "id": 8, "method": "call", "params": {"service": "world/run_until", "args": {"t_s": 5.0}}},
    {"jsonrpc": "2.0", "id": 9, "method": "step", "params": {"n": 3}},
    {"jsonrpc": "2.0", "id": 10, "method": "cancel", "params": {"id": 8}},
    {"jsonrpc": "2.0", "id": -(2**63), "method": "ping", "params": [2**64 - 1, 1e300, -0.0, "x" * 300]},
]  # fmt: skip
TOKENS = [
    b"{", b"}", b"[", b"]", b'"', b"\\", b":", b",", b"\n", b"\r\n", b"null", b"NaN", b"1e999", b"-", b"\\ud800", b"\xff", b"\x00",
    b"\x00\x00\x00\x05", b"\x00\xff\xff\xff", b"\xff\xff\xff\xff", b"\x91" * 40, b"[" * 40, b"\xdd\xff\xff\xff\xff", b"\xdf\x00\x00\xff\xff",
    b"\xdb\xff\xff\xff\xff", b"\xc1", b"\xc7\x01\x05", b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00", b"GET ", b"9" * 400, b'"id":', b'"method":"step"',
]  # fmt: skip


def line(message: object) -> bytes:
    return json.dumps(message).encode() + b"\n"


def frame(message: object) -> bytes:
    body = msgpack.packb(message)
    return struct.pack(">I", len(body)) + body


ENCODINGS: dict[str, tuple[Callable[[], Codec], list[bytes]]] = {
    "json": (JsonCodec, [line(message) for message in MESSAGES]),
    "msgpack": (MsgpackCodec, [frame(message) for message in MESSAGES]),
}


class Inputs:
    """Traffic that is nearly right, reproducible from its seed."""

    def __init__(self, seed: int, seeds: list[bytes]) -> None:
        self._rng = np.random.default_rng(seed)
        self._seeds = seeds

    def below(self, bound: int) -> int:
        return int(self._rng.integers(bound))

    def next(self) -> bytes:
        if self.below(10) == 0:
            return self._rng.bytes(1 + self.below(200))
        data = bytearray(b"".join(self._seeds[self.below(len(self._seeds))] for _ in range(1 + self.below(3))))
        for _ in range(1 + self.below(4)):
            self._mutate(data)
        return bytes(data) or b"\n"

    def _mutate(self, data: bytearray) -> None:
        at, span = self.below(len(data) + 1), self.below(12)
        match self.below(6):
            case 0:
                data[at : at + 1] = bytes([self.below(256)])
            case 1:
                del data[at : at + span]
            case 2:
                data[at:at] = TOKENS[self.below(len(TOKENS))]
            case 3:
                data[at : at + span] = TOKENS[self.below(len(TOKENS))]
            case 4:
                data[at:at] = data[at : at + span] * (1 + self.below(4))
            case _:
                if at < len(data):
                    data[at] ^= 1 << self.below(8)

    def pieces(self, data: bytes) -> Iterator[bytes]:
        while data:
            size = 1 + self.below(len(data)) if self.below(2) else len(data)
            yield data[:size]
            data = data[size:]


def check_codec_input(make: Callable[[], Codec], inputs: Inputs, follower: bytes) -> None:
    data = inputs.next()
    events = read_all(make(), [data], None)
    assert all(isinstance(event, Request | Malformed) for event in events)
    in_pieces = read_all(make(), list(inputs.pieces(data)), None)
    assert texts(in_pieces) == texts(events), f"pieces matter for {data!r}"
    if make is JsonCodec:
        assert read_all(make(), [data, b"\n", follower], None)[-1] == Request(2, "describe", {"pattern": "rov/*"}), data


def run_codecs(encoding: str, seed: int, go_on: Callable[[int], bool]) -> int:
    make, seeds = ENCODINGS[encoding]
    inputs = Inputs(seed, seeds)
    count = 0
    while go_on(count):
        check_codec_input(make, inputs, seeds[1])
        count += 1
    return count


class Theatre:
    """An adapter that does not listen; its peers die in every way."""

    def __init__(self) -> None:
        self.context = FakeContext()
        self.adapter = SocketsAdapter(
            SocketsAdapter.Config(port=0, queue_samples=4, max_requests_per_s=10**9), self.context
        )
        self.detach = self.context.attach(self.adapter.service.fanout)

    async def act(self, inputs: Inputs) -> None:
        transport = Loopback(Connection(self.adapter.service, self.adapter.config, self.adapter.peers))
        if inputs.below(4) == 0:
            transport.stall()
        for piece in inputs.pieces(inputs.next()):
            transport.feed(piece)
        self.context.emit()
        end = inputs.below(3)
        if end == 0:
            transport.feed_eof()
        elif end == 1:
            await asyncio.sleep(0)
        self.context.emit()
        transport.drain()
        transport.die()
        await asyncio.sleep(0)
        self.context.calls.clear()
        self.context.commands.clear()
        self.context.described.clear()
        for answer in transport.written.split(b"\n", 1)[:1]:
            assert not answer.startswith(b"{") or json.loads(answer)

    def check(self, caplog: pytest.LogCaptureFixture) -> None:
        assert self.context.stats.peers == 0
        assert self.adapter.service.fanout.sessions == {}
        assert self.adapter.service.fanout._ports == {}
        assert self.context.joined == []
        faults = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
        assert not faults, "a fault of ours was logged"


async def run_connections(encoding: str, seed: int, go_on: Callable[[int], bool], theatre: Theatre) -> int:
    loop = asyncio.get_running_loop()
    broken: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, problem: broken.append(problem))
    inputs = Inputs(seed, ENCODINGS[encoding][1])
    count = 0
    while go_on(count):
        await theatre.act(inputs)
        assert not broken, broken
        count += 1
    await asyncio.sleep(0.01)
    return count


@pytest.fixture(autouse=True)
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)
    monkeypatch.setattr(connection, "LINGER_S", 0.0)


# A fixed seed makes the first inputs the same everywhere; that of the day looks further.
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_codecs(encoding: str) -> None:
    assert run_codecs(encoding, 1, lambda count: count < FIRST) == FIRST
    run_codecs(encoding, seed_of_the_day(), for_seconds(SECONDS))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_connections(encoding: str, caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        theatre = Theatre()
        assert await run_connections(encoding, 1, lambda count: count < FIRST, theatre) == FIRST
        await run_connections(encoding, seed_of_the_day(), for_seconds(SECONDS), theatre)
        theatre.check(caplog)

    asyncio.run(scene())


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_million_inputs(encoding: str, caplog: pytest.LogCaptureFixture) -> None:
    seed = seed_of_the_day()
    run_codecs(encoding, seed, lambda count: count < MILLION // 4)

    async def scene() -> None:
        theatre = Theatre()
        await run_connections(encoding, seed, lambda count: count < MILLION // 4, theatre)
        theatre.check(caplog)

    asyncio.run(scene())
