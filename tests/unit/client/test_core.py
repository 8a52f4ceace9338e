"""The wire core: framing whole and byte by byte, garbage, order of replies."""

from __future__ import annotations

import contextlib
import itertools
import json
import struct
import sys

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uwclient.core import ANSWER_LIMIT, FRAME_LIMIT, LINE_LIMIT, JsonLines, MsgpackFrames, Reply, Wire, framing
from uwclient.errors import CallRefused, ProtocolError, UwError
from uwclient.ports import Event, Progress, Sample
from uwclient.session import time_reached
from uwclient_fake_server import sample

SAMPLE = {"jsonrpc": "2.0", "method": "sample", "params": sample("rov/imu", 2)}
MESSAGES = [
    SAMPLE,
    {"jsonrpc": "2.0", "id": 2, "result": {"ports": ["rov/imu"], "text": "Grüße 水 🐟"}},
    {"jsonrpc": "2.0", "id": 1, "error": {"code": -32602, "message": "no", "data": {"code": "busy", "where": "w"}}},
    {"jsonrpc": "2.0", "method": "progress", "params": {"id": 5, "fraction": 0.4, "t_ns": 7}},
    {"jsonrpc": "2.0", "method": "event", "params": {"event": "paused", "tick": 3, "t_ns": 9, "text": "by x"}},
]


def stream(encoding: str, newline: bytes = b"\n") -> bytes:
    if encoding == "json":
        return b"".join(json.dumps(message, ensure_ascii=False).encode() + newline for message in MESSAGES)
    bodies = [msgpack.packb(message) for message in MESSAGES]
    return b"".join(struct.pack(">I", len(body)) + body for body in bodies)


def check(messages: list[object]) -> None:
    first, second, third, fourth, fifth = messages
    assert isinstance(first, Sample)
    assert first.port == "rov/imu"
    assert first.vector("f_S") == pytest.approx((0.2, 0.0, -9.81))
    assert second == Reply(2, {"ports": ["rov/imu"], "text": "Grüße 水 🐟"})
    assert isinstance(third, Reply)
    assert third.error is not None
    assert (third.id, third.error.code, third.error.where, third.error.message) == (1, "busy", "w", "no")
    assert fourth == Progress(5, 0.4, 7)
    assert fifth == Event("paused", 3, 9, "by x")


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("piece", [1, 2, 3, 7, 64, 1 << 20])
def test_messages_arrive_in_pieces_of_any_size(encoding: str, piece: int) -> None:
    data = stream(encoding)
    wire = Wire(encoding)
    messages = [m for start in range(0, len(data), piece) for m in wire.receive(data[start : start + piece])]
    check(messages)


def test_crlf_and_empty_lines() -> None:
    check(Wire().receive(b"\r\n" + stream("json", b"\r\n") + b"\n"))


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@given(cuts=st.lists(st.integers(0, 900), max_size=20))
def test_messages_split_anywhere(encoding: str, cuts: list[int]) -> None:
    data = stream(encoding)
    wire = Wire(encoding)
    messages: list[object] = []
    bounds = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for start, end in itertools.pairwise(bounds):
        messages += wire.receive(data[start:end])
    check(messages)


@pytest.mark.parametrize(
    "garbage",
    [
        b"HTTP/1.1 400 Bad Request\r\n",
        b"\xff\xfe\x00garbage\n",
        b"[1,2,3]\n",
        b"42\n",
        b"{}\n",
        b'{"id":true,"result":1}\n',
        b'{"method":"sample","params":{"port":"x"}}\n',
        b'{"method":"sample","params":null}\n',
        b'{"method":"event","params":{"event":7}}\n',
        b'{"id":1,"error":"no"}\n',
        b"[" * 100_000 + b"\n",
    ],
)
def test_garbage_is_a_protocol_error(garbage: bytes) -> None:
    with pytest.raises(ProtocolError):
        Wire().receive(garbage)


@given(st.binary(max_size=300))
def test_any_bytes_are_messages_or_a_protocol_error(data: bytes) -> None:
    for encoding in ("json", "msgpack"):
        with contextlib.suppress(ProtocolError):
            assert isinstance(Wire(encoding).receive(data + b"\n"), list)


def test_binary_garbage_is_a_protocol_error() -> None:
    with pytest.raises(ProtocolError, match="check host and port"):
        Wire("msgpack").receive(b"SSH-2.0-OpenSSH")
    with pytest.raises(ProtocolError, match="no msgpack"):
        Wire("msgpack").receive(struct.pack(">I", 3) + b"\xc1\xc1\xc1")


def test_an_endless_line_is_refused() -> None:
    lines = JsonLines()
    chunk = b"x" * (4 << 20)
    for _ in range(4):
        assert lines.feed(chunk) == []
    with pytest.raises(ProtocolError, match=str(ANSWER_LIMIT)):
        lines.feed(chunk)


def test_restart_forgets_an_unfinished_message() -> None:
    wire = Wire()
    assert wire.receive(b'{"jsonrpc":"2.0","id":1,"res') == []
    wire.restart()
    assert wire.receive(b'{"jsonrpc":"2.0","id":2,"result":0}\n') == [Reply(2, 0)]


@pytest.mark.parametrize("result", [0, False, None, [], "", {}])
def test_falsy_results_arrive_as_themselves(result: object) -> None:
    (reply,) = Wire().receive(json.dumps({"jsonrpc": "2.0", "id": 1, "result": result}).encode() + b"\n")
    assert isinstance(reply, Reply)
    assert reply.result == result
    assert type(reply.result) is type(result)
    assert reply.error is None


def test_a_notification_of_a_later_server_is_passed_over() -> None:
    assert Wire().receive(b'{"jsonrpc":"2.0","method":"weather","params":{}}\n') == []


def test_requests_count_up_and_are_one_line() -> None:
    wire = Wire()
    first, line = wire.request("describe", {"pattern": "a\nb"})
    wire.restart()
    second, _ = wire.request("describe", {})
    assert (first, second) == (1, 2)
    assert line.count(b"\n") == 1
    assert line.endswith(b"\n")
    assert json.loads(line) == {"jsonrpc": "2.0", "id": 1, "method": "describe", "params": {"pattern": "a\nb"}}
    assert "id" not in json.loads(wire.notification("command", {}))


def test_a_binary_request_begins_with_a_zero_byte() -> None:
    _, frame = Wire("msgpack").request("ping", {"x": 1})
    assert frame[0] == 0
    assert struct.unpack(">I", frame[:4])[0] == len(frame) - 4
    assert msgpack.unpackb(frame[4:])["params"] == {"x": 1}


@pytest.mark.parametrize(
    ("encoding", "params", "code"),
    [
        ("json", {"x": float("nan")}, "not_finite"),
        ("json", {"x": float("inf")}, "not_finite"),
        ("json", {"x": object()}, "bad_argument"),
        ("json", {"x": "y" * LINE_LIMIT}, "too_large"),
        ("msgpack", {"x": object()}, "bad_argument"),
        ("msgpack", {"x": 1 << 80}, "bad_argument"),
        ("msgpack", {"x": b"y" * FRAME_LIMIT}, "too_large"),
    ],
)
def test_what_cannot_be_sent_is_refused_here(encoding: str, params: dict[str, object], code: str) -> None:
    with pytest.raises(CallRefused) as caught:
        Wire(encoding).request("ping", params)
    assert caught.value.code == code


def test_unknown_encoding_and_missing_msgpack(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UwError, match='"json" or "msgpack"'):
        framing("xml")
    monkeypatch.setitem(sys.modules, "msgpack", None)
    with pytest.raises(UwError, match=r"uwclient\[msgpack\]"):
        MsgpackFrames()


def test_a_time_is_reached_where_the_server_says_so() -> None:
    """`world/run_until` takes a float that is not quite a told time for it: who waits for it must not wait for ever."""
    status: dict[str, object] = {"t_ns": 4_166_667}
    assert time_reached(status, 0.004166667)
    assert time_reached(status, 1 / 240)
    assert time_reached(status, 0.004166668)
    assert not time_reached(status, 0.00416667)
