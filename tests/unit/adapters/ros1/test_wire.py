"""TCPROS, byte by byte."""

import pytest
from uwserver_adapters.ros1.wire import Blocks, answer, block, fields_of, header

from uwserver.ports import Refused

# The example of wiki.ros.org/ROS/Connection%20Header, cut to two fields.
HEADER = bytes.fromhex("200000000d000000") + b"topic=/chatte" + bytes.fromhex("0b000000") + b"md5sum=1234"


def test_header() -> None:
    assert header({"topic": "/chatte", "md5sum": "1234"}) == HEADER
    assert fields_of(HEADER[4:]) == {"topic": "/chatte", "md5sum": "1234"}
    assert fields_of(header({"a": "b=c\n", "empty": ""})[4:]) == {"a": "b=c\n", "empty": ""}


def test_blocks_in_pieces_of_any_size() -> None:
    data = block(b"") + block(b"abc") + HEADER
    for size in range(1, len(data) + 1):
        blocks, found = Blocks(), []
        for at in range(0, len(data), size):
            blocks.receive(data[at : at + size])
            while (each := blocks.next_block()) is not None:
                found.append(each)
        assert found == [b"", b"abc", HEADER[4:]]


def test_a_claimed_length_reserves_nothing() -> None:
    blocks = Blocks(100)
    blocks.receive(bytes.fromhex("ffffff7f"))
    with pytest.raises(Refused, match="at most 100"):
        blocks.next_block()


@pytest.mark.parametrize(
    "body",
    [
        b"\x01",
        b"\x05\x00\x00\x00ab",
        bytes.fromhex("03000000") + b"abc",
        b"".join(block(b"k%d=v" % n) for n in range(100)),
        block(b"k=v") * 12_000,
    ],
)
def test_no_header(body: bytes) -> None:
    with pytest.raises(Refused):
        fields_of(body)


def test_answers_of_services() -> None:
    assert answer(True, b"xy") == b"\x01\x02\x00\x00\x00xy"
    assert answer(False, b"no") == b"\x00\x02\x00\x00\x00no"
