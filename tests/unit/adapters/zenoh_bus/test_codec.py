"""Payloads and attachments both ways, and all that is none."""

from __future__ import annotations

import json

import msgpack
import pytest
from uwserver_adapters.zenoh_bus.codec import (
    ATTACHMENT_LIMIT,
    PAYLOAD_LIMIT,
    Caller,
    Codec,
    decode_caller,
    decode_map,
    encoding_of,
)

from uwserver.adapter import SampleForm
from uwserver.ports import Fault, Field, Port, Refused, Sample

GRID = Field("grid", "m", "two by three", shape=(2, 3))
PLAIN = Field("f_S", "m/s^2", "vector", "S", (3,))
DEPTH = Field("depth", "m", "scalar")
SAMPLE = Sample("rov/imu", 12, 50_000_000, 54_000_000, True, ((0.0, -0.5, float("nan")), 4.5))
PORT = Port("rov/imu", "sensor", "imu", (PLAIN, DEPTH), "Imu.", rate_hz=10.0)


def test_a_sample_as_json():
    codec = Codec("json")
    assert codec.encode(SampleForm(PORT).value(SAMPLE)) == b'{"f_S":[0.0,-0.5,null],"depth":4.5}'
    assert codec.attachment(SAMPLE) == (
        b'{"port":"rov/imu","seq":12,"t_ns":50000000,"t_sent_ns":54000000,"valid":true}'
    )


def test_a_sample_as_msgpack():
    codec = Codec("msgpack")
    value = msgpack.unpackb(codec.encode(SampleForm(PORT).value(SAMPLE)))
    assert list(value) == ["f_S", "depth"]
    assert value["f_S"][:2] == [0.0, -0.5]
    attachment = codec.attachment(SAMPLE)
    assert attachment.startswith(b"\x85\xa4port\xa7rov/imu\xa3seq\x0c\xa4t_ns\xce")
    assert msgpack.unpackb(attachment) == {
        "port": "rov/imu", "seq": 12, "t_ns": 50_000_000, "t_sent_ns": 54_000_000, "valid": True,
    }  # fmt: skip


def test_rows_are_nested():
    port = Port("rov/sonar", "sensor", "sonar", (GRID,), "Sonar.", rate_hz=1.0)
    sample = Sample("rov/sonar", 0, 0, 0, True, ((1.0, 2.0, 3.0, 4.0, 5.0, 6.0),))
    assert SampleForm(port).value(sample) == {"grid": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]}
    nothing = Sample("rov/sonar", 0, 0, 0, False, (None,))
    assert SampleForm(port).value(nothing) == {"grid": None}


@pytest.mark.parametrize(
    ("media", "encoding"),
    [
        ("application/json", "json"),
        ("APPLICATION/JSON;charset=utf-8", "json"),
        ("application/msgpack", "msgpack"),
        ("text/json", "json"),
        ("text/plain", "json"),
        ("zenoh/bytes", "json"),
        ("zenoh/string", "json"),
        ("", "msgpack"),
    ],
)
def test_encodings(media, encoding):
    assert encoding_of(media, "msgpack") == encoding


@pytest.mark.parametrize("media", ["image/png", "application/cdr", "application/jsonx", "x" * 5000])
def test_other_encodings_are_refused(media):
    with pytest.raises(Refused, match="application/json or application/msgpack") as refused:
        encoding_of(media, "json")
    assert refused.value.fault.where == "encoding"
    assert len(refused.value.fault.text) < 300


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_maps_come_as_they_are(encoding):
    value = {"u": [0.5, 1, -1], "name": "a", "on": False, "none": None, "deep": {"a": [[1]]}}
    payload = json.dumps(value).encode() if encoding == "json" else msgpack.packb(value)
    assert decode_map(payload, encoding) == value
    assert decode_map(b"", encoding) == {}
    assert decode_map(None, encoding) == {}


@pytest.mark.parametrize(
    ("payload", "encoding", "code"),
    [
        (b"{", "json", "parse_error"),
        (b"\xff\xfe", "json", "parse_error"),
        (b'{"u": NaN}', "json", "parse_error"),
        (b'{"u": 1}x', "json", "parse_error"),
        (b"[" * 100_000, "json", "invalid_request"),
        (b"[1]", "json", "invalid_request"),
        (b"1", "json", "invalid_request"),
        (b'{"u":' + b"[" * 40 + b"]" * 40 + b"}", "json", "invalid_request"),
        (b" " * (PAYLOAD_LIMIT + 1), "json", "too_large"),
        (b"\xc1", "msgpack", "invalid_request"),
        (b"\x81\xa1u", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xdd\xff\xff\xff\xff", "msgpack", "invalid_request"),
        (b"\xdf\xff\xff\xff\xff", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xc4\x01x", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xd4\x01x", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xd6\xff\x00\x00\x00\x00", "msgpack", "invalid_request"),
        (b"\x81\x01\x01", "msgpack", "invalid_request"),
        (b"\x81\xa1u" + b"\x91" * 2000 + b"\x01", "msgpack", "invalid_request"),
        (b"\x81\xa1u" + b"\x91" * 40 + b"\x01", "msgpack", "invalid_request"),
        (b"\x81\xa1u\x01\x01", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xa1\xff", "msgpack", "parse_error"),
        (b"\x90", "msgpack", "invalid_request"),
        (b"\x00" * (PAYLOAD_LIMIT + 1), "msgpack", "too_large"),
    ],
)
def test_what_is_no_map_is_refused(payload, encoding, code):
    with pytest.raises(Refused) as refused:
        decode_map(payload, encoding)
    assert refused.value.fault.code == code
    assert refused.value.fault.where == "payload"


@pytest.mark.parametrize(
    ("attachment", "caller"),
    [
        (None, Caller()),
        (b"", Caller()),
        (b'{"client":"pilot"}', Caller("pilot")),
        (b'{"client":"pilot","id":7}', Caller("pilot", 7)),
        (msgpack.packb({"client": "pilot", "id": 7}), Caller("pilot", 7)),
    ],
)
def test_callers(attachment, caller):
    assert decode_caller(attachment) == caller


@pytest.mark.parametrize(
    "attachment",
    [
        b"123",
        b"{",
        b"\xc1",
        b'{"client":5}',
        b'{"id":"7"}',
        b'{"who":"pilot"}',
        b'{"client":"a/b"}',
        b'{"client":"@a"}',
        json.dumps({"client": "x" * 65}).encode(),
        b"{" + b" " * ATTACHMENT_LIMIT + b"}",
        bytes(33),
    ],
)
def test_what_is_no_caller_is_refused(attachment):
    with pytest.raises(Refused) as refused:
        decode_caller(attachment)
    assert refused.value.fault.where in ("attachment", "client")


def test_a_refusal_does_not_send_back_what_came_at_full_length():
    fault = json.loads(Codec("json").fault(Fault("bad_argument", "x" * 10_000, "y" * 10_000)))
    assert fault["code"] == "bad_argument"
    assert len(fault["message"]) == len(fault["where"]) == 2000
