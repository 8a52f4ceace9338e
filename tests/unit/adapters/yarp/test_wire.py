"""The carriers against bytes that YARP's own tools have sent."""

from __future__ import annotations

import pytest
from uwserver_adapters.yarp import wire
from uwserver_adapters.yarp.bottle import Vocab
from uwserver_adapters.yarp.wire import Decoder, Hello, YarpMessage

from uwserver.ports import Refused
from uwserver.testing.codecs import CodecCase, check_codec, read_all

# `echo 7 | yarp write /w1 tcp://cap`, and how it leaves.
TCP = bytes.fromhex(
    "5941e41e00005250 04000000 2f773100"
    "59410a0000005250 0201ffffffffffffffff 08000000 10000000 00000000 000000007e440001 00010000 01000000 01000000 07000000"
    "59410a0000005250 0101ffffffffffffffff 0a000000 00000000 020000007e00000171 00"
)
ENVELOPE = bytes.fromhex(
    "5941641e00005250 03000000 2f6100"
    "59410a0000005250 0301ffffffffffffffff 08000000 09000000 0c000000 00000000 090000007e000001 4420352031 2e323500 00010000 00000000"
)
CASES = [
    CodecCase("tcp", TCP, (Hello("tcp", "/w1"), YarpMessage("D", "D", [7]), YarpMessage("q", "q", ()))),
    CodecCase("tcp hello", TCP[:16], (Hello("tcp", "/w1"),), lambda _: wire.hello("tcp", "/w1")),
    CodecCase("text hello", b"CONNECT /w\r\n", (Hello("text", "/w"),), lambda _: wire.hello("text", "/w")),
    CodecCase(
        "text_ack", b"CONNACK admin\r\na\r\n[list] [out] /r\r\n",
        (Hello("text_ack", "admin"), YarpMessage("a", "a", [Vocab("list"), Vocab("out"), "/r"])),
    ),
    CodecCase("text", b"CONNECT x\nd\n1 2\n\n/a b\nD 5 1.25\n(u 1)\nq\n", (
        Hello("text", "x"), YarpMessage("d", "d", [1, 2]), YarpMessage("/", "/a b", ()), YarpMessage("D", "D 5 1.25", [["u", 1]]),
        YarpMessage("q", "q", ()),
    )),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_yarp_sends_is_read_in_pieces_of_any_size(case: CodecCase) -> None:
    check_codec(Decoder, [case], need_data=None)


def test_samples_are_written_with_their_envelope() -> None:
    message = wire.message(False, "D 5 1.25", wire.payload(False, [[]])[:4] + b"\0\0\0\0")
    told = read_all(Decoder(), [wire.hello("fast_tcp", "/a") + message], None)
    assert told == [Hello("fast_tcp", "/a"), YarpMessage("D", "D 5 1.25", [])]
    assert wire.hello("fast_tcp", "/a") + message == ENVELOPE[:15] + message
    assert message[:18] == ENVELOPE[15:33]
    assert wire.message(True, "D 5 1.25", wire.payload(True, [1.5])) == b"D 5 1.25\r\n1.5\r\n"


def test_answers_are_those_of_the_carrier() -> None:
    assert wire.welcome("tcp", "/w", 10555) == b"YA\x3b\x29\0\0RP"
    assert wire.welcome("text_ack", "/w", 1) == b"Welcome /w\r\n"
    acknowledged = [wire.acknowledgement(carrier) for carrier in wire.CARRIERS]
    assert acknowledged == [b"YA\0\0\0\0RP", b"", b"", b"<ACK>\r\n"]


def test_a_bottle_that_is_none_costs_its_message_alone() -> None:
    events = read_all(Decoder(), [b"CONNECT x\nd\n((\nd\n1\n"], None)
    assert isinstance(events[1], YarpMessage)
    assert events[1].fault is not None
    assert events[2] == YarpMessage("d", "d", [1])
    binary = (
        wire.hello("tcp", "x")
        + wire.message(False, "d", b"\0" * 8)
        + wire.message(False, "d", wire.payload(False, [1]))
    )
    events = read_all(Decoder(), [binary], None)
    assert isinstance(events[1], YarpMessage)
    assert events[1].fault is not None
    assert events[2] == YarpMessage("d", "d", [1])


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HT", bytes(8), TCP[:8] + b"\xff\xff\xff\x7f", TCP[:8] + b"\0\0\0\0", b"CONNECT " + b"x" * 2000,
        TCP[:16] + b"nonsense, and then more of it", TCP[:16] + TCP[16:34] + b"\xff\xff\xff\x7f" * 2 + bytes(4),
        TCP[:16] + TCP[16:34] + b"\xf8\xff\xff\xff" + TCP[38:], b"CONNECT x\n" + b"d" * (wire.LINE_LIMIT + 10),
        wire.hello("tcp", "x") + wire.message(False, "d", b"")[:-8] + b"\0\0\0\0!d\0\1", bytes.fromhex("5941e51e00005250"),
    ],
)  # fmt: skip
def test_what_is_no_yarp_ends_the_connection(data: bytes) -> None:
    with pytest.raises(Refused):
        read_all(Decoder(), [data], None)
