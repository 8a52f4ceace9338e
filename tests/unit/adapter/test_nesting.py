"""Depth, claimed lengths and values of messages are checked before a decoder sees them, in linear time."""

from __future__ import annotations

import tracemalloc

import msgpack
import msgspec
import pytest

from uwserver.adapter.nesting import MAX_BINARY, MAX_DEPTH, MAX_VALUES, json_fault, msgpack_fault


def nested(depth: int) -> object:
    value: object = 1
    for level in range(depth):
        value = [value] if level % 2 else {"a": value}
    return value


@pytest.mark.parametrize("depth", [0, 1, MAX_DEPTH - 1, MAX_DEPTH])
def test_legal_depth(depth: int) -> None:
    assert json_fault(msgspec.json.encode(nested(depth))) is None
    assert msgpack_fault(msgpack.packb(nested(depth))) is None


@pytest.mark.parametrize("depth", [MAX_DEPTH + 1, 100, 500])
def test_too_deep(depth: int) -> None:
    for fault in (json_fault(msgspec.json.encode(nested(depth))), msgpack_fault(msgpack.packb(nested(depth)))):
        assert fault is not None
        assert "32 levels" in fault


@pytest.mark.parametrize("bomb", [b"[" * 1_000_000, b'{"a":' * 200_000, b'{"\\"[":[' * 100_000])
def test_json_bomb(bomb: bytes) -> None:
    assert "nested" in str(json_fault(bomb))


@pytest.mark.parametrize("bomb", [b"\x91" * 1_000_000, b"\x81\xa0" * 500_000, b"\xdd\x00\x00\x00\x01" * 100_000])
def test_msgpack_bomb(bomb: bytes) -> None:
    assert "nested" in str(msgpack_fault(bomb))


def test_brackets_in_texts_do_not_count() -> None:
    text = '["{[' + "[" * 100 + '", "\\"' + "{" * 100 + '", 1]'
    assert json_fault(text.encode()) is None


def test_many_brackets_side_by_side_are_not_deep() -> None:
    assert json_fault(b"[" + b"[]," * 1000 + b"[]]") is None


def test_unterminated_text_takes_linear_time() -> None:
    # A pattern that gives back would take hours on this line.
    line = b"[" * 40 + b'"' + b'\\"' * 500_000
    assert json_fault(b"[" * 20 + line[20:]) is not None
    assert json_fault(b'["' + b'\\"[' * 300_000) is None


VALUES = [
    None, True, False, 0, 127, -1, -32, -33, 128, 255, 256, 65535, 65536, 2**32, 2**64 - 1, -129, -32769, -(2**31) - 1, -(2**63),
    1.5, "", "x" * 31, "x" * 32, "x" * 255, "x" * 256, "x" * 65536, [], [1] * 15, [1] * 16, [None] * 70000, {},
    {str(i): i for i in range(15)}, {str(i): i for i in range(16)}, {str(i): [i] for i in range(70000)}, {"a": {"b": [1, "c", None]}},
    b"", b"x" * 255, b"x" * 256, b"x" * 65536, [b"x", {"a": b"\xc1"}], b"x" * MAX_BINARY,
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(VALUES)))
def test_every_msgpack_type_passes_whole_and_no_part_does(number: int) -> None:
    frame = msgpack.packb(VALUES[number])
    assert msgpack_fault(frame) is None
    for cut in range(0, len(frame), max(1, len(frame) // 50)):
        assert msgpack_fault(frame[:cut]) is not None
    assert msgpack_fault(frame + b"\x00") is not None


def test_single_precision() -> None:
    assert msgpack_fault(msgpack.packb(1.5, use_single_float=True)) is None


@pytest.mark.parametrize(
    "frame",
    [
        b"\xc1", msgpack.packb(msgpack.ExtType(5, b"x")),
        msgpack.packb(msgpack.ExtType(5, b"x" * 3)), msgpack.packb(msgpack.Timestamp(1, 0)), msgpack.packb(["a", msgpack.ExtType(5, b"b")]),
    ],
)  # fmt: skip
def test_types_outside_the_schema(frame: bytes) -> None:
    assert "not part of the schema" in str(msgpack_fault(frame))


@pytest.mark.parametrize(
    "header",
    [
        b"\xdd\xff\xff\xff\xff",
        b"\xdf\xff\xff\xff\xff",
        b"\xdc\xff\xff",
        b"\xde\x80\x00",
        b"\xdb\xff\xff\xff\xff",
        b"\xc6\xff\xff\xff\xff",
        b"\xc6\x00\x3f\xff\xff",
    ],
)
def test_claimed_length_allocates_nothing(header: bytes) -> None:
    tracemalloc.start()
    try:
        assert msgpack_fault(header + b"\x00" * 100) is not None
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_number_of_values_is_bounded() -> None:
    assert msgpack_fault(msgpack.packb([0] * MAX_VALUES)) is None
    assert "values in one message" in str(msgpack_fault(msgpack.packb([0] * (MAX_VALUES + 1))))
    assert "values in one message" in str(msgpack_fault(msgpack.packb([[0] * 200_000] * 2)))


def test_number_of_binary_bytes_is_bounded() -> None:
    half = b"x" * (MAX_BINARY // 2)
    assert msgpack_fault(msgpack.packb([half, half])) is None
    assert "bytes in binary values" in str(msgpack_fault(msgpack.packb([half, half, b"x"])))
    assert msgpack_fault(msgpack.packb("x" * (MAX_BINARY + 1))) is None
