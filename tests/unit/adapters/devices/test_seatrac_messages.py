"""Lines of the beacon: both ways, whole, byte by byte, after garbage; the check sum of the catalogue; the records of public drivers."""

from __future__ import annotations

import math
import struct

import pytest
from msgspec.structs import replace
from uwserver_adapters.devices.device import Garbage, LineReader
from uwserver_adapters.devices.seatrac_messages import (
    LINE_LIMIT,
    REQU,
    REQX,
    Found,
    Local,
    SeaTracMessage,
    crc16,
    decode,
    encode,
    fix,
)

from uwserver.frames import quat_from_rpy
from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

PING = SeaTracMessage(0x40, b"\x01\x04")
CASES = [
    CodecCase("alive", b"#01C1C0\r\n", (SeaTracMessage(1),), lambda _: encode(SeaTracMessage(1), b"#")),
    CodecCase("ping", b"#4001040187\r\n", (PING,), lambda _: encode(PING, b"#")),
    CodecCase("small letters", b"#01c1c0\n", (SeaTracMessage(1),)),
]
GARBAGE = (
    b"$01C1C0\r\n",
    b"#01C1C1\r\n",
    b"#0\r\n",
    b"#01C1C\r\n",
    b"#xyzzy!\r\n",
    b"#\xff\xff\r\n",
    b"#C1\r\n",
    b"x" * (LINE_LIMIT + 1) + b"\n",
    b"#",
)


def command_reader() -> LineReader[SeaTracMessage | Garbage]:
    return LineReader(LINE_LIMIT, decode)


def test_bytes_both_ways():
    check_codec(command_reader, CASES, need_data=None, garbage=GARBAGE, resynchronises=False)


@pytest.mark.parametrize("junk", [junk for junk in GARBAGE if junk.endswith(b"\n")])
def test_garbage_is_told_and_the_next_command_read(junk: bytes):
    events = read_all(command_reader(), [junk, b"#01C1C0\r\n"], None)
    assert events[-1] == SeaTracMessage(1)
    assert any(isinstance(event, Garbage) for event in events)


def test_the_check_sum_is_that_of_the_catalogue():
    assert crc16(b"123456789") == 0xBB3D  # CRC-16/ARC


LOCAL = Local(quat_from_rpy(math.radians(1.0), math.radians(-2.0), math.radians(-30.0)), 4.25, sound_speed=1480.0)
FOUND = Found(20.0, 0.027027, math.radians(-90.0), math.radians(30.0), (3.0, -4.0, 5.0), 9.0)


def test_a_fix_with_position():
    record = fix(15, 3, REQX + 1, LOCAL, FOUND)
    assert struct.unpack_from("<4B3hHHh", record) == (15, 3, 0x0F, 7, -300, -20, 10, 42, 14800, 0)
    count, time, distance, channels = struct.unpack_from("<IiHB", record, 16)
    # The time of one way, so that the distance is it times the sound speed.
    assert (count, distance, channels) == (432, 200, 4)
    assert 1480.0 * time / 1e7 == pytest.approx(20.0, abs=1e-3)
    assert struct.unpack_from("<4h3h3h", record, 27) == (0, 0, 0, 0, 2700, -300, 0, -40, 30, 90)
    assert len(record) == 47


def test_a_fix_without_what_is_not_known():
    assert fix(15, 3, 1, LOCAL, Found())[2:] == b"\x00\x01" + fix(15, 3, 1, LOCAL, Found())[4:16]
    assert fix(15, 3, 3, LOCAL, Found(20.0, 0.027))[2:4] == b"\x01\x03"
    assert fix(15, 3, 5, Local(), Found(20.0, 0.027, 0.0, 0.0))[2] == 0x03
    assert fix(15, 3, 1, Local(), Found(bearing=0.5))[2] == 0x02
    # The depth of a fix without the other's own is this beacon's and the way down.
    without = fix(15, 3, 5, LOCAL, replace(FOUND, depth=None))
    assert (without[2], struct.unpack("<h", without[-2:])[0]) == (0x07, 92)


def test_what_surrounds_the_beacon_is_told_in_its_units():
    """Tenths of a degree, thousandths of a bar, decimetres, decimetres a second."""
    told = replace(LOCAL, temperature=12.3, pressure=141_400.0).environment()
    assert told == bytes.fromhex("0000 7b00 86050000 2a000000 d039")


def test_what_is_too_large_for_its_field_is_the_largest():
    far = Found(1e6, 1e3, 0.0, 0.0, (1e6, -1e6, 1e6))
    assert struct.unpack("<3h", fix(15, 3, REQU + 1, LOCAL, far)[-6:]) == (-32768, 32767, 32767)
