"""Lines of the beacon: both ways, whole, byte by byte, after garbage; the check sum of the catalogue; the records of public drivers.

Datagrams through a modem: what is sent, what comes, what nobody answered.
"""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any

import pytest
from devices_rig import ATTITUDE, HEARD, ask, make_context, sample
from msgspec.structs import replace
from uwserver_adapters.devices.device import Garbage, LineReader
from uwserver_adapters.devices.seatrac import SeaTrac, SeaTracBeacon, SeaTracTable
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

from uwserver.adapter import CannotServe
from uwserver.frames import quat_from_rpy
from uwserver.ports import Buffer, Fault
from uwserver.ports import Reply as Answer
from uwserver.testing import CodecCase, FakeContext, check_codec
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


TABLE = SeaTracTable(
    usbl="rov/usbl", beacons={"pole": SeaTracBeacon(id=1)}, attitude="rov/attitude", modem="rov/modem", tcp_port=0
)
EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def make() -> tuple[SeaTrac, FakeContext]:
    context = make_context()
    device = TABLE.build(context)
    device.see(sample(ATTITUDE, (EAST, math.pi / 2)))
    return device, context


def send(*payload: int, data: bytes = b"") -> bytes:
    return encode(SeaTracMessage(0x60, bytes(payload) + data), b"#")


def heard(device: SeaTrac, *value: Any) -> bytes:
    (line,) = device.see(sample(HEARD, value, 2.0))
    assert isinstance(line, bytes)
    return bytes.fromhex(line[1:].decode())[:-2]


def test_a_datagram_goes_to_the_modem_and_is_acknowledged_when_it_took_it():
    async def scene() -> None:
        device, context = make()
        replies, bad = ask(device, send(2, 2, 5, data=b"hello"))
        await asyncio.sleep(0.01)
        assert (replies, bad) == ([encode(SeaTracMessage(0x60, b"\x00\x02"))], [])
        (command,) = context.commands
        assert command.port == "rov/modem/send"
        assert command.value == ((2.0,), Buffer(data=b"hello"), (1.0,))
        ask(device, send(0, 0, 1, data=b"x"))
        assert context.commands[1].value[2] == (0.0,)

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("code", "text", "told"),
    [("busy", "", 0x30), ("bad_argument", "this line is busy being wrong", 0x01), ("bad_argument", "no", 0x01)],
)
def test_what_the_modem_refuses_is_told(code: Any, text: str, told: int):
    async def scene() -> None:
        device, context = make()
        context.held.add("rov/modem/send")
        replies, _ = ask(device, send(2, 0, 1, data=b"x"))
        assert replies == []
        context.calls[0].finish(Answer(0, 0, fault=Fault(code, text)))
        assert replies == [encode(SeaTracMessage(0x60, bytes((told, 2))))]

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("data", "code"),
    [(send(2), 0x04), (send(2, 0, 3, data=b"xx"), 0x05), (send(2, 0, 32, data=bytes(32)), 0x05), (send(15, 2, 0), 0x05),
     (send(16, 2, 0), 0x05), (send(2, 0, 0), 0x05), (send(2, 3, 1, data=b'x'), 0x05), (send(0, 2, 0), 0x05)],
)  # fmt: skip
def test_what_cannot_be_sent_is_answered_by_the_makers_code(data: bytes, code: int):
    device, context = make()
    replies, bad = ask(device, data)
    assert [reply[:5] for reply in replies] == [b"$60" + f"{code:02X}".encode()]
    assert len(bad) == 1
    assert context.commands == []


def test_a_datagram_that_came_is_told_with_its_direction():
    device, _ = make()
    told = heard(device, "data", 2, 15, Buffer(data=b"hello"), None, math.radians(90.0), 0.0)
    assert told[0] == 0x61
    assert told[1:5] == b"\x0f\x02\x02\x01"
    assert struct.unpack_from("<h", told, 1 + 16 + 9) == (900,)
    assert told[-8:] == b"\x00\x05hello\x01"
    plain = heard(device, "data", 2, 0, Buffer(data=b""), None, None, None)
    assert plain[1:5] == b"\x00\x02\x00\x00"
    assert plain[-3:] == b"\x00\x00\x01"


def test_a_datagram_that_was_delivered_brings_the_fix():
    device, _ = make()
    told = heard(device, "delivered", 15, 2, Buffer(data=b""), 30.0, 0.0, 0.0)
    assert told[1:5] == b"\x0f\x02\x07\x05"
    # Ahead of a beacon that looks east.
    assert struct.unpack_from("<3h", told, 1 + 16 + 10 + 15) == (300, 0, 0)
    assert told[-3:] == b"\x01\x00\x01"


def test_a_datagram_that_nobody_answered_is_an_error():
    device, _ = make()
    assert heard(device, "failed", 15, 2, Buffer(data=b""), None, None, None) == b"\x63\x34\x02"


def test_silence_is_no_message():
    device, _ = make()
    assert list(device.see(sample(HEARD, (None,) * 7, 2.0, valid=False))) == []


def test_without_a_modem_there_are_no_datagrams():
    context = make_context()
    device = SeaTracTable(usbl="rov/usbl", beacons={"pole": SeaTracBeacon(id=1)}, tcp_port=0).build(context)
    assert ask(device, send(2, 0, 0)) == ([], ["command 0x60 is not simulated"])
    context.ports = {path: port for path, port in context.ports.items() if path != "rov/modem/send"}
    with pytest.raises(CannotServe, match="modem"):
        TABLE.build(context)
