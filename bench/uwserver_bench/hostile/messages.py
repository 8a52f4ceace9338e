"""Messages that are expensive to decode, for decoders and for running servers."""

from __future__ import annotations

import json
from collections.abc import Mapping

from msgspec import msgpack

MIB = 1 << 20
CALL = '{"id":1,"method":"call","params":{"service":"%s","args":%s}}'


def row(item: str, size: int) -> str:
    """Return a JSON list of at most this many bytes."""
    return "[" + ",".join([item] * ((size - 2) // (len(item) + 1))) + "]"


def ping(params: str) -> bytes:
    """Return a request with these params."""
    return b'{"id":1,"method":"ping","params":' + params.encode() + b"}"


def _fault(parameters: str) -> bytes:
    args = f'{{"name":"x","kind":"thruster_dead","target":"rov/thrusters","parameters":{parameters}}}'
    return (CALL % ("world/set_fault", args)).encode()


def _mission(count: int) -> bytes:
    items = [{"kind": "waypoint", "position_ned_m": [1, 2, 3]}] * count
    return (CALL % ("rov/autopilot/set_mission", json.dumps({"items": items}, separators=(",", ":")))).encode()


def _piece(size: int) -> bytes:
    args = {"data": "QUJD" * (size // 4), "offset": 0, "bytes": 10**6, "sha256": "0" * 64}
    return (CALL % ("world/load", json.dumps(args))).encode()


JSON: Mapping[str, bytes] = {
    "1 MiB of 1e300,": ping(row("1e300", MIB - 100)),
    "64 KiB of 1e300,": ping(row("1e300", 65_000)),
    "16 KiB of 1e300,": ping(row("1e300", 16_300)),
    "8 KiB of 1e300,": ping(row("1e300", 8100)),
    "16 KiB of 1e9,": ping(row("1e9", 16_300)),
    "16 KiB of 9007199254740993.0,": ping(row("9007199254740993.0", 16_300)),
    "16 KiB of what is half-way between doubles": ping(
        row("0.500000000000000055511151231257827021181583404541015625", 16_300)
    ),
    "64 KiB of 123.4567890123456,": ping(row("123.4567890123456", 65_400)),
    "24 KiB of 1.5,": ping(row("1.5", 24_000)),
    "integers of 400 digits": ping(row("1" * 400, 16_300)),
    "integers of 4000 digits": ping(row("1" * 4000, 65_000)),
    "64 KiB of [],": ping(row("[]", 65_000)),
    "1500 of []": ping(row("[]", 4500)),
    "1500 of {}": ping(row("{}", 4500)),
    "3000 keys": ping("{" + ",".join(f'"k{i}":0' for i in range(3000)) + "}"),
    "}{ x 500 000": b"}{" * 500_000,
    "}{ x 30 000": b"}{" * 30_000,
    "4000 texts": ping(row('"a"', 16_000)),
    "64 KiB of escapes": ping('"' + "\\u00e9" * 10_000 + '"'),
    "64 KiB of backslashes": ping('"' + "\\\\" * 32_000 + '"'),
    "64 KiB of UTF-8": ping('"' + "é" * 32_000 + '"'),
    "a key of 1 MiB": b'{"' + b"k" * (MIB - 100) + b'":1}',
    "1 MiB of base64": ping('"' + "QUJD" * 262_000 + '"'),
    "1 MiB of base64 and an exponent": ping('["' + "QUJD" * 262_000 + '",1e300]'),
    "1 MiB of blanks": b" " * (MIB - 1),
    "set_fault, 16 KiB of 1e9,": _fault('{"members":' + row("1e9", 16_000) + "}"),
    "set_fault, 3000 keys": _fault("{" + ",".join(f'"k{i}":0' for i in range(3000)) + "}"),
    "set_fault, 4000 members": _fault('{"members":' + row('"a"', 16_000) + "}"),
    "set_mission, 700 items": _mission(700),
    "a misspelt service": (CALL % ("rov/autopilot/set_missio", "{}")).encode(),
    "describe, another pattern": b'{"id":1,"method":"describe","params":{"pattern":"' + b"**/" * 80 + b'*"}}',
    "world/describe": (CALL % ("world/describe", "{}")).encode(),
    "world/load, a piece of 768 KiB": _piece(MIB - 1000),
}
"""Bodies of JSON requests, all without line ends."""


def _framed(params: bytes) -> bytes:
    return b"\x83\xa2id\x01\xa6method\xa4ping\xa6params" + params


def _list(item: bytes, count: int) -> bytes:
    return _framed(b"\xdd" + count.to_bytes(4, "big") + item * count)


MSGPACK: Mapping[str, bytes] = {
    "250 000 texts": _list(b"\xa4text", 250_000),
    "6000 texts": _list(b"\xa4text", 6000),
    "6000 integers": _list(b"\x01", 6000),
    "6000 floats": _list(b"\xcb\x7e\x37\xe4\x3c\x88\x00\x75\x9c", 6000),
    "1500 maps": _list(b"\x80", 1500),
    "65 000 maps": _list(b"\x80", 65_000),
    "maps in maps": _framed(b"\x81\xa1a" * 20_000 + b"\x01"),
    "extensions": _list(b"\xd4\x05x", 8000),
    "3000 keys": _framed(msgpack.encode({str(i): 0 for i in range(3000)})),
    "1 MiB of text": _framed(msgpack.encode("x" * (MIB - 10))),
    "1 MiB of UTF-8": _framed(msgpack.encode("é" * (MIB // 2))),
    "a buffer of 1 MiB": _framed(msgpack.encode(b"x" * MIB)),
    "a buffer of 4 MiB": _framed(msgpack.encode(b"x" * (4 * MIB))),
    "a list that claims 4 G entries": _framed(b"\xdd\xff\xff\xff\xff"),
}
"""Bodies of msgpack requests."""
