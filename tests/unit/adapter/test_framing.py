"""Lines, frames and values of bytes in pieces of any size; limits and floods."""

from __future__ import annotations

import msgpack
import msgspec
import pytest

from uwserver.adapter import Frames, Lines, Undecodable, decode, frame, framing, json_member, line, msgpack_member
from uwserver.adapter.bounds import MESSAGE_LIMIT
from uwserver.adapter.framing import LARGE
from uwserver.ports import Refused

MANY = b"[" + b"1e5," * 17 + b"%s]"
"""So many exponents that another decoder is needed."""


def lines_of(reader: Lines) -> list[bytes | str]:
    found: list[bytes | str] = []
    while True:
        try:
            got = reader.next_line()
        except Refused as refused:
            found.append(refused.fault.code)
            continue
        if got is None:
            return found
        found.append(got)


@pytest.mark.parametrize("piece", [1, 2, 3, 7, 1000])
def test_lines_in_pieces(piece: int):
    reader = Lines(10)
    data = b"one\r\n\n  \ntwo \n" + b"x" * 11 + b"\nthree\n" + b"y" * 10 + b"\nfo"
    found: list[bytes | str] = []
    for at in range(0, len(data), piece):
        reader.receive(data[at : at + piece])
        found += lines_of(reader)
    assert found == [b"one", b"two", "too_large", b"three", b"y" * 10]
    reader.receive(b"ur\n")
    assert lines_of(reader) == [b"four"]


@pytest.mark.parametrize("blanks", [b"\n" * 10_000, b" \r\n\t" * 3000, b" " * 5 + b"\n" * 9 + b"   "])
def test_blank_lines_are_skipped_at_once(blanks: bytes, monkeypatch: pytest.MonkeyPatch):
    """Whoever sends nothing else must not have the loop to himself: an adapter looks at the time between two lines only."""
    looks = 0

    def counted(*given):
        nonlocal looks
        looks += 1
        return copied(*given)

    copied = framing._copied
    monkeypatch.setattr(framing, "_copied", counted)
    reader = Lines(1 << 20)
    reader.receive(blanks)
    assert reader.next_line() is None
    assert looks <= 2
    reader.receive(b"next\n")
    assert lines_of(reader) == [b"next"]


def test_the_rest_of_a_long_line_takes_no_memory():
    reader = Lines(10)
    for _ in range(1000):
        reader.receive(b"z" * 1000)
        reader.receive(b"")
    assert lines_of(reader) == ["too_large"]
    for _ in range(1000):
        reader.receive(b"z" * 1000)
        assert lines_of(reader) == []
        assert len(reader._buffer) == 0
    reader.receive(b"z\nnext" + line(b""))
    assert lines_of(reader) == [b"next"]


@pytest.mark.parametrize("piece", [1, 3, 1000])
def test_frames_in_pieces(piece: int):
    reader = Frames(10)
    data = frame(b"one") + frame(b"") + frame(b"x" * 10)
    found = []
    for at in range(0, len(data), piece):
        reader.receive(data[at : at + piece])
        while (got := reader.next_frame()) is not None:
            found.append(got)
    assert found == [b"one", b"", b"x" * 10]
    assert not reader.is_lost


@pytest.mark.parametrize("behind", [b"", frame(b"next")[:3], frame(b"next")])
def test_a_large_frame_is_not_copied_and_what_follows_it_is_not_lost(behind):
    reader = Frames(1 << 20)
    for piece in (frame(b"x" * LARGE)[:10], frame(b"x" * LARGE)[10:] + behind):
        reader.receive(piece)
    held = reader._buffer
    large = reader.next_frame()
    assert isinstance(large, memoryview)
    assert large.obj is held
    assert large.readonly
    assert large == b"x" * LARGE
    reader.receive(frame(b"next")[len(behind) :])
    assert reader.next_frame() == b"next"


def test_after_a_frame_that_is_too_long_nothing_is_taken():
    reader = Frames(10)
    reader.receive(frame(b"x" * 11)[:4])
    with pytest.raises(Refused, match="holds at most 10 bytes, this one claims 11") as caught:
        reader.next_frame()
    assert caught.value.fault.code == "too_large"
    assert reader.is_lost
    reader.receive(frame(b"one"))
    assert reader.next_frame() is None
    assert len(reader._buffer) == 0


@pytest.mark.parametrize(
    ("data", "encoding"),
    [(b'{"a":[1,2.5,null]}', "json"), (b"\x81\xa1a\x93\x01\xcb@\x04\0\0\0\0\0\0\xc0", "msgpack")],
)
def test_values(data, encoding):
    assert decode(data, encoding) == {"a": [1, 2.5, None]}


@pytest.mark.parametrize(
    ("data", "encoding", "is_valid"),
    [
        (b"[" * 40 + b"]" * 40, "json", True),
        (b"\x91" * 40 + b"\x01", "msgpack", True),
        (b"{", "json", False),
        (b"\xff\xfe", "json", False),
        (b"1" * 10_000, "json", True),
        (b"1e400", "json", False),
        (MANY % b"NaN", "json", False),
        (MANY % b"-Infinity", "json", False),
        (MANY % b"1e400", "json", False),
        (MANY % b'"\\ud800"', "json", False),
        (MANY % b'"\\udc00\\ud800"', "json", False),
        (MANY % b'"\xff"', "json", False),
        (MANY % b"1] 1", "json", False),
        (MANY % b'"\n"', "json", False),
        (b"\xa1\xff", "msgpack", False),
    ],
)
def test_what_is_no_value_says_why(data, encoding, is_valid):
    with pytest.raises(Undecodable) as caught:
        decode(data, encoding)
    assert caught.value.is_valid == is_valid
    assert 5 < len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (b"1e300", 1e300),
        (b"[1E5,-2.5e-7]", [100000.0, -2.5e-07]),
        (b"12345678901234567890123", 12345678901234567890123),
        (b"0.30000000000000004", 0.30000000000000004),
        (b'[1e5,"\\ud83d\\ude00","\\\\ud800","\xc3\xa9"]', [1e5, "\U0001f600", "\\ud800", "\xe9"]),
        (b' {"a":1e5,"a":2}\t', {"a": 2}),
    ],
)
def test_numbers_on_which_the_fast_decoder_is_slow(monkeypatch, text, value):
    monkeypatch.setattr(framing, "_JSON", None)
    assert decode(b"[%s,%s]" % (text, b",".join([b"1e5"] * 17)), "json") == [value, *[1e5] * 17]


@pytest.mark.parametrize(
    ("data", "encoding"),
    [
        (b"[" + b"1e300," * 170_000 + b"1]", "json"),
        (b"}{" * 500_000, "json"),
        (b"[" + b"[]," * 340_000 + b"[]]", "json"),
        (b"[" + (b"1" * 4000 + b",") * 250 + b"1]", "json"),
        (b"\xdd\x00\x03\xd0\x90" + b"\xa4text" * 250_000, "msgpack"),
        (b"\xdd\x00\x00\x20\x00" + b"\x80" * 8192, "msgpack"),
        (b"\xc7\xff\x05" + b"x" * 255, "msgpack"),
    ],
)
def test_no_decoder_sees_what_would_cost_too_much(monkeypatch, data, encoding):
    for name in ("_JSON", "_SLOW", "_MSGPACK"):
        monkeypatch.setattr(framing, name, None)
    with pytest.raises(Undecodable) as caught:
        decode(data, encoding)
    assert caught.value.is_valid
    assert len(str(caught.value)) < 300


def test_a_buffer_and_a_piece_of_a_state_are_taken():
    piece = b"QUJD" * (1 << 16)
    assert decode(b'{"data":"%s","offset":0}' % piece, "json") == {"data": piece.decode(), "offset": 0}
    value = {"data": b"x" * (1 << 20), "shape": [1024, 1024], "piece": piece.decode()}
    assert decode(msgspec.msgpack.encode(value), "msgpack") == value


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
