"""rosbridge's forms of a message: JSON, CBOR, a picture, pieces."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib

import numpy as np
import pytest
from cbor_rig import uncbor
from uwserver_adapters.rosbridge.codec import (
    Gathered,
    cbor,
    fragments,
    json_text,
    parsed,
    png,
    published,
    published_raw,
)

from uwserver.adapter import Undecodable


def unframed(frame):
    """Opcode and payload of an unmasked frame."""
    size, at = frame[1] & 127, 2
    if size == 126:
        size, at = struct.unpack_from(">H", frame, 2)[0], 4
    elif size == 127:
        size, at = struct.unpack_from(">Q", frame, 2)[0], 10
    assert len(frame) == at + size
    return frame[0] & 15, frame[at:]


@pytest.mark.parametrize(
    "value",
    [
        None, True, False, 0, 23, 24, 255, 256, 65535, 65536, 1 << 32, (1 << 64) - 1, -1, -24, -25, -(1 << 31),
        1 << 64, -(1 << 64), -(1 << 64) - 1, 1 << 200,
        1.5, -0.0, "", "ü" * 30,
        b"", b"x" * 300, [], [1, [2, {"a": [3.5]}]], {"op": "publish", "msg": {"x": -5}},
    ],
)  # fmt: skip
def test_cbor_says_what_was_meant(value):
    data = cbor(value)
    assert uncbor(data) == (value, len(data))


def test_arrays_are_typed_where_clients_know_the_type():
    for kind, tag in (("uint8", 64), ("uint16", 69), ("int32", 78), ("float32", 85), ("float64", 86)):
        assert uncbor(cbor(np.array([1, 2, 3], kind)))[0] == (tag, [1, 2, 3])
    assert uncbor(cbor(np.array([1, -2], np.int64)))[0] == [1, -2]  # roslib knows no typed array of these
    assert uncbor(cbor(np.array([True, False])))[0] == [True, False]
    assert cbor(np.array([1.5], ">f4")) == cbor(np.array([1.5], "<f4"))


def test_json_has_no_nan_and_bytes_in_base64():
    value = {"a": math.nan, "b": np.array([1.0, math.inf]), "c": np.array([0, 1, 255], np.uint8), "d": np.float32(0.5)}
    assert json.loads(json_text(value)) == {"a": None, "b": [1.0, None], "c": "AAH/", "d": 0.5}


def test_a_picture_is_the_text():
    for size in (1, 2, 3, 10, 1000, 4097):
        text = bytes(33 + k % 90 for k in range(size))
        data = png(text)
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        width, height, *rest = struct.unpack_from(">IIBBBBB", data, 16)
        assert rest == [8, 2, 0, 0, 0]
        at, rows = 8, b""
        while at < len(data):
            (length,) = struct.unpack_from(">I", data, at)
            kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
            assert struct.unpack_from(">I", data, at + 8 + length)[0] == zlib.crc32(kind + body)
            rows += body if kind == b"IDAT" else b""
            at += 12 + length
        pixels = zlib.decompress(rows)
        assert len(pixels) == height * (1 + 3 * width)
        found = b"".join(pixels[k * (1 + 3 * width) + 1 : (k + 1) * (1 + 3 * width)] for k in range(height))
        assert found.rstrip(b"\n") == text


def test_forms_of_a_published_message():
    message = {"data": np.array([1.0, 2.0])}
    opcode, body = unframed(published("/a", message, "none"))
    assert (opcode, json.loads(body)) == (1, {"op": "publish", "topic": "/a", "msg": {"data": [1.0, 2.0]}})
    opcode, body = unframed(published("/a", message, "cbor"))
    assert (opcode, uncbor(body)[0]) == (2, {"op": "publish", "topic": "/a", "msg": {"data": (86, [1.0, 2.0])}})
    opcode, body = unframed(published("/a", message, "png"))
    assert (opcode, json.loads(body)["op"]) == (1, "png")
    assert base64.b64decode(json.loads(body)["data"]).startswith(b"\x89PNG")
    _, body = unframed(published_raw("/a", b"\0\1\0\0xyz", 5_000_000_006))
    assert uncbor(body)[0]["msg"] == {"secs": 5, "nsecs": 6, "bytes": b"\0\1\0\0xyz"}


def test_pieces_make_the_message_again():
    text = json_text({"op": "publish", "msg": "ü" * 500})
    pieces = [json.loads(unframed(frame)[1]) for frame in fragments(text, 100, 7)]
    assert {piece["total"] for piece in pieces} == {len(pieces)}
    assert max(len(piece["data"]) for piece in pieces) == 100
    gathered = Gathered()
    ends = [gathered.take(piece) for piece in reversed(pieces)]
    assert ends == [*[None] * (len(pieces) - 1), text]


@pytest.mark.parametrize(
    "piece",
    [
        {},
        {"id": 1, "data": "x", "num": 1, "total": 1},
        {"id": 1, "data": 5, "num": 0, "total": 1},
        {"data": "x", "num": 0, "total": 1 << 40},
    ],
)
def test_wrong_pieces_are_refused(piece):
    with pytest.raises(Undecodable):
        Gathered().take(piece)


def test_pieces_of_a_client_are_bounded():
    gathered = Gathered()

    def much():
        for num in range(1000):
            gathered.take({"id": "a", "data": "x" * 10_000, "num": num, "total": 1000})

    with pytest.raises(Undecodable, match="at most"):
        much()
    for k in range(1000):
        gathered.take({"id": str(k), "data": "x", "num": 0, "total": 2})
    assert len(gathered._sets) <= 16


def test_pieces_of_all_messages_count_together_and_empty_ones_too():
    gathered = Gathered()

    def empty():
        for num in range(1 << 17):
            gathered.take({"id": "a", "data": "", "num": num % 65_000, "total": 65_536})

    empty()
    assert len(gathered._sets["a"][1]) == 65_000
    for k in range(5):
        gathered.take({"id": k, "data": "x" * 30_000, "num": 0, "total": 2})
    assert list(gathered._sets) == ["3", "4"]
    assert gathered._size == 60_000
    assert gathered.take({"id": 4, "data": "y", "num": 1, "total": 2}) == b"x" * 30_000 + b"y"


@pytest.mark.parametrize(
    "body", [b"", b"[]", b"5", b"{", b"\xff", b'"op"', b"[" * 1000, b'{"op":' + b"[" * 500 + b"]" * 500 + b"}"]
)
def test_what_is_no_message_is_refused(body):
    with pytest.raises(Undecodable):
        parsed(body)
