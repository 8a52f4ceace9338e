"""The inertial unit: configuration, measurement, rates, refusals.

Its messages and items: recorded ones of users both ways, whole, byte by byte, after garbage; axes and frames.
"""

from __future__ import annotations

import math
import struct

import pytest
from devices_rig import ATTITUDE, IMU, ask, inertial_readings, make_context, sample
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.inertial import Fix
from uwserver_adapters.devices.xsens import (
    ENU,
    FACTORY,
    NWU,
    XbusMessage,
    XbusReader,
    Xsens,
    XsensTable,
    encode,
    fault_of,
    item,
    orientation,
    real,
)

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


TABLE = XsensTable(imu="rov/imu", attitude="rov/attitude", product_code="MTi-7", device_id=0x1234, tcp_port=0)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def make() -> Xsens:
    device = TABLE.build(make_context())
    device.see(sample(ATTITUDE, (LEVEL, 0.0)))
    return device


def said(device: Xsens, t_s: float) -> list[bytes]:
    return list(device.see(sample(IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5), t_s)))


def answers(device: Xsens, number: int, data: bytes = b"") -> list[bytes]:
    return ask(device, encode(XbusMessage(number, data)))[0]


def configuration(*items: tuple[int, int]) -> bytes:
    return b"".join(struct.pack(">HH", *each) for each in items)


def test_it_says_who_it_is():
    device = make()
    assert answers(device, 0x00) == [encode(XbusMessage(0x01, b"\x00\x00\x12\x34"))]
    assert answers(device, 0x1C) == [encode(XbusMessage(0x1D, b"MTi-7".ljust(20)))]
    assert len(answers(device, 0x12)[0]) == 8
    assert answers(device, 0x1E) == [encode(XbusMessage(0x1F, b"\x02\x00"))]


def test_it_is_configured_and_measures_as_configured():
    device = make()
    assert answers(device, 0x30) == [encode(XbusMessage(0x31))]
    assert said(device, 0.5) == []
    items = configuration((0x1020, 0xFFFF), (0x2030, 10), (0x4020, 40))
    assert answers(device, 0xC0, items) == [encode(XbusMessage(0xC1, items))]
    assert answers(device, 0xC0) == [encode(XbusMessage(0xC1, items))]
    assert answers(device, 0x10) == [encode(XbusMessage(0x11))]
    messages = [message for k in range(200) for message in said(device, 1.0 + k / 200)]
    assert len(messages) == 40
    full, short = messages[0], messages[1]
    assert full[4:9] == bytes.fromhex("1020020001")
    assert (full[9:12], full[24:27]) == (bytes.fromhex("20300c"), bytes.fromhex("40200c"))
    assert short[9:12] == bytes.fromhex("40200c")
    assert sum(message[9:11] == b"\x20\x30" for message in messages) == 10
    assert struct.unpack_from(">f", short, 20) == pytest.approx((9.8,))


def test_an_empty_configuration_sends_nothing_and_a_reset_brings_the_factorys_back():
    device = make()
    assert answers(device, 0xC0, bytes(4)) == [encode(XbusMessage(0xC1, bytes(4)))]
    assert said(device, 1.0) == []
    answers(device, 0x30)
    assert answers(device, 0x40) == [encode(XbusMessage(0x41))]
    assert device.items == FACTORY
    assert len(said(device, 2.0)) == 1


def test_items_without_a_rate_of_their_own_come_with_every_reading():
    device = make()
    answers(device, 0xC0, configuration((0x1020, 0xFFFF)))
    assert [message[7:9] for k in range(3) for message in said(device, 1 + k / 200)] == [
        b"\x00\x01",
        b"\x00\x02",
        b"\x00\x03",
    ]


@pytest.mark.parametrize(
    ("number", "data", "code"),
    [
        (0xC0, b"\x20", 0x21), (0xC0, configuration((0x4030, 100)), 0x21), (0xC0, configuration((0x5042, 4)), 0x21),
        (0xC0, configuration((0x2034, 4)), 0x21), (0xC0, configuration((0x2030, 2001)), 0x21), (0xC0, bytes(4) * 2, 0x21),
        (0xC0, configuration((0x2030, 1)) * 33, 0x21), (0x64, b"", 0x04),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_answered_by_the_makers_code_and_changes_nothing(number: int, data: bytes, code: int):
    device = make()
    replies, bad = ask(device, encode(XbusMessage(number, data)))
    assert replies == [encode(XbusMessage(0x42, bytes((code,))))]
    assert len(bad) == 1
    assert device.items == FACTORY


def test_after_a_reset_of_the_world_time_begins_again():
    device = make()
    assert len(said(device, 50.0)) == 1
    device.reset()
    assert said(device, 0.0) == []  # there is no attitude yet
    device.see(sample(ATTITUDE, (LEVEL, 0.0)))
    assert len(said(device, 0.0)) == 1
