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
    command_value,
    decode_caller,
    decode_map,
    encoding_of,
)

from uwserver.adapter import SampleForm
from uwserver.ports import Buffer, Fault, Field, Layout, Port, Refused, Sample

GRID = Field("grid", "m", "two by three", shape=(2, 3))
PLAIN = Field("f_S", "m/s^2", "vector", "S", (3,))
DEPTH = Field("depth", "m", "scalar")
SAMPLE = Sample("rov/imu", 12, 50_000_000, 54_000_000, True, ((0.0, -0.5, float("nan")), 4.5))
PORT = Port("rov/imu", "sensor", "imu", (PLAIN, DEPTH), "Imu.", rate_hz=10.0)


def test_a_sample_as_json():
    codec = Codec("json")
    assert codec.encode(SampleForm(PORT).value(SAMPLE)) == b'{"f_S":[0.0,-0.5,null],"depth":4.5}'
    payload, media, attachment = codec.sample(SampleForm(PORT), SAMPLE)
    assert (payload, media) == (b'{"f_S":[0.0,-0.5,null],"depth":4.5}', "application/json")
    assert attachment == b'{"port":"rov/imu","seq":12,"t_ns":50000000,"t_sent_ns":54000000,"valid":true}'


def test_a_sample_as_msgpack():
    codec = Codec("msgpack")
    value = msgpack.unpackb(codec.encode(SampleForm(PORT).value(SAMPLE)))
    assert list(value) == ["f_S", "depth"]
    assert value["f_S"][:2] == [0.0, -0.5]
    _, _, attachment = codec.sample(SampleForm(PORT), SAMPLE)
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
        (b"[" * 100, "json", "invalid_request"),
        (b"[" * 100_000, "json", "too_large"),
        (b"[1]", "json", "invalid_request"),
        (b"1", "json", "invalid_request"),
        (b'{"u":' + b"[" * 40 + b"]" * 40 + b"}", "json", "invalid_request"),
        (b" " * (PAYLOAD_LIMIT + 1), "json", "too_large"),
        (b"\xc1", "msgpack", "invalid_request"),
        (b"\x81\xa1u", "msgpack", "invalid_request"),
        (b"\x81\xa1u\xdd\xff\xff\xff\xff", "msgpack", "invalid_request"),
        (b"\xdf\xff\xff\xff\xff", "msgpack", "invalid_request"),
        (b"\xc4\x01x", "msgpack", "invalid_request"),
        (b"\x81\xc4\x01u\x01", "msgpack", "invalid_request"),
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


PICTURE = Field("picture", "1", "a picture", type="buffer", buffer=Layout("uint8", (-1, 3)))
PAYLOAD = Field("payload", "1", "what came", type="bytes")
ROWS = Buffer(dtype="uint8", shape=(2, 3), data=b"abcdef")
META = {"port": "rov/camera", "seq": 1, "t_ns": 2, "t_sent_ns": 3, "valid": True}


def camera(*fields: Field, direction: str = "sensor") -> Port:
    return Port("rov/camera", direction, "camera", fields, "Camera.")  # type: ignore[arg-type]


def told(*value: object, valid: bool = True) -> Sample:
    return Sample("rov/camera", 1, 2, 3, valid, value)  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "decode"), [("json", json.loads), ("msgpack", msgpack.unpackb)])
def test_a_sample_that_is_one_buffer_goes_as_it_is(name, decode):
    payload, media, attachment = Codec(name).sample(SampleForm(camera(PICTURE)), told(ROWS))
    assert (payload, media) == (b"abcdef", "application/octet-stream")
    assert decode(attachment) == {**META, "field": "picture", "dtype": "uint8", "shape": [2, 3]}
    payload, media, attachment = Codec(name).sample(SampleForm(camera(PAYLOAD)), told(Buffer(data=b"\0\1")))
    assert (payload, media) == (b"\0\1", "application/octet-stream")
    assert decode(attachment) == {**META, "field": "payload"}


@pytest.mark.parametrize("name", ["json", "msgpack"])
def test_a_camera_that_saw_nothing_says_so_in_a_map(name):
    payload, media, attachment = Codec(name).sample(SampleForm(camera(PICTURE)), told(None, valid=False))
    assert media == f"application/{name}"
    assert payload == (b'{"picture":null}' if name == "json" else b"\x81\xa7picture\xc0")
    assert b"field" not in attachment


def test_a_buffer_among_others_is_in_a_map():
    sample = told(ROWS, Buffer(data=b"hi"), 1.5)
    form = SampleForm(camera(PICTURE, PAYLOAD, DEPTH))
    payload, media, _ = Codec("json").sample(form, sample)
    assert media == "application/json"
    assert payload == (
        b'{"picture":{"dtype":"uint8","shape":[2,3],"base64":"YWJjZGVm"},"payload":{"base64":"aGk="},"depth":1.5}'
    )
    payload, _, _ = Codec("msgpack").sample(form, sample)
    picture = {"dtype": "uint8", "shape": [2, 3], "data": b"abcdef"}
    assert msgpack.unpackb(payload) == {"picture": picture, "payload": b"hi", "depth": 1.5}


def test_a_raw_command():
    raw = "application/octet-stream; x=1"
    assert encoding_of(raw, "msgpack") == "msgpack"
    assert command_value(camera(PICTURE), b"abcdef", raw, "json") == {"picture": b"abcdef"}
    assert command_value(camera(PAYLOAD), None, raw, "json") == {"payload": b""}
    assert command_value(camera(PAYLOAD), b'{"payload":{"base64":"aGk="}}', "", "json") == {
        "payload": {"base64": "aGk="}
    }


@pytest.mark.parametrize(
    ("fields", "payload", "code"),
    [((DEPTH,), b"abc", "bad_argument"), ((PICTURE, DEPTH), b"abc", "bad_argument"), ((PAYLOAD,), bytes(PAYLOAD_LIMIT + 1), "too_large")],
)  # fmt: skip
def test_a_raw_command_that_fits_nothing(fields, payload, code):
    with pytest.raises(Refused) as refused:
        command_value(camera(*fields), payload, "application/octet-stream", "json")
    assert refused.value.fault.code == code
