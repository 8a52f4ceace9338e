"""The id of a request that cannot be decoded: lone surrogates, depth, NaN, extensions, and what is cut off."""

from __future__ import annotations

import msgpack
import pytest

from uwserver.adapter import json_member, msgpack_member
from uwserver.adapter.bounds import MESSAGE_LIMIT

EXTENSION = msgpack.ExtType(5, b"x" * 3)


@pytest.mark.parametrize(
    ("text", "identity"),
    [
        (b'{"id":7,"params":NaN}', 7),
        (b'{"params":{"id":1,"u":[1,"]}"]},"id":-7 }', -7),
        (b'{"method":"\\ud800","id" : "a\\u00e9\\"b"}', 'aé"b'),
        (b'{"params":' + b"[" * 100 + b"]" * 100 + b',"id":7}', 7),
        (b'{"id":"\xc3\xa9"', "é"),
        (b'{"id":7', 7),
        (b'{"id":7,"x":"' + b"y" * MESSAGE_LIMIT, 7),
        (b'{"x":"\\"id\\":5","id":7', 7),
        (b'{"id":"\\ud800"}', None),
        (b'{"id":"\xff"}', None),
        (b'{"id":7.5,NaN}', None),
        (b'{"id":7e5,NaN}', None),
        (b'{"id":{"id":7},NaN}', None),
        (b'{"id":' + b"1" * 30 + b"}", None),
        (b'{"params":{"id":7}', None),
        (b'{"a":1} {"id":7}', None),
        (b'[{"id":7}]', None),
        (b'"id":7', None),
        (b'{"x":"id":7', 7),
        (b'{"x":"' + b"y" * MESSAGE_LIMIT + b'","id":7}', None),
        (b"{" + b"[]" * MESSAGE_LIMIT, None),
        (b"", None),
        (b"}{" * 1000, None),
    ],
)
def test_json(text: bytes, identity: object) -> None:
    assert json_member(text, "id") == identity


DEEP = msgpack.packb({"id": 7, "params": [[[[1]]]]})


@pytest.mark.parametrize(
    ("frame", "identity"),
    [
        (msgpack.packb({"params": EXTENSION, "id": 7}), 7),
        (msgpack.packb({"params": {"id": 1, "x": [1.5, None, b"id"]}, "id": "é"}), "é"),
        (msgpack.packb({"id": -7, "params": [0] * 50_000}), -7),
        (b"\x82\xa1a\xa1\xff\xa2id\x07", 7),
        (b"\x82\xd4\x01x\xc7\x02\x05ab\xa2id\x07", 7),
        (b"\x82\xc1\xc9\x00\x00\x00\x02\x05ab\xa2id\x07", 7),
        (DEEP[:10], 7),
        (msgpack.packb({"params": [0] * 50_000, "id": 7}), None),
        (msgpack.packb({"id": 1.5, "x": EXTENSION}), None),
        (msgpack.packb({"id": EXTENSION}), None),
        (b"\x81\xa2id\xa1\xff", None),
        (b"\x81\xa2id", None),
        (b"\xdf\xff\xff\xff\xff\xa2ip\x01", None),
        (b"\x81\xdb\xff\xff\xff\xff", None),
        (b"\x93\xa2id\x07", None),
        (b"", None),
    ],
)
def test_msgpack(frame: bytes, identity: object) -> None:
    assert msgpack_member(frame, "id") == identity


@pytest.mark.parametrize("cut", range(len(DEEP)))
def test_msgpack_that_is_cut_off(cut: int) -> None:
    assert msgpack_member(DEEP[:cut], "id") in (None, 7)
