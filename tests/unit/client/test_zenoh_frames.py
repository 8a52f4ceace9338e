"""Frames of the native wire made of zenoh payloads: what the session reads must be what the server said."""

from __future__ import annotations

import json

import msgpack
import pytest
from uwclient.core import Reply, Wire
from uwclient.ports import Sample
from uwclient.zenoh_frames import MEDIA, Frames

META = {"port": "rov/imu", "seq": 12, "t_ns": 5, "t_sent_ns": 6, "valid": True}
VALUE = {"f_S": [0.0, 1.5, -9.81], "name": "x"}


def packed(value: object, encoding: str) -> bytes:
    if encoding == "json":
        return json.dumps(value, separators=(",", ":")).encode()
    return msgpack.packb(value)


def read(encoding: str, frame: bytes) -> object:
    (message,) = Wire(encoding).receive(frame)
    return message


@pytest.mark.parametrize("wire", ["json", "msgpack"])
@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_a_sample_of_either_encoding(wire, encoding):
    frames = Frames(wire)
    frame = frames.sample(packed(VALUE, encoding), packed(META, encoding), MEDIA[encoding])
    assert read(wire, frame) == Sample("rov/imu", 12, 5, 6, True, VALUE)
    frame = frames.selected(packed(VALUE, encoding), packed(META, encoding), MEDIA[encoding], ["name"])
    assert read(wire, frame) == Sample("rov/imu", 12, 5, 6, True, {"name": "x"})


def test_what_is_not_a_number_is_null_in_json():
    frame = Frames("json").sample(packed({"a": [float("nan")]}, "msgpack"), packed(META, "msgpack"), MEDIA["msgpack"])
    message = read("json", frame)
    assert isinstance(message, Sample)
    assert message["a"] == [None]


@pytest.mark.parametrize("wire", ["json", "msgpack"])
@pytest.mark.parametrize(
    ("payload", "attachment", "media"),
    [
        (b"{}", b'{"client":"pilot"}', "application/json"),
        (b"{}", b"", "application/json"),
        (b"{}", packed(META, "json"), "image/png"),
        (b"{}\n{}", packed(META, "json"), "application/json"),
        (b"\x80", b"\x81\xa6client\xa1a", "application/msgpack"),
        (b"\x80", b"\x85\xa4port", "application/cdr"),
    ],
)
def test_what_others_put_is_no_sample(wire, payload, attachment, media):
    frames = Frames(wire)
    if wire == "msgpack" and b"\n" in payload:
        pytest.skip("a line end matters to lines alone")
    assert frames.sample(payload, attachment, media) == b""


def test_refusals():
    frames = Frames("json")
    told = b'{"code":"busy","message":"wait","where":"world/step"}'
    message = read("json", frames.refused(7, told, "application/json"))
    assert isinstance(message, Reply)
    assert message.error is not None
    assert (message.id, message.error.code, message.error.where) == (7, "busy", "world/step")
    message = read("json", frames.refused(7, b"Timeout", "zenoh/bytes"))
    assert isinstance(message, Reply)
    assert message.error is not None
    assert message.error.message == "Timeout"


@pytest.mark.parametrize("payload", [b"", b"[1]", b"{", b"\xff"])
def test_notices_that_are_none(payload):
    assert Frames("json").notice("event", payload, "application/json") == b""
