"""What a message may cost is found out before a decoder sees it: sizes, depth, numbers, claimed lengths; in linear time."""

from __future__ import annotations

import json
import re
import tracemalloc
from pathlib import Path

import msgpack
import msgspec
import pytest

from uwserver.adapter.bounds import (
    FEW,
    HUGE_LIMIT,
    LONG_NUMBER,
    LONG_NUMBERS_LIMIT,
    MAX_BINARY,
    MAX_CONTAINERS,
    MAX_DEPTH,
    MAX_DIGITS,
    MAX_PLAIN,
    MAX_TEXTS,
    MAX_VALUES,
    MESSAGE_LIMIT,
    PLAIN_TEXT,
    Excess,
    weigh_json,
    weigh_msgpack,
)


def nested(depth: int) -> object:
    value: object = 1
    for level in range(depth):
        value = [value] if level % 2 else {"a": value}
    return value


def json_excess(text: bytes) -> str:
    with pytest.raises(Excess) as caught:
        weigh_json(text)
    return f"{caught.value.code}: {caught.value}"


def msgpack_excess(frame: bytes) -> str:
    with pytest.raises(Excess) as caught:
        weigh_msgpack(frame)
    return f"{caught.value.code}: {caught.value}"


def row(item: bytes, size: int) -> bytes:
    """A JSON list of so many bytes at most."""
    return b"[" + b",".join([item] * ((size - 1) // (len(item) + 1))) + b"]"


# -- depth ----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [0, 1, MAX_DEPTH - 1, MAX_DEPTH])
def test_legal_depth(depth: int) -> None:
    weigh_json(msgspec.json.encode(nested(depth)))
    weigh_msgpack(msgpack.packb(nested(depth)))


@pytest.mark.parametrize("depth", [MAX_DEPTH + 1, 100, 500])
def test_too_deep(depth: int) -> None:
    assert "32 levels" in json_excess(msgspec.json.encode(nested(depth)))
    assert "32 levels" in msgpack_excess(msgpack.packb(nested(depth)))


@pytest.mark.parametrize("bomb", [b"[" * 1000, b'{"a":' * 1000, b'{"\\"[":[' * 700])
def test_json_bomb(bomb: bytes) -> None:
    assert "nested" in json_excess(bomb)
    assert "too_large" in json_excess(bomb * 1000)


@pytest.mark.parametrize("bomb", [b"\x91" * 1_000_000, b"\x81\xa0" * 500_000, b"\xdd\x00\x00\x00\x01" * 100_000])
def test_msgpack_bomb(bomb: bytes) -> None:
    assert "nested" in msgpack_excess(bomb)


def test_brackets_in_texts_do_not_count() -> None:
    text = '["{[' + "[" * 5000 + '", "\\"' + "{" * 100 + '", 1]'
    assert weigh_json(text.encode()) is False


@pytest.mark.parametrize(
    "text", [b"]" * 2000 + b"[" * 33, b"[" * 40 + b"]" * 3, b"[}" * 40 + b"[{" * 17, b"[]{}" * 300 + b"{" * 33]
)
def test_brackets_that_do_not_fit_each_other_are_not_deep_either(text: bytes) -> None:
    """They are counted as they come: what is opened and not closed is what a decoder would go into."""
    with pytest.raises(Excess, match="nested"):
        weigh_json(text)


def test_many_brackets_side_by_side_are_not_deep() -> None:
    weigh_json(b"[" + b"[]," * 1000 + b"[]]")


# -- what attacks are made of ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (row(b"1e300", 1 << 20), "too_large"),
        (row(b"1e99", 17 << 10), "too_large: more than 16 numbers with an exponent, or of 17 digits"),
        (row(b"1e300", 9 << 10), "too_large: more than 16 numbers with an exponent of three digits"),
        (row(b"0.1E+300", 9 << 10), "too_large: more than 16 numbers with an exponent of three digits"),
        (row(b"1.5e-300", 9 << 10), "too_large: more than 16 numbers with an exponent of three digits"),
        (row(b"9007199254740993.0", 17 << 10), "too_large: more than 16 numbers with an exponent, or of 17 digits"),
        (row(b"1" * 4000, 16 << 10), "at most 400 digits"),
        (b'{"n":0.%s}' % (b"0" * MAX_DIGITS), "at most 400 digits"),
        (b"}{" * 500_000, "too_large"),
        (b"}{" * 30_000, "maps and lists"),
        (row(b"[]", 60_000), "values"),
        (row(b"{}", 8 * MAX_CONTAINERS), "maps and lists"),
        (row(b"0", 60_000), "values"),
        (row(b'""', 60_000), "texts"),
        (b"{" + b",".join(b'"%d":0' % i for i in range(MAX_TEXTS + 1)) + b"}", "texts"),
        (row(b'"\\"\\""', 1 << 18), "too_large"),
        (b'"' + b"\\" * 500_000 + b'"', "too_large"),
        (b'["' + "é".encode() * 500_000 + b'"]', "too_large"),
        (b'{"%s":0}' % (b"k" * (MAX_PLAIN + 1)), "too_large"),
    ],
)
def test_json_that_would_cost_too_much_is_refused_undecoded(text: bytes, reason: str) -> None:
    assert reason in json_excess(text)


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (msgpack.packb(["text"] * 250_000), "values"),
        (msgpack.packb([{}] * (MAX_CONTAINERS + 1)), "maps and lists"),
        (msgpack.packb({str(i): i for i in range(5000)}), "values"),
        (msgpack.packb(["é" * 500] * 100), "too_large"),
        (msgpack.packb("é" * MESSAGE_LIMIT), "too_large"),
        (msgpack.packb("x" * (MAX_PLAIN + 1)), "too_large"),
        (msgpack.packb(["x" * 1000] * 70), "too_large"),
        (msgpack.packb([b"x" * (MAX_BINARY // 2)] * 2 + [b"x"]), "bytes in binary values"),
    ],
)
def test_msgpack_that_would_cost_too_much_is_refused_undecoded(frame: bytes, reason: str) -> None:
    assert reason in msgpack_excess(frame)


@pytest.mark.parametrize(
    ("text", "is_long"),
    [
        (row(b"1.5", 24_000), False),
        (row(b"123.4567890123456", MESSAGE_LIMIT), False),
        (row(b"1e300", HUGE_LIMIT), True),
        (row(b"1e99", LONG_NUMBERS_LIMIT), True),
        (row(b"0.12345678901234567", 18 * 16), False),
        (row(b"0.12345678901234567", 20 * 18), True),
        (row(b"1.E5", 5 * 18), True),
        (row(b'"1e5"', 500), False),
        (row(b'"12345678901234567890"', 500), False),
        (b'["\\\\"' + b",1e5" * 17 + b"]", True),
        (b'["\\"' + b",1e5" * 17 + b'"]', False),
        (b'{"a":"' + b"1e" * 30_000 + b'"}', False),
        (row(b"[]", 3 * MAX_CONTAINERS), False),
        (b'["' + b'\\"' * 30_000 + b'"]', False),
    ],
)
def test_what_is_taken_and_which_decoder_it_needs(text: bytes, is_long: bool) -> None:
    assert weigh_json(text) is is_long


@pytest.mark.parametrize("size", [1 << 10, 100_000, MAX_PLAIN - 1000])
def test_plain_texts_do_not_count(size: int) -> None:
    args = {"data": "1eA+" * (size // 4), "offset": 0}
    assert weigh_json(json.dumps(args).encode()) is False
    assert weigh_json(json.dumps({**args, "gain": [1e-9] * 16}).encode()) is False
    if size > LONG_NUMBERS_LIMIT:
        assert "too_large" in json_excess(json.dumps({**args, "gain": [1e-9] * 17}).encode())
    weigh_msgpack(msgpack.packb(args))
    heavy = "é" * (MESSAGE_LIMIT // 2)
    assert "too_large" in json_excess(json.dumps({**args, "more": heavy}, ensure_ascii=False).encode())
    assert "too_large" in msgpack_excess(msgpack.packb({**args, "more": heavy}))


def test_the_limit_itself_is_taken() -> None:
    text = '{"a":"%s"}'
    for filling in ("é" * ((MESSAGE_LIMIT - 8) // 2), "x" * (MAX_PLAIN - 8)):
        weigh_json((text % filling).encode())
        assert "too_large" in json_excess((text % (filling + "é")).encode())
    weigh_msgpack(msgpack.packb([0] * MAX_VALUES))
    assert "values" in msgpack_excess(msgpack.packb([0] * (MAX_VALUES + 1)))
    weigh_msgpack(msgpack.packb(b"x" * MAX_BINARY))


def test_unterminated_text_takes_linear_time() -> None:
    weigh_json(b'["' + b'\\"[' * 20_000)
    assert "too_large" in json_excess(b'["' + b'\\"[' * 300_000)


def test_the_page_tells_the_limits() -> None:
    page = (Path(__file__).parents[3] / "docs/reference/protocol.md").read_text(encoding="utf-8")
    rows = [line for line in page.partition("### What a message may cost")[2].splitlines() if line.startswith("| ")]
    told = {
        "| bytes |": (MESSAGE_LIMIT,),
        "| plain texts": (PLAIN_TEXT, MAX_PLAIN),
        "| binary": (MAX_BINARY,),
        "| JSON with more": (FEW, LONG_NUMBER, LONG_NUMBERS_LIMIT, HUGE_LIMIT),
        "| digits": (MAX_DIGITS,),
        "| maps": (MAX_CONTAINERS, MAX_DEPTH),
        "| values": (MAX_VALUES,),
        "| texts": (MAX_TEXTS,),
    }
    for head, limits in told.items():
        (line,) = (row for row in rows if row.startswith(head))
        numbers = set(re.findall(r"\d+", re.sub(r"(?<=\d) (?=\d{3})", "", line)))
        assert {str(limit) for limit in limits} <= numbers, line


# -- msgpack, byte by byte ------------------------------------------------------------------------------------------------------------

VALUES = [
    None, True, False, 0, 127, -1, -32, -33, 128, 255, 256, 65535, 65536, 2**32, 2**64 - 1, -129, -32769, -(2**31) - 1, -(2**63),
    1.5, "", "x" * 31, "x" * 32, "x" * 255, "x" * 256, "x" * 65536, [], [1] * 15, [1] * 16, [None] * 6000, {},
    {str(i): i for i in range(15)}, {str(i): i for i in range(16)}, {str(i): [i] for i in range(1500)}, {"a": {"b": [1, "c", None]}},
    b"", b"x" * 255, b"x" * 256, b"x" * 65536, [b"x", {"a": b"\xc1"}], b"x" * MAX_BINARY,
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(VALUES)))
def test_every_msgpack_type_passes_whole_and_no_part_does(number: int) -> None:
    frame = msgpack.packb(VALUES[number])
    weigh_msgpack(frame)
    for cut in range(0, len(frame), max(1, len(frame) // 50)):
        msgpack_excess(frame[:cut])
    msgpack_excess(frame + b"\x00")


def test_wide_headers() -> None:
    weigh_msgpack(b"\xdd\x00\x00\x00\x02\x01\xdf\x00\x00\x00\x01\xa1a\x02")


def test_single_precision() -> None:
    weigh_msgpack(msgpack.packb(1.5, use_single_float=True))


@pytest.mark.parametrize(
    "frame",
    [
        b"\xc1", msgpack.packb(msgpack.ExtType(5, b"x")),
        msgpack.packb(msgpack.ExtType(5, b"x" * 3)), msgpack.packb(msgpack.Timestamp(1, 0)), msgpack.packb(["a", msgpack.ExtType(5, b"b")]),
    ],
)  # fmt: skip
def test_types_outside_the_schema(frame: bytes) -> None:
    assert "not part of the schema" in msgpack_excess(frame)


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
        msgpack_excess(header + b"\x00" * 100)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()
