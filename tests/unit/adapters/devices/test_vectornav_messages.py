"""Lines: examples of the maker's manuals and library both ways, whole, byte by byte, after garbage.

Binary outputs: lengths of the maker's table, values, check sums; what is not simulated is refused.
"""

from __future__ import annotations

import math
import struct
from datetime import datetime, timedelta, timezone

import pytest
from devices_rig import inertial_readings
from msgspec import structs
from uwserver_adapters.devices.device import Garbage, LineReader
from uwserver_adapters.devices.inertial import Fix
from uwserver_adapters.devices.vectornav_messages import (
    FIELDS,
    LINE_LIMIT,
    OUTPUTS,
    BinaryOutput,
    Command,
    Misread,
    crc16,
    ecef,
    encode,
    error,
    fault_of,
    line,
    read,
)

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


# Bytes of each field of groups 1 to 6, as the maker's library has them.
LENGTHS = (
    (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),
    (8, 8, 8, 2, 8, 8, 8, 4, 4, 1),
    (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40),
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
    (2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24),
    (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64),
)
PLACE = (math.radians(60.0), math.radians(10.0), 20.0, (1.0, 0.0, 0.0))
SAID = inertial_readings(
    (10, 20, 30), (0.0, 0.0, -9.8), (0.1, 0.2, 0.3), (0.1, 0.0, 0.5), 11.5, Fix(3, 7, *PLACE, 2.0, 3.0, 0.1), 2300, 5.25
)


@pytest.mark.parametrize("group", range(6))
def test_each_field_has_the_makers_length(group: int):
    for bit, field in FIELDS[group].items():
        assert len(field(SAID)) == LENGTHS[group][bit], bit


@pytest.mark.parametrize("year", [1, 1975, 2500, 9999])
def test_a_world_far_from_now_has_the_nearest_time_that_a_field_holds(year: int):
    began = datetime(year, 12, 31, 23, 59, 59, tzinfo=timezone.utc) - datetime(1970, 1, 1, tzinfo=timezone.utc)
    said = structs.replace(SAID, epoch_ns=began // timedelta(seconds=1) * 10**9, t_ns=5 * 10**9)
    for group, fields in enumerate(FIELDS):
        for bit, field in fields.items():
            assert len(field(said)) == LENGTHS[group][bit], bit
    assert year > 1980 or (said.gps_ns, said.gps_week, said.gps_tow_ns) == (0, 0, 0)


def test_a_message_whole():
    output = BinaryOutput(1, 8, 0b1, (1 << 3 | 1 << 5,))
    data = encode(output, SAID)
    assert data[:4] == b"\xfa\x01\x28\x00"
    assert struct.unpack("<6f", data[4:-2]) == pytest.approx((30, 20, 10, 0.1, 0.2, 0.3), abs=1e-5)
    # The sum of all behind the first byte, with the sum itself, is 0: so the maker's manual has it checked.
    assert crc16(data[1:]) == 0


def test_fields_stand_in_the_order_of_groups_and_bits():
    data = encode(BinaryOutput(1, 8, 0b100010, (1 << 2 | 1 << 3 | 1 << 6, 1 << 0 | 1 << 1)), SAID)
    assert data[:6] == b"\xfa\x22\x4c\x00\x03\x00"
    tow, week, year, month, day, hour, minute, second, ms = struct.unpack("<QHbBBBBBH", data[6:24])
    assert (tow, week) == (5_250_000_000, 2300)
    assert (year, month, day, hour, minute, second, ms) == (24, 2, 3, 23, 59, 47, 250)
    status, latitude, longitude, height = struct.unpack("<H3d", data[24:-2])
    assert (status, height) == (6, 20.0)
    assert (latitude, longitude) == pytest.approx((60.0, 10.0))


def test_each_measures_in_the_makers_unit():
    """Gauss, m/s2, rad/s, and degrees Celsius: fields 1 to 4 of the group of the IMU."""
    magnetic, acceleration, rotation, temperature = (FIELDS[2][bit](SAID) for bit in (1, 2, 3, 4))
    assert struct.unpack("<3f", magnetic) == pytest.approx((0.1, 0.0, 0.5))
    assert struct.unpack("<3f", acceleration) == pytest.approx((0.0, 0.0, -9.8))
    assert struct.unpack("<3f", rotation) == pytest.approx((0.1, 0.2, 0.3))
    assert struct.unpack("<f", temperature) == pytest.approx((11.5,))


def test_the_earths_axes():
    # Three points of which the answer is known without a formula.
    assert ecef(0.0, 0.0, 10.0) == pytest.approx((6_378_147.0, 0.0, 0.0))
    assert ecef(0.0, math.pi / 2, 0.0) == pytest.approx((0.0, 6_378_137.0, 0.0), abs=1e-6)
    assert ecef(math.pi / 2, 0.0, 0.0) == pytest.approx((0.0, 0.0, 6_356_752.3142), abs=1e-3)
    north_at_equator = inertial_readings(fix=Fix(3, 7, 0.0, math.pi / 2, 0.0, (1.0, 2.0, 3.0)))
    assert struct.unpack("<3f", FIELDS[5][5](north_at_equator)) == pytest.approx((-2.0, -3.0, 1.0))


def test_body_and_navigation_frames():
    said = inertial_readings((0, 0, 90), (1.0, 0.0, -9.8), gauss=(0.5, 0.0, 0.0), fix=Fix(3, 7, *PLACE))
    assert struct.unpack("<3f", FIELDS[5][3](said)) == pytest.approx((0.0, -1.0, 0.0), abs=1e-6)
    assert struct.unpack("<3f", FIELDS[4][5](said)) == pytest.approx((0.0, 1.0, -9.8), abs=1e-6)
    assert struct.unpack("<3f", FIELDS[4][4](said)) == pytest.approx((0.0, 0.5, 0.0), abs=1e-6)
    # Columns of the matrix from N to the body: north is -y of the body.
    assert struct.unpack("<9f", FIELDS[4][3](said))[:3] == pytest.approx((0.0, -1.0, 0.0), abs=1e-6)


def test_a_quaternion_in_binary_has_its_scalar_last():
    said = inertial_readings((0, 0, 90))
    assert struct.unpack("<4f", FIELDS[0][4](said)) == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))


def test_without_a_fix_there_is_no_place():
    assert FIELDS[3][6](inertial_readings()) == bytes(24)


@pytest.mark.parametrize(
    "output", [BinaryOutput(1, 8, 0x40, (1,)), BinaryOutput(1, 8, 1, ()), BinaryOutput(1, 8, 1, (1 << 11,)), BinaryOutput(1, 8, 3, (1,))]
)  # fmt: skip
def test_what_is_not_simulated_is_told(output: BinaryOutput):
    assert fault_of(output)
