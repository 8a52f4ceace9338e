"""Lines: examples of the maker's manuals and library both ways, whole, byte by byte, after garbage."""

from __future__ import annotations

import math

import pytest
from devices_rig import inertial_readings
from uwserver_adapters.devices.device import Garbage, LineReader
from uwserver_adapters.devices.inertial import Fix
from uwserver_adapters.devices.vectornav_text import LINE_LIMIT, OUTPUTS, Command, Misread, error, line, read

from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

READ = Command("VNRRG", ("8",))
CASES = [
    CodecCase("read, of the manual", b"$VNRRG,8*4B\r\n", (READ,), lambda _: line("VNRRG", "8")),
    CodecCase("write, of the library's tests", b"$VNWRG,07,2*6F\r\n", (Command("VNWRG", ("07", "2")),), lambda _: line("VNWRG", "07", "2")),
    CodecCase("no checksum", b"$VNWRG,07,40*XX\n", (Command("VNWRG", ("07", "40")),)),
    CodecCase("CRC16, of the maker's examples", b"$VNRRG,75,3,400,01,0321*3B31\r\n", (Command("VNRRG", ("75", "3", "400", "01", "0321")),)),
    CodecCase("CRC16, another", b"$VNRRG,06,1,1*0865\r\n", (Command("VNRRG", ("06", "1", "1")),)),
    CodecCase("no values", b"$VNWNV*57\r\n", (Command("VNWNV"),), lambda _: line("VNWNV")),
    CodecCase("wrong sum", b"$VNRRG,8*4C\r\n", (Misread(),)),
    CodecCase("error, of the manual", b"$VNERR,03*72\r\n", (Command("VNERR", ("03",)),), lambda _: error(3)),
]  # fmt: skip
GARBAGE = (
    b"hello\n",
    b"$VNRRG\n",
    b"$$$*XX\n",
    b"\xfa\x01\x08\n",
    b"$VNRRG,\xff*XX\n",
    b"x" * (LINE_LIMIT + 1) + b"\n",
    b"\n",
    b"$VNRRG,8*4",
)


def command_reader() -> LineReader[Command | Misread | Garbage]:
    return LineReader(LINE_LIMIT, read)


def test_bytes_both_ways():
    check_codec(command_reader, CASES, need_data=None, garbage=GARBAGE)


@pytest.mark.parametrize("junk", [junk for junk in GARBAGE if junk.strip() and junk.endswith(b"\n")])
def test_garbage_is_told_and_the_next_line_read(junk: bytes):
    events = read_all(command_reader(), [junk, b"$VNRRG,8*4B\r\n"], None)
    assert events[-1] == READ
    assert any(isinstance(event, Garbage) for event in events)


def test_all_measurements_as_the_maker_prints_them():
    """Whole lines, with their checksums, of the maker's library and of users' logs; the pressure is not simulated."""
    said = inertial_readings(
        (0.715, -7.330, 100.949), (-1.258, -0.100, -9.701), (-0.000018, 0.001122, -0.000551), (-0.0049, -0.2449, 0.5397)
    )
    assert line(OUTPUTS[14].header, OUTPUTS[14].values(said)) == (
        b"$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,-00.100,-09.701,-00.000018,+00.001122,-00.000551*69\r\n"
    )
    said = inertial_readings(
        (0, 0, 0), (-0.015, 0.019, 9.948), (0.002066, -0.008442, -0.044656), (-0.0350, 0.4222, -0.6643), 20.7
    )
    assert OUTPUTS[19].values(said) == (
        "-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442,-00.044656,+20.7,+000.000"
    )
    place = (math.radians(34.6146327), math.radians(-112.4508727), 1559.954, (0.45, 0.77, -1.29))
    said = inertial_readings(fix=Fix(3, 5, *place, 2.94, 7.41, 1.672), week=1890, tow=342123.000168)
    assert OUTPUTS[20].values(said) == (
        "342123.000168,1890,3,05,+34.61463270,-112.45087270,+01559.954,+000.450,+000.770,-001.290,+002.940,+002.940,+007.410,+001.672,2.10E-08"
    )
    place = (math.radians(32.95602815), math.radians(-96.71424297), 171.195, (-0.84, -0.396, -0.109))
    said = inertial_readings((-0.225, -4.754, 9.5), fix=Fix(3, 5, *place, 1.6, 1.6, 0.23), week=1694, tow=333811.902862)
    assert OUTPUTS[22].values(said) == (
        "333811.902862,1694,0006,+009.500,-004.754,-000.225,+32.95602815,-096.71424297,+00171.195,-000.840,-000.396,-000.109,00.0,01.6,0.23"
    )


def test_a_quaternion_has_its_scalar_last():
    assert OUTPUTS[2].values(inertial_readings((0, 0, 90))) == "+0.000000,+0.000000,+0.707107,+0.707107"


def test_a_line_without_end_is_not_kept():
    reader = command_reader()
    reader.receive(b"x" * 4000)
    assert isinstance(reader.next_event(), Garbage)
