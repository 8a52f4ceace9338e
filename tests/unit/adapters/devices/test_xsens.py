"""The inertial unit: configuration, measurement, rates, refusals."""

from __future__ import annotations

import struct

import pytest
from devices_rig import ATTITUDE, IMU, ask, make_context, sample
from uwserver_adapters.devices.xbus import XbusMessage, encode
from uwserver_adapters.devices.xsens import FACTORY, Xsens, XsensTable

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
