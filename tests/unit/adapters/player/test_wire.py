"""Messages against bytes that libplayerc has sent, and its generated XDR."""

from __future__ import annotations

import struct

import pytest
from uwserver_adapters.player import wire
from uwserver_adapters.player.wire import CMD, DATA, PLAYER, REQ, Decoder, PlayerMessage

from uwserver.ports import Refused
from uwserver.testing.codecs import CodecCase, check_codec, read_all

# By the generated XDR of Player 3.1.1: pull data, and open position3d:0. Its numbers of hosts and robots are of the connection: 0.
DATAMODE = bytes.fromhex(
    "00000000 00000000 00000001 00000000 00000003 00000005 0000000000000000 00000000 00000004 00000002"
)
OPEN = bytes.fromhex(
    "00000000 00000000 00000001 00000000 00000003 00000003 0000000000000000 00000001 0000001c"
    "00000000 00000000 0000001e 00000000 00000001 00000000 00000000"
)
CASES = [
    CodecCase("datamode", DATAMODE, (PlayerMessage(PLAYER, 0, REQ, 5, b"\0\0\0\2"),),
              lambda _: wire.encode(PlayerMessage(PLAYER, 0, REQ, 5, b"\0\0\0\2"))),
    CodecCase("open", OPEN, (PlayerMessage(PLAYER, 0, REQ, 3, OPEN[40:], 0.0, 1),)),
    CodecCase("no body", DATAMODE[:36] + bytes(4), (PlayerMessage(PLAYER, 0, REQ, 5),)),
]  # fmt: skip


def test_messages_of_a_client_in_pieces_of_any_size() -> None:
    check_codec(Decoder, CASES, need_data=None)


@pytest.mark.parametrize(
    "data",
    [bytes(40), b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept: text/html\r\n\r\n", DATAMODE[:36] + b"\xff" * 4, DATAMODE[:8] + b"\xff" * 32],
)  # fmt: skip
def test_what_is_no_player_ends_the_connection(data: bytes) -> None:
    with pytest.raises(Refused):
        read_all(Decoder(), [data], None)


def test_bodies_are_xdr_as_the_generator_of_player_makes_it() -> None:
    """Its arrays have their number twice: a member of the structure, and that of XDR."""
    assert wire.octets(b"abcde") == b"\0\0\0\5\0\0\0\5abcde\0\0\0"
    assert wire.rows([1.0, -2.0]) == struct.pack(">IIdd", 2, 2, 1.0, -2.0)
    assert wire.read_octets(wire.octets(b"abcde")) == b"abcde"
    assert len(wire.BANNER) == 32
    for wrong in (b"", b"\0\0\0\5\0\0\0\4abcde\0\0\0", b"\0\0\0\5\0\0\0\5abc"):
        with pytest.raises(Refused):
            wire.read_octets(wrong)
    with pytest.raises(Refused):
        wire.read_u32(b"\0\0\0")


def test_data_are_told_in_a_header_of_forty_bytes() -> None:
    told = wire.encode(PlayerMessage(60, 2, DATA, 2, b"abcd", 1.5, 7, 1, 6665))
    assert told == struct.pack(">6IdII", 1, 6665, 60, 2, 1, 2, 1.5, 7, 4) + b"abcd"
    assert CMD == 2
