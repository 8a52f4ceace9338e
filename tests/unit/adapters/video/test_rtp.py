"""Packets of RTP, and H.264 and JPEG in them, against what receivers put together again."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from uwserver_adapters.video import h264, mjpeg
from uwserver_adapters.video.rtp import Packets

from uwserver.adapter.pictures import jpeg


def joined(payloads: list[bytes]) -> list[bytes]:
    """NAL units of payloads, as RFC 6184 has a receiver do it."""
    units: list[bytes] = []
    part = b""
    for payload in payloads:
        if payload[0] & 0x1F != 28:
            units.append(payload)
            continue
        head = payload[1]
        if head & 0x80:
            assert part == b""
            part = bytes([(payload[0] & 0xE0) | (head & 0x1F)])
        part += payload[2:]
        if head & 0x40:
            units.append(part)
            part = b""
    assert part == b""
    return units


@pytest.mark.parametrize("start", [b"\0\0\1", b"\0\0\0\1"])
def test_nal_units_of_a_byte_stream(start):
    units = [b"\x67\x42\xc0\x1e", b"\x68\xce", b"\x65" + bytes([1, 0, 0, 3, 1, 0, 7])]
    assert h264.nal_units(b"".join(start + unit for unit in units)) == units
    assert h264.nal_units(b"") == h264.nal_units(b"abc") == []
    assert h264.is_key(units)
    assert not h264.is_key([b"\x41\x00"])


@pytest.mark.parametrize("size", [1, 2, 99, 100, 101, 198, 199, 200, 5000])
def test_units_are_the_same_after_their_fragments_are_joined(size):
    unit = b"\x65" + bytes(k * 7 % 256 for k in range(size - 1))
    payloads = h264.payloads([unit, b"\x41abc"], 100)
    assert all(2 <= len(payload) <= 100 or size == 1 for payload in payloads)
    assert joined(payloads) == [unit, b"\x41abc"]
    assert len(payloads) == 2 if size <= 100 else len(payloads) == 1 + -(-(size - 1) // 98)


def test_parameters_in_a_description():
    units = [b"\x67\x42\xc0\x1e\x95", b"\x68\xce\x3c\x80", b"\x65abc"]
    sets = h264.parameter_sets(units)
    assert sets == (units[0], units[1])
    assert h264.format_parameters(sets) == (
        "packetization-mode=1;profile-level-id=42c01e;sprop-parameter-sets=Z0LAHpU=,aM48gA=="
    )
    assert h264.parameter_sets(units[1:]) is None
    assert h264.format_parameters(None) == "packetization-mode=1"


def test_heads_count_mark_and_stamp():
    packets = Packets(96, 0x01020304, 65535, 0xFFFF_FFFF, 0)
    found = packets.of([b"ab", b"c"], 1_000_000_000)
    assert found[0] == struct.pack(">BBHII", 0x80, 96, 65535, 89_999, 0x01020304) + b"ab"
    assert found[1] == struct.pack(">BBHII", 0x80, 0x80 | 96, 0, 89_999, 0x01020304) + b"c"
    assert packets.seq == 1
    (later,) = packets.of([b"d"], 1_040_000_000)
    assert struct.unpack_from(">I", later, 4)[0] == 89_999 + 3600


def test_a_report_tells_the_time_of_the_simulation():
    packets = Packets(96, 7, 0, 0, 1_704_067_200_000_000_000)  # 2024-01-01
    packets.of([b"abc", b"de"], 0)
    report = packets.report(2_500_000_000)
    kind, words, source, seconds, part, stamp, count, octets = struct.unpack_from(">xBHIIIIII", report)
    assert (kind, words, source, stamp, count, octets) == (200, 6, 7, 225_000, 2, 5)
    assert (seconds - 2_208_988_800, part) == (1_704_067_202, 1 << 31)
    name = report[28:]
    assert struct.unpack_from(">BBHI", name) == (0x81, 202, len(name) // 4 - 1, 7)
    assert name[8:].startswith(b"\x01\x08uwserver\x00")
    assert len(report) % 4 == 0


def frame(height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x * 3 % 256, y * 2 % 256, (x + y) % 256], axis=2).astype(np.uint8)


@pytest.mark.parametrize("size", [(48, 64), (120, 160)])
def test_jpeg_is_the_same_after_its_pieces_are_joined(size):
    data = jpeg(frame(*size))
    payloads = mjpeg.payloads(data, 300)
    assert all(len(payload) <= 300 for payload in payloads)
    scan = b""
    for k, payload in enumerate(payloads):
        at, kind, quality, width, height = struct.unpack_from(">I4B", payload)
        assert (at, kind, quality, width * 8, height * 8) == (len(scan), 1, 255, size[1], size[0])
        rest = payload[8:]
        if k == 0:
            assert struct.unpack_from(">BBH", rest) == (0, 0, 128)
            tables, rest = rest[4:132], rest[132:]
        scan += rest
    assert tables[:64] in data
    assert tables[64:] in data
    assert data.endswith(scan + b"\xff\xd9")


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"abc", jpeg(frame(48, 64))[:150]])
def test_what_is_no_whole_head_of_a_jpeg(data):
    with pytest.raises(mjpeg.NotSendable):
        mjpeg.payloads(data, 300)


def test_grey_and_wide_ones_are_refused():
    with pytest.raises(mjpeg.NotSendable, match="three components"):
        mjpeg.payloads(jpeg(frame(48, 64)[:, :, 0].copy()), 300)
    with pytest.raises(mjpeg.NotSendable, match="2040 pixels"):
        mjpeg.payloads(jpeg(frame(16, 2048)), 300)
