"""WebSocket on the adapter's port, in bytes made by hand: handshakes, broken frames, fuzz."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from uwserver_adapters.native import routes
from uwserver_adapters.native.codec import Control
from uwserver_adapters.native.messages import Malformed, Request
from uwserver_adapters.native.websocket import FRAMES, Handshake, allows

from uwserver.adapter import connection
from uwserver.testing.codecs import read_all

KEY = "dGhlIHNhbXBsZSBub25jZQ=="
REQUEST = (
    f"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {KEY}\r\n"
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


def opened() -> Any:
    handshake = Handshake((), ())
    assert handshake.receive(REQUEST + b"rest") == b"rest"
    assert handshake.codec is not None
    return handshake.codec


@pytest.mark.parametrize("small", [masked(10, b""), masked(0, b"", fin=False), masked(0, b"x", fin=False)])
def test_frames_that_are_no_message_do_not_keep_others_waiting(small: bytes) -> None:
    """An adapter looks at the time between two events only, so there is one after some frames, whatever they are."""
    codec, many = opened(), 1000
    codec.receive(masked(1, b'{"id":1,"method":"ping"', fin=False) + small * many)
    steps = 0
    while codec.next_event() is not None:
        steps += 1
    assert steps == (many + 1) // FRAMES


@pytest.mark.parametrize("size", [1, 125, 126, 65535, 65536, 500_000])
def test_a_frame_of_any_size_is_taken_whole_and_nothing_of_the_next(size: int) -> None:
    body = b'{"id":1,"method":"%s"}' % (b"x" * size)
    head = bytes((129, 255)) + len(body).to_bytes(8, "big")
    codec = opened()
    codec.receive(head + bytes(4) + body + masked(9, b"hi") + masked(1, b'{"id":2,"method":"ping"}')[:5])
    assert codec.next_event() == Request(1, "x" * size)
    assert codec.next_event() == Control(b"\x8a\x02hi", False)
    assert codec.next_event() is None
    codec.receive(masked(1, b'{"id":2,"method":"ping"}')[5:])
    assert codec.next_event() == Request(2, "ping")


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
        talker.transport.feed(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
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
        (b"GET /" + b"x" * 20_000, b"HTTP/1.1 4"),
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
    real = routes.encoded_sample
    monkeypatch.setattr(routes, "encoded_sample", lambda *args: made.append(1) or real(*args))

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
    for _ in range(600):
        data = bytearray(b"".join(good[draw.integers(len(good))] for _ in range(draw.integers(1, 5))))
        for _ in range(draw.integers(4)):
            data[draw.integers(len(data))] = draw.integers(256)
        cut = int(draw.integers(len(data)))
        whole, pieces = opened(), opened()
        first = [e for e in read_all(whole, [bytes(data)], None) if isinstance(e, Request | Malformed)]
        second = read_all(pieces, [bytes(data[:cut]), bytes(data[cut:])], None)
        assert repr(first) == repr([e for e in second if isinstance(e, Request | Malformed)]), bytes(data)


def test_patterns_of_origins() -> None:
    assert allows(("http://a:*",), "http://a:80")
    assert not allows(("http://a:*",), "http://a:80.evil")
    assert not allows(("http://a:*",), "http://a")
    assert not allows((), "http://a")
