"""Buffers of the client: with numpy and without, their forms on the wire, and what a server might send instead."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgpack
import numpy as np
import pytest
from uwclient import Buffer, CallRefused, ProtocolError, Sample
from uwclient.buffers import FORMATS, as_binary, as_text, packed, unpacked
from uwclient.checks import command_value
from uwclient.cli_verbs import _json_line, _sample_line
from uwclient.ports import Field, Port
from uwclient.zenoh_frames import RAW, Frames

ROWS = Buffer("uint8", (2, 3), b"abcdef")
TEXT = {"dtype": "uint8", "shape": [2, 3], "base64": "YWJjZGVm"}
MODEM = Port(
    "rov/modem",
    "actuator",
    "modem",
    (Field("payload", "bytes"), Field("picture", "buffer", (-1, 3), dtype="uint8"), Field("to", "str")),
)


@pytest.mark.parametrize("dtype", FORMATS)
@pytest.mark.parametrize("shape", [(2, 3), (6,), (1, 2, 3), (0, 3), (1,), ()])
def test_arrays_and_views(dtype, shape):
    array = np.arange(int(np.prod(shape))).reshape(shape).astype(dtype)
    buffer = Buffer.of(array)
    np.testing.assert_array_equal(buffer.array(), array)
    assert buffer.array().dtype == array.dtype
    assert not buffer.array().flags.writeable
    assert buffer.view.tolist() == (array.tolist() if 0 not in shape else [])


def test_both_forms_come_back():
    assert unpacked(json.loads(json.dumps(ROWS, default=as_text))) == ROWS
    assert unpacked(msgpack.unpackb(msgpack.packb(ROWS, default=as_binary))) == ROWS
    assert json.loads(json.dumps(b"hi", default=as_text)) == {"base64": "aGk="}
    assert unpacked({"base64": "aGk="}) == b"hi"
    for plain in (1.5, [1, 2], None, "text", b"hi"):
        assert unpacked(plain) is plain


@pytest.mark.parametrize(
    "bad",
    [
        {}, {"a": 1}, {"base64": 1}, {"base64": "?"}, {"base64": "YQ="}, {**TEXT, "dtype": "uint9"}, {**TEXT, "dtype": 5},
        {**TEXT, "shape": [2, -3]}, {**TEXT, "shape": [-2, -3]}, {**TEXT, "shape": [1 << 40, 1 << 40]}, {**TEXT, "shape": 6},
        {**TEXT, "shape": [2.0, 3.0]}, {**TEXT, "shape": [True, 6]}, {**TEXT, "shape": None}, {**TEXT, "base64": "YWJj"},
        {"dtype": "uint8", "shape": [1], "data": "a"},
    ],
)  # fmt: skip
def test_a_server_that_sends_no_buffer_is_told(bad):
    with pytest.raises(ProtocolError):
        unpacked(bad)
    with pytest.raises(ProtocolError):
        Sample.from_wire({"port": "a/b", "seq": 0, "t_ns": 0, "value": {"x": bad}})


def test_what_a_command_takes():
    value = command_value(
        {MODEM.path: MODEM}, MODEM.path, {"payload": bytearray(b"ab"), "picture": np.ones((1, 3), "u1"), "to": "x"}
    )
    assert value == {"payload": b"ab", "picture": Buffer("uint8", (1, 3), b"\1\1\1"), "to": "x"}
    assert packed(memoryview(b"ab")) == b"ab"
    assert packed({"base64": "aGk="}) == {"base64": "aGk="}
    with pytest.raises(CallRefused, match="no buffer of int64"):
        packed(np.zeros(3, np.int64))
    with pytest.raises(CallRefused, match="a buffer of uint8 n x 3"):
        command_value({MODEM.path: MODEM}, MODEM.path, {"pikture": 1})


def test_a_description_tells_type_and_shape():
    field = Field.from_wire(
        {"name": "picture", "type": "buffer", "shape": [], "buffer": {"dtype": "uint8", "shape": [-1, 3]}}
    )
    assert (field.dtype, field.shape) == ("uint8", (-1, 3))
    assert Field.from_wire({"name": "u", "type": "float", "shape": [8]}).dtype == ""


def test_a_sample_on_the_terminal():
    sample = Sample("rov/camera", 1, 0, 0, True, {"picture": ROWS, "payload": b"hi", "range": [1.0, None]})
    assert _sample_line(sample).endswith('picture="uint8 2x3" payload={"base64": "aGk="} range=[1.0, null]')
    assert json.loads(_json_line(sample))["value"]["picture"] == TEXT


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("spoken", ["json", "msgpack"])
def test_a_raw_sample_of_zenoh(encoding, spoken):
    meta = {"port": "rov/camera", "seq": 1, "t_ns": 2, "t_sent_ns": 3, "valid": True, "field": "picture"}
    for extra, value in (({"dtype": "uint8", "shape": [2, 3]}, ROWS), ({}, b"abcdef")):
        attachment = (
            json.dumps({**meta, **extra}, separators=(",", ":")).encode()
            if encoding == "json"
            else msgpack.packb({**meta, **extra})
        )
        frames = Frames(spoken)
        (message,) = frames._framing.feed(frames.sample(b"abcdef", attachment, RAW))
        assert Sample.from_wire(message["params"]) == Sample("rov/camera", 1, 2, 3, True, {"picture": value})
    assert frames.sample(b"abcdef", b"\x82", RAW) == b""
    assert (
        frames.sample(
            b"abcde", json.dumps({**meta, "dtype": "uint8", "shape": [2, 3]}, separators=(",", ":")).encode(), RAW
        )
        == b""
    )


def test_nothing_of_it_needs_numpy(tmp_path):
    code = (
        "import sys; sys.modules['numpy'] = None\n"
        "from uwclient import Buffer, UwError\n"
        "b = Buffer('uint16', (2, 2), bytes(range(8)))\n"
        "assert b.view[1, 0] == 0x0504, b.view[1, 0]\n"
        "try: b.array()\n"
        "except UwError as e: assert 'numpy' in str(e)\n"
        "else: raise AssertionError\n"
    )
    client = Path(__file__).parents[3] / "clients/python"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={"PYTHONPATH": str(client)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
