"""Frames: bytes of the maker's own library both ways, whole, byte by byte, after garbage."""

from __future__ import annotations

import pytest
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.ping_protocol import Frame, FrameReader, encode

from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

REQUEST = bytes.fromhex("4252 0200 0600 0000 0500 a100")
"""general_request of protocol_version, the example of the protocol's documentation."""
CASES = [
    CodecCase("request", REQUEST, (Frame(6, b"\x05\x00"),), lambda _: encode(Frame(6, b"\x05\x00"))),
    CodecCase("empty", bytes.fromhex("4252000 0bc040001 5501".replace(" ", "")), (Frame(1212, b"", 0, 1),), lambda _: encode(Frame(1212, b"", 0, 1))),
]  # fmt: skip
GARBAGE = (b"hello", REQUEST[:-1] + b"\x01", b"B", b"BR\x00", b"BRBRBR", b"\xff" * 300, b"BR\xff\xff" + b"\x00" * 20)


def test_bytes_both_ways():
    check_codec(FrameReader, CASES, need_data=None, garbage=GARBAGE)


@pytest.mark.parametrize("junk", [b"hello", REQUEST[:-1] + b"\x01", b"\xff" * 300, b"BR\xff\xff" + b"\x00" * 20])
def test_after_garbage_the_next_frame_is_read_and_the_garbage_told(junk: bytes):
    events = read_all(FrameReader(), [junk, REQUEST], None)
    assert events[-1] == Frame(6, b"\x05\x00")
    assert any(isinstance(event, Garbage) for event in events)


def test_what_wakes_the_line_is_no_garbage():
    assert read_all(FrameReader(), [b"U", REQUEST, b"UUU" + REQUEST], None) == [Frame(6, b"\x05\x00")] * 2
