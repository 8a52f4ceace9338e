"""Messages and items: recorded ones of users both ways, whole, byte by byte, after garbage; axes and frames."""

from __future__ import annotations

import math
import struct

import pytest
from devices_rig import inertial_readings
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.inertial import Fix
from uwserver_adapters.devices.xbus import ENU, NWU, XbusMessage, XbusReader, encode, fault_of, item, orientation, real

from uwserver.frames import rpy_from_quat
from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

# Of users' logs: time and Euler angles; counter and Euler angles; rate of turn alone.
RECORDED = (
    "FA FF 36 16 10 60 04 09 3A 7C B7 20 30 0C BF 49 1A 52 BE C3 6A 10 C3 2E E2 EF 3E",
    "FA FF 36 14 10 20 02 00 09 20 30 0C BF BC 67 E0 3E DF AE 81 40 A3 A9 DF A7",
    "FA FF 36 0F 80 40 0C 3B 8B BC 00 BB E2 4F 00 3B 4E 4A 00 AF",
)
FRAMES = [bytes.fromhex(text) for text in RECORDED]


def recorded(data: bytes) -> CodecCase:
    message = XbusMessage(0x36, data[4:-1])
    return CodecCase(data[:8].hex(), data, (message,), lambda _: encode(message))


LONG = XbusMessage(0x36, bytes(range(256)) * 2)
CASES = [
    *(recorded(data) for data in FRAMES),
    CodecCase("GoToConfig, of the manual", bytes.fromhex("FAFF3000D1"), (XbusMessage(0x30),), lambda _: encode(XbusMessage(0x30))),
    CodecCase("long", bytes.fromhex("FAFF36FF0200") + LONG.data + b"\xca", (LONG,), lambda _: encode(LONG)),
]  # fmt: skip
GARBAGE = (
    b"hello",
    b"\xfa",
    b"\xfa" * 9,
    b"\xfa\xff\x30\x00\xd2",
    b"\xfa\xff\x36\xff\xff\xff" + bytes(9),
    b"\xfa\x77\x00\x00\x00",
    bytes(300),
)


def test_bytes_both_ways():
    check_codec(XbusReader, CASES, need_data=None, garbage=GARBAGE)


@pytest.mark.parametrize("junk", [junk for junk in GARBAGE if junk != b"\xfa"])
def test_after_garbage_the_next_message_is_read_and_the_garbage_told(junk: bytes):
    events = read_all(XbusReader(), [junk, FRAMES[0], FRAMES[0]], None)
    assert events[-1] == XbusMessage(0x36, FRAMES[0][4:-1])
    assert any(isinstance(event, Garbage) for event in events)


def test_items_stand_as_in_a_recorded_message():
    said = inertial_readings(tow=15_485_099.1)  # 154850.991 s at 10 kHz
    assert item(0x1060, inertial_readings(tow=0x093A7CB7 / 1e4), 0) == FRAMES[0][4:11]
    assert item(0x1020, said, 9) == FRAMES[1][4:9]
    assert item(0x2030, said, 0)[:3] == FRAMES[0][11:14]
    assert len(item(0x2030, said, 0)) == 15


@pytest.mark.parametrize(
    ("rpy_deg", "local", "told_deg"),
    [
        ((0, 0, 0), ENU, (0, 0, 90)),  # north is along y
        ((0, 0, 90), ENU, (0, 0, 0)),  # east is along x
        ((0, 0, 0), NWU, (0, 0, 0)),
        ((0, 0, 90), NWU, (0, 0, -90)),
        ((0, 10, 90), ENU, (0, -10, 0)),  # the nose up is a turn about the axis to the left, backwards
        ((10, 0, 90), ENU, (10, 0, 0)),
    ],
)
def test_orientation_is_that_of_forward_left_up(rpy_deg, local: int, told_deg):
    q = orientation(inertial_readings(rpy_deg).q_NS, local)
    roll, pitch, yaw = rpy_from_quat(q)
    told = tuple(math.degrees(angle) for angle in (roll, pitch, math.remainder(yaw, 2 * math.pi)))
    assert told == pytest.approx(told_deg, abs=1e-9)


def test_at_rest_the_acceleration_is_upwards():
    said = inertial_readings(f_S=(0.1, 0.2, -9.8), w_S=(1.0, 2.0, 3.0), gauss=(0.5, 0.25, 0.0))
    assert struct.unpack(">3f", item(0x4020, said, 0)[3:]) == pytest.approx((0.1, -0.2, 9.8))
    assert struct.unpack(">3d", item(0x8023, said, 0)[3:]) == pytest.approx((1.0, -2.0, -3.0))
    assert struct.unpack(">3f", item(0xC020, said, 0)[3:]) == pytest.approx((1.0, -0.5, 0.0))


def test_velocity_goes_along_the_local_frame():
    said = inertial_readings(fix=Fix(3, 7, 1.0, 0.5, 2.0, (1.0, 2.0, 3.0)))
    assert struct.unpack(">3d", item(0xD013, said, 0)[3:]) == pytest.approx((2.0, 1.0, -3.0))
    assert struct.unpack(">3d", item(0xD01B, said, 0)[3:]) == pytest.approx((1.0, -2.0, -3.0))
    assert struct.unpack(">2d", item(0x5043, said, 0)[3:]) == pytest.approx((math.degrees(1.0), math.degrees(0.5)))
    assert item(0xE020, said, 0)[3:] == b"\x00\x00\x00\x07"


def test_time_is_that_of_the_world():
    said = item(0x1010, inertial_readings(week=2295, tow=86_418.25), 0)[3:]
    assert struct.unpack(">IH6B", said) == (250_000_000, 2024, 1, 1, 0, 0, 0, 7)


def test_fixed_point():
    assert real(1.5, 1) == bytes.fromhex("00180000")
    assert real(-1.5, 1) == bytes.fromhex("ffe80000")
    # 16.32: the fraction first.
    assert real(-1.5, 2) == bytes.fromhex("80000000fffe")
    assert real(1e9, 1) == bytes.fromhex("7fffffff")
    assert real(1e9, 2) == bytes.fromhex("ffffffff7fff")


def test_what_is_not_simulated_is_told():
    assert fault_of(0x4030, True)
    assert fault_of(0x2014, True)  # NED
    assert fault_of(0x5040, False)
    assert [fault_of(number, True) for number in (0x1010, 0x201B, 0x5042, 0xD012)] == [""] * 4
