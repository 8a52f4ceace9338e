"""Lines, frames and values of bytes in pieces of any size; limits and floods."""

from __future__ import annotations

import pytest

from uwserver.adapter import Frames, Lines, Undecodable, decode, frame, line
from uwserver.ports import Refused


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
        (b"1" * 10_000, "json", False),
        (b"\xa1\xff", "msgpack", False),
    ],
)
def test_what_is_no_value_says_why(data, encoding, is_valid):
    with pytest.raises(Undecodable) as caught:
        decode(data, encoding)
    assert caught.value.is_valid == is_valid
    assert 5 < len(str(caught.value)) < 300
