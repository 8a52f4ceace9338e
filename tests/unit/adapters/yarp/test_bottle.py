"""Bottles against bytes that YARP's own tools have written, and against what is no bottle."""

from __future__ import annotations

import math
import struct

import pytest
from uwserver_adapters.yarp.bottle import (
    DEPTH,
    ITEMS,
    TEXT_BLOB,
    TEXTS,
    Vocab,
    from_binary,
    from_text,
    to_binary,
    to_text,
)

from uwserver.ports import Refused

LINE = '1 2.5 hello "a b" (3 4.5) (1 2 3) [go] {1 2} 5000000000'
VALUES = [1, 2.5, "hello", "a b", [3, 4.5], [1, 2, 3], Vocab("go"), b"\1\2", 5_000_000_000]
# What `yarp write` of YARP 4.0.0 sends for that line.
WRITTEN = bytes.fromhex(
    "00010000 09000000 01000000 01000000 14000000 0000000000000440 04000000 05000000 68656c6c6f 04000000 03000000 612062"
    "00010000 02000000 01000000 03000000"
    "14000000 0000000000001240 01010000 03000000 01000000 02000000 03000000 09000000 676f0000 0c000000 02000000 0102 11000000 00f2052a01000000"
)
# What `yarp rpc` sends for (u (0.1 0.2)): a list of lists, and one of floats alone.
RPC = bytes.fromhex(
    "00010000 01000000 00010000 02000000 04000000 01000000 75 14010000 02000000 9a9999999999b93f 9a9999999999c93f"
)


def test_what_yarp_has_written_is_read() -> None:
    assert from_binary(WRITTEN) == VALUES
    assert isinstance(from_binary(WRITTEN)[6], Vocab)
    assert from_binary(RPC) == [["u", [0.1, 0.2]]]
    assert from_text(LINE) == VALUES


def test_what_is_written_is_what_yarp_writes() -> None:
    assert to_binary([["u", [0.1, 0.2]]]) == RPC
    # Lists of whole numbers have a tag for each here, which YARP reads as well.
    assert to_binary(VALUES[:5]) == WRITTEN[:4] + struct.pack("<i", 5) + WRITTEN[8:80]
    assert to_text(VALUES) == LINE


def test_a_row_of_floats_is_a_vector_of_yarp_sig() -> None:
    """A list of doubles has its tag at the top: 256 + 20."""
    assert to_binary([1.0, -2.0]) == struct.pack("<iidd", 276, 2, 1.0, -2.0)


@pytest.mark.parametrize(
    "values",
    [
        [], [[]], [[[], [1]], 2.0], [-(2**31), 2**31 - 1, 2**31, -(2**63), 2**63 - 1], [math.inf, -math.inf, 1e300, 5e-324, -0.0],
        ["", " ", 'a"b\\c', "line\nbreak\r\0", "true", "null", "1", "-x", "(", "a.b-c", "é", "/port"],
        [Vocab("ok"), Vocab("many"), Vocab("abcdefgh"), Vocab("")], [b"", b"\0\xff" * 9],
    ],
)  # fmt: skip
def test_both_forms_come_back_as_they_were(values) -> None:
    assert from_binary(to_binary(values)) == values
    assert from_text(to_text(values)) == values
    assert repr(from_binary(to_binary(values))) == repr(values)


def test_not_a_number_comes_back() -> None:
    assert math.isnan(from_binary(to_binary([math.nan]))[0])  # type: ignore[arg-type]
    assert math.isnan(from_text(to_text([math.nan]))[0])  # type: ignore[arg-type]


def test_what_people_type() -> None:
    assert from_text("  set_speed (speed  2.)  ") == ["set_speed", ["speed", 2.0]]
    assert from_text("0x10 +3 .5 1e3 true false 1,2") == [16, 3, 0.5, 1000.0, Vocab("1"), Vocab(""), 1, 2]
    assert from_text(r'a\ b "c\n\"d\""') == ["a b", 'c\n"d"']


def test_short_lists_of_all_kinds_of_numbers_are_read() -> None:
    for tag, form, numbers in ((32, "b", (-1, 2)), (64, "h", (-300, 2)), (17, "q", (2**40, 1)), (10, "f", (0.5, -1.5))):
        assert from_binary(struct.pack(f"<ii2{form}", 256 + tag, 2, *numbers)) == list(numbers)
    words = struct.pack("<ii4s4s", 256 + 9, 2, b"ok", b"many")
    assert from_binary(words) == [Vocab("ok"), Vocab("many")]


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", "parse_error"), (b"\1\0\0\0\5\0\0\0", "parse_error"), (WRITTEN[:-1], "parse_error"), (struct.pack("<iii", 256, 1, 5), "parse_error"),
        (struct.pack("<ii", 256, -1), "too_large"), (struct.pack("<ii", 256, 2**31 - 1), "too_large"),
        (struct.pack("<ii", 276, 2**31 - 1), "too_large"),
        (struct.pack("<iiii", 256, 1, 4, 2**31 - 1), "parse_error"), (struct.pack("<iiii", 256, 1, 4, -1), "parse_error"),
        (struct.pack("<ii", 256, 1) * (DEPTH + 3), "too_large"),
        (struct.pack("<iiii", 256, 2, 256, 1) * (DEPTH + 3), "too_large"),
    ],
)  # fmt: skip
def test_no_bottle_is_refused(data: bytes, code: str) -> None:
    with pytest.raises(Refused) as caught:
        from_binary(data)
    assert caught.value.fault.code == code


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("(", "parse_error"), (")", "parse_error"), ('"x', "parse_error"), ("{a}", "parse_error"), ("{1", "parse_error"), ("\\", "parse_error"),
        ("1 " * (ITEMS + 10), "too_large"), ("(" * (DEPTH + 2), "too_large"),
    ],
)  # fmt: skip
def test_no_line_of_a_bottle_is_refused(line: str, code: str) -> None:
    with pytest.raises(Refused) as caught:
        from_text(line)
    assert caught.value.fault.code == code


def test_texts_are_bounded_all_together() -> None:
    half = "x" * (TEXTS // 2)
    assert from_binary(to_binary([half, [half], bytes(2 * TEXTS)])) == [half, [half], bytes(2 * TEXTS)]
    with pytest.raises(Refused, match="texts of a bottle") as caught:
        from_binary(to_binary([half, [half], "x"]))
    assert caught.value.fault.code == "too_large"


def test_pictures_have_no_text() -> None:
    """A number for each byte would be three and a half times as long."""
    assert to_text([bytes(TEXT_BLOB)]).count("0") == TEXT_BLOB
    assert to_text([bytes(TEXT_BLOB + 1)]) == "{}"
