"""Bytes of the native protocol to requests and back: limits, garbage, and shapes of every answer."""

from __future__ import annotations

import json
import math
import struct
import tracemalloc
from typing import Any

import msgpack
import msgspec
import pytest
from uwserver_adapters.native.codec import (
    FRAME_LIMIT,
    LINE_LIMIT,
    JsonCodec,
    MsgpackCodec,
    choose_codec,
)
from uwserver_adapters.native.messages import (
    EXAMPLE,
    ID_LIMIT,
    TEXT_LIMIT,
    Malformed,
    Notice,
    Request,
    ResultMessage,
    encoded_sample,
    error_message,
)

from uwserver.adapter import SampleForm
from uwserver.ports import ErrorCode, Event, Fault, Field, Port, Sample
from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

IMU = Port(
    "rov/imu",
    "sensor",
    "imu",
    (Field("f_S", "m/s^2", "specific force", "S", (3,)), Field("temperature", "degC", "of the chip")),
    "Inertial unit.",
    120.0,
)
SAMPLE = Sample("rov/imu", 12, 50_000_000, 54_000_000, True, ((0.0, 0.5, -9.81), 12.0))
FAULT = Fault("unknown_port", "no port", "rov/x")


def frame(message: object) -> bytes:
    body = message if isinstance(message, bytes) else msgpack.packb(message)
    return struct.pack(">I", len(body)) + body


# What a peer says: the same maps in both encodings.
REQUESTS: list[tuple[str, Any, tuple[object, ...]]] = [
    ("request", {"jsonrpc": "2.0", "id": 1, "method": "describe"}, (Request(1, "describe"),)),
    ("text id", {"jsonrpc": "2.0", "id": "é", "method": "ping", "params": [1]}, (Request("é", "ping", [1]),)),
    ("notification", {"jsonrpc": "2.0", "method": "ping", "params": {"a": None}}, (Request(None, "ping", {"a": None}),)),
    ("without version", {"id": 0, "method": "ping"}, (Request(0, "ping"),)),
    ("params", {"id": 2**64 - 1, "method": "x", "params": {"u": [0.5, -1], "b": True}}, (Request(2**64 - 1, "x", {"u": [0.5, -1], "b": True}),)),
]  # fmt: skip
INVALID: list[tuple[str, Any, object, str]] = [
    ("batch", [{"id": 1, "method": "ping"}], None, "batches are not served"),
    ("no map", 5, None, "a request is a map"),
    ("null", None, None, "a request is a map"),
    ("null id", {"id": None, "method": "ping"}, None, '"id" must be'),
    ("float id", {"id": 1.5, "method": "ping"}, None, '"id" must be'),
    ("bool id", {"id": True, "method": "ping"}, None, '"id" must be'),
    ("long id", {"id": "x" * (ID_LIMIT + 1), "method": "ping"}, None, '"id" must be'),
    ("unknown member", {"id": 3, "method": "ping", "prams": {}}, 3, 'no member "prams"'),
    ("wrong version", {"id": 3, "jsonrpc": "1.0", "method": "ping"}, 3, '"jsonrpc" must be "2.0"'),
    ("no method", {"id": 3}, 3, 'names its "method"'),
    ("method no text", {"id": 3, "method": 7}, 3, 'names its "method"'),
]
SAMPLE_LINE = (
    b'{"jsonrpc":"2.0","method":"sample","params":{"port":"rov/imu","seq":12,"t_ns":50000000,"t_sent_ns":54000000,'
    b'"valid":true,"value":{"f_S":[0.0,0.5,-9.81],"temperature":12.0}}}\n'
)
# What we say: exact bytes of the JSON encoding.
WRITTEN = [
    (
        "reply",
        lambda c: c.message(ResultMessage(5, {"a": [1, None]})),
        b'{"jsonrpc":"2.0","id":5,"result":{"a":[1,null]}}\n',
    ),
    (
        "falsy results",
        lambda c: c.message(ResultMessage("a", [0, False, [], None, ""])),
        b'{"jsonrpc":"2.0","id":"a","result":[0,false,[],null,""]}\n',
    ),
    (
        "raw reply",
        lambda c: c.message(ResultMessage(5, msgspec.Raw(c.encoding.encode({"a": 1})))),
        b'{"jsonrpc":"2.0","id":5,"result":{"a":1}}\n',
    ),
    (
        "not finite",
        lambda c: c.message(ResultMessage(1, [math.nan, math.inf, -math.inf])),
        b'{"jsonrpc":"2.0","id":1,"result":[null,null,null]}\n',
    ),
    (
        "error",
        lambda c: c.message(error_message(None, FAULT)),
        b'{"jsonrpc":"2.0","id":null,"error":{"code":-32602,"message":"no port","data":{"code":"unknown_port","where":"rov/x"}}}\n',
    ),
    (
        "sample",
        lambda c: c.frame(encoded_sample(c.encoding, SampleForm(IMU), SAMPLE)),
        SAMPLE_LINE,
    ),
    (
        "event",
        lambda c: c.message(Notice("event", Event("paused", 3, 12, "why"))),
        b'{"jsonrpc":"2.0","method":"event","params":{"event":"paused","tick":3,"t_ns":12,"text":"why"}}\n',
    ),
    (
        "progress",
        lambda c: c.message(Notice("progress", {"id": 5, "fraction": 0.5, "t_ns": 12})),
        b'{"jsonrpc":"2.0","method":"progress","params":{"id":5,"fraction":0.5,"t_ns":12}}\n',
    ),
]


def test_json_table() -> None:
    reading = [CodecCase(name, json.dumps(message).encode() + b"\n", events) for name, message, events in REQUESTS]
    crlf = CodecCase("CRLF and blank lines", b'\r\n \n{"id":1,"method":"ping"}\r\n', (Request(1, "ping"),))
    utf8 = CodecCase("UTF-8", '{"id":1,"method":"pé"}\n'.encode(), (Request(1, "pé"),))
    writing = [CodecCase(name, data, write=write) for name, write, data in WRITTEN]
    garbage = [b"\xff\xfe\n", b"nonsense\n", b"{" * 100 + b"\n", b'{"id":1\n', b"\x00\x01\n", b"\n\n\n"]
    check_codec(JsonCodec, [*reading, utf8, crlf, *writing], need_data=None, garbage=garbage, resynchronises=True)


def test_msgpack_table() -> None:
    reading = [CodecCase(name, frame(message), events) for name, message, events in REQUESTS]
    # The JSON table and an independent encoder say what the frame must hold.
    writing = [
        CodecCase(name, frame(json.loads(data)), write=write) for name, write, data in WRITTEN if name != "not finite"
    ]
    garbage = [
        frame(b""),
        frame(b"\xc1"),
        frame(b"\x81"),
        frame(b"\xa2\xff\xff"),
        frame(b"\x91" * 100),
        frame(b"\x01\x02"),
    ]
    check_codec(MsgpackCodec, [*reading, *writing], need_data=None, garbage=garbage, resynchronises=True)
    check_codec(MsgpackCodec, [], need_data=None, garbage=[b"\xff" * 50, b"\x00" * 50])


def test_not_finite_stays_in_msgpack() -> None:
    assert math.isnan(msgpack.unpackb(MsgpackCodec().message(ResultMessage(1, math.nan))[4:])["result"])


@pytest.mark.parametrize(
    ("message", "identity", "phrase"), [row[1:] for row in INVALID], ids=[row[0] for row in INVALID]
)
def test_what_is_no_request(message: object, identity: object, phrase: str) -> None:
    for codec, data in ((JsonCodec(), json.dumps(message).encode() + b"\n"), (MsgpackCodec(), frame(message))):
        (event,) = read_all(codec, [data], None)
        assert isinstance(event, Malformed)
        assert event.fault.code == "invalid_request"
        assert phrase in event.fault.text
        assert event.id == identity
        assert not event.fatal


@pytest.mark.parametrize(
    "line",
    [
        b"hello",
        b"{",
        b"\xff",
        b"[NaN]",
        b'{"a":Infinity}',
        b"[1e999]",
        b"1 2",
        b'"\\ud800"',
        b"\x00",
        b'{"a":1,}',
    ],
)
def test_a_line_that_is_no_json_shows_an_example(line: bytes) -> None:
    (event,) = read_all(JsonCodec(), [line + b"\n"], None)
    assert isinstance(event, Malformed)
    assert event.fault.code == "parse_error"
    assert EXAMPLE in event.fault.text
    assert not event.fatal


def test_the_example_is_valid() -> None:
    assert read_all(JsonCodec(), [EXAMPLE.encode() + b"\n"], None) == [Request(1, "describe")]


def test_map_key_that_is_no_key_in_msgpack() -> None:
    (event,) = read_all(MsgpackCodec(), [frame(b"\x81\x91\x80\x01")], None)
    assert isinstance(event, Malformed)
    assert event.fault.code == "parse_error"


def test_nesting_is_refused() -> None:
    for codec, data in ((JsonCodec(), b"[" * 1000 + b"\n"), (MsgpackCodec(), frame(b"\x91" * 500_000))):
        (event,) = read_all(codec, [data], None)
        assert isinstance(event, Malformed)
        assert "32 levels" in event.fault.text


def test_the_answer_to_what_cannot_be_decoded_carries_the_id() -> None:
    lines = [
        b'{"id":7,"method":"ping","params":"\\ud800"}',
        b'{"method":"ping","params":{"id":1,"x":[NaN]},"id":7}',
        b'{"id":7,"method":"ping","params":' + b"[" * 100 + b"]" * 100 + b"}",
        b'{"id":7,"method":"ping","params":[' + b"1e300," * 5000 + b"1]}",
        b'{"id":7,"method":' + b"x" * (LINE_LIMIT + 1),
    ]
    for body in lines:
        (event,) = read_all(JsonCodec(), [body + b"\n"], None)
        assert isinstance(event, Malformed)
        assert event.id == 7
    frames = [
        {"id": 7, "params": msgpack.ExtType(5, b"x")},
        {"id": 7, "params": json.loads("[" * 100 + "]" * 100)},
        {"id": 7, "params": [0] * 10_000},
        b"\x82\xa1a\xa1\xff\xa2id\x07",
    ]
    for message in frames:
        (event,) = read_all(MsgpackCodec(), [frame(message)], None)
        assert isinstance(event, Malformed)
        assert event.id == 7
    (event,) = read_all(JsonCodec(), [b'{"id":"%s",}\n' % (b"x" * (ID_LIMIT + 1))], None)
    assert isinstance(event, Malformed)
    assert event.id is None


def test_line_at_and_over_the_limit() -> None:
    blank = b'{"id":1,"method":"%s"}'
    fits = blank % (b"x" * (LINE_LIMIT - len(blank) + 2))
    assert len(fits) == LINE_LIMIT
    (event,) = read_all(JsonCodec(), [fits + b"\n"], None)
    assert isinstance(event, Request)
    follower = b'{"id":2,"method":"ping"}\n'
    for pieces in ([fits + b"x\n" + follower], [fits + b"x", b"yz", b"zz\n" + follower], [fits, b"x", b"\n", follower]):
        large, ping = read_all(JsonCodec(), pieces, None)
        assert isinstance(large, Malformed)
        assert large.fault.code == "too_large"
        assert not large.fatal
        assert ping == Request(2, "ping")


def test_line_of_100_megabytes_takes_no_memory_and_gives_one_error() -> None:
    codec = JsonCodec()
    chunk = b"x" * 65536
    tracemalloc.start()
    try:
        events = []
        for _ in range(1600):
            events += read_all(codec, [chunk], None)
        assert tracemalloc.get_traced_memory()[1] < 4 * LINE_LIMIT
        assert tracemalloc.get_traced_memory()[0] < 200_000
    finally:
        tracemalloc.stop()
    assert [type(event) for event in events] == [Malformed]
    assert read_all(codec, [b'\n{"id":1,"method":"ping"}\n'], None) == [Request(1, "ping")]


def test_frame_over_the_limit_ends_the_connection_and_takes_no_memory() -> None:
    codec = MsgpackCodec()
    tracemalloc.start()
    try:
        (event,) = read_all(codec, [struct.pack(">I", FRAME_LIMIT + 1)], None)
        assert read_all(codec, [b"x" * 65536] * 100, None) == []
        assert tracemalloc.get_traced_memory()[1] < 300_000
    finally:
        tracemalloc.stop()
    assert isinstance(event, Malformed)
    assert event.fatal
    assert event.fault.code == "too_large"


def test_claimed_frame_reserves_nothing() -> None:
    codec = MsgpackCodec()
    tracemalloc.start()
    try:
        assert read_all(codec, [struct.pack(">I", FRAME_LIMIT), b"\x00" * 1000], None) == []
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("head", "chosen"),
    [
        (b"G", JsonCodec), (b"GET ", JsonCodec), (b"\x00", MsgpackCodec), (b"\x00GET", MsgpackCodec), (b"{", JsonCodec),
        (b"Garbage", JsonCodec), (b"\xff", JsonCodec),
        (b"\x01", JsonCodec), (b"\n", JsonCodec),
    ],
)  # fmt: skip
def test_the_first_byte_decides(head: bytes, chosen: Any) -> None:
    assert isinstance(choose_codec(head), chosen)


def test_every_error_code_has_its_number() -> None:
    numbers: dict[ErrorCode, int] = {
        "parse_error": -32700, "invalid_request": -32600, "unknown_method": -32601, "bad_argument": -32602, "unknown_port": -32602,
        "unknown_service": -32602, "out_of_range": -32602, "bad_shape": -32602, "not_finite": -32602, "busy": -32000,
        "preempted": -32000, "timeout": -32000, "denied": -32000, "too_large": -32000, "overload": -32000, "version": -32000,
        "internal": -32000, "shutdown": -32000,
    }  # fmt: skip
    for code, number in numbers.items():
        error = json.loads(JsonCodec().message(error_message(7, Fault(code, "text"))))["error"]
        assert error == {"code": number, "message": "text", "data": {"code": code, "where": ""}}


def test_long_texts_are_cut() -> None:
    error = json.loads(JsonCodec().message(error_message(7, Fault("internal", "x" * 10**6, "y" * 10**6))))["error"]
    assert len(error["message"]) == len(error["data"]["where"]) == TEXT_LIMIT + 3


@pytest.mark.parametrize("codec", [JsonCodec(), MsgpackCodec()])
def test_results_without_encoding_raise(codec: JsonCodec | MsgpackCodec) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        codec.message(ResultMessage(1, object()))


def test_selected_fields() -> None:
    assert SampleForm(IMU, ["temperature", "other"]).value(SAMPLE) == {"temperature": 12.0}
    assert SampleForm(IMU, ["temperature", "f_S"]).value(SAMPLE) == {"f_S": (0.0, 0.5, -9.81), "temperature": 12.0}


def test_arrays_of_two_dimensions_are_nested() -> None:
    port = Port(
        "a/b", "sensor", "k", (Field("m", "1", "matrix", shape=(2, 3)), Field("t", "1", "tensor", shape=(2, 1, 2))), ""
    )
    sample = Sample("a/b", 0, 0, 0, False, ((1, 2, 3, 4, 5, None), None))
    assert SampleForm(port).value(sample) == {"m": [[1, 2, 3], [4, 5, None]], "t": None}
    sample = Sample("a/b", 0, 0, 0, True, (None, (1, 2, 3, 4)))
    assert SampleForm(port).value(sample) == {"m": None, "t": [[[1, 2]], [[3, 4]]]}
