"""Messages of the sonar: both ways, whole, byte by byte, after garbage; layout as in a recorded ping and in public drivers."""

from __future__ import annotations

import struct

import pytest
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.oculus_messages import (
    Fire,
    OculusMessage,
    OculusReader,
    Ping,
    encode,
    fire_of,
    result,
    status,
)

from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

# The fire message that a public driver sends first (its defaults, with gains, in metres).
FIRE = bytes.fromhex(
    "534f 0000 0000 1500 0000 25000000 0000 02 00 ff 7f 0d 52b81e85eb510440 0000000000004940 0000000000000000 0000000000000000"
)
DUMMY = bytes.fromhex("534f 0000 0000 ff00 0000 00000000 0000")
CASES = [
    CodecCase("fire", FIRE, (OculusMessage(0x15, FIRE[16:]),),
              lambda _: encode(OculusMessage(0x15, Fire(2, 0, 255, 127, 0x0D, 2.54, 50.0).payload()))),
    CodecCase("dummy", DUMMY, (OculusMessage(0xFF),), lambda _: encode(OculusMessage(0xFF))),
]  # fmt: skip
GARBAGE = (b"hello", b"S", b"SO" * 3, DUMMY[:-1], b"SO" + b"\xff" * 40, b"\xff" * 300)
PING = Ping(7, 2.1e6, 1490.0, 2_500_000_000, 0.01, (-3000, 0, 3000), (1.0, 2.0, 3.0))
PICTURE = bytes(range(12))


def test_bytes_both_ways():
    check_codec(OculusReader, CASES, need_data=None, garbage=GARBAGE)


@pytest.mark.parametrize("junk", [b"hello", b"SO" + b"\xff" * 40, b"\xff" * 300])
def test_after_garbage_the_next_message_is_read_and_the_garbage_told(junk: bytes):
    events = read_all(OculusReader(), [junk, DUMMY], None)
    assert events[-1] == OculusMessage(0xFF)
    assert any(isinstance(event, Garbage) for event in events)


def test_a_fire_message_of_either_version_comes_and_goes():
    fire = fire_of(OculusMessage(0x15, FIRE[16:]))
    assert fire == Fire(2, 0, 255, 127, 0x0D, 2.54, 50.0)
    extended = Fire(1, 5, extended=tuple(range(9)), version=2)
    assert fire_of(OculusMessage(0x15, extended.payload(), 2)) == extended
    assert fire_of(OculusMessage(0x15, FIRE[17:])) is None


def test_a_result_is_laid_out_as_a_recorded_one():
    data = result(9, Fire(2, flags=0x19, reach=2.0), PING, PICTURE)
    assert len(data) == 2048 + 12
    assert data[:16] == bytes.fromhex("534f 0900 0000 2300 0000 fc070000 0000")
    number, status_, frequency = struct.unpack_from("<IId", data, 53)
    assert (number, status_, frequency) == (7, 0, 2.1e6)
    speed, start, size, row_m, rows, beams, offset, picture, message = struct.unpack_from("<dIBdHHIII", data, 85)
    assert (speed, start, size, row_m) == (1490.0, 2_500_000, 0, 0.01)
    assert (rows, beams, offset, picture, message) == (4, 3, 2048, 12, 2060)
    assert struct.unpack_from("<3h", data, 122) == (-3000, 0, 3000)
    assert data[2048:] == PICTURE


def test_a_result_of_version_2_as_a_public_reader_has_it():
    reader = pytest.importorskip("bps_oculus.oculus", reason="oculus-python is not installed")
    fire = Fire(1, 1, extended=(0x200,) + (0,) * 8, version=2)
    data = result(9, fire, PING, PICTURE)
    said = reader.OculusSimplePingResult2.unpack(data[: reader.OculusSimplePingResult2.size()])
    assert (said.heading, said.pitch, said.roll) == (3.0, 2.0, 1.0)
    assert (said.pingStartTime, said.speedOfSoundUsed, said.nRanges, said.nBeams) == (2.5, 1490.0, 4, 3)
    assert said.fireMessage.head.payloadSize + 16 == said.imageOffset + said.imageSize == said.messageSize == len(data)
    assert (said.fireMessage.extFlags, said.fireMessage.head.srcDeviceId, said.fireMessage.head.msgVersion) == (
        0x200,
        9,
        2,
    )
    place = reader.OculusSimplePingResult2.size()
    assert struct.unpack_from("<3h", data, place) == (-3000, 0, 3000)


def test_many_beams_move_the_picture_on():
    ping = Ping(1, 1e6, 1500.0, 0, 0.01, tuple(range(1200)))
    data = result(1, Fire(), ping, bytes(1200))
    (offset,) = struct.unpack_from("<I", data, 110)
    assert offset == 122 + 2400
    assert len(data) == offset + 1200


def test_a_status_tells_where_the_sonar_is():
    data = status(0x1234, 1042, bytes((192, 168, 2, 3)), False)
    assert len(data) == 142
    assert data[2:4] == b"\x34\x12"
    device, kind, part, state = struct.unpack_from("<IHHI", data, 16)
    assert (device, kind, part, state) == (0x1234, 1, 1042, 3 | 1 << 14)
    assert data[52:56] == bytes((192, 168, 2, 3))
