"""The beacon: requests wait for the fix of their beacon, and are told where none comes; status at its rate; TCP."""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any, cast

import pytest
from adapter_rig import serving
from devices_rig import ATTITUDE, DEPTH, USBL, ask, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.seatrac import SeaTrac, SeaTracBeacon, SeaTracTable
from uwserver_adapters.devices.seatrac_messages import SeaTracMessage, crc16, encode

BEACONS = {"pole": SeaTracBeacon(id=1), "fish": SeaTracBeacon(id=2, depth="rov/depth", attitude="rov/attitude")}
TABLE = SeaTracTable(usbl="rov/usbl", beacons=BEACONS, attitude="rov/attitude", depth="rov/depth", tcp_port=0)
EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def command(number: int, payload: bytes = b"") -> bytes:
    return encode(SeaTracMessage(number, payload), b"#")


def read(line: bytes) -> SeaTracMessage:
    """A message of the beacon, as a driver reads it."""
    assert line[:1] == b"$"
    assert line.endswith(b"\r\n")
    body = bytes.fromhex(line[1:].decode())
    assert crc16(body[:-2]) == int.from_bytes(body[-2:], "little")
    return SeaTracMessage(body[0], body[1:-2])


def answers(device: SeaTrac, data: bytes) -> list[SeaTracMessage]:
    replies, bad = ask(device, data)
    assert bad == []
    return [read(reply) for reply in replies]


def fixed(beacon: str, t_s: float = 1.0) -> Any:
    return sample(USBL, (beacon, 15.0, 0.0, 0.0, (15.0, 0.0, 0.0), 0.02), t_s)


def make() -> SeaTrac:
    device = TABLE.build(make_context())
    device.see(sample(ATTITUDE, (EAST, math.pi / 2)))
    device.see(sample(DEPTH, (4.0, 11.5)))
    return device


def test_a_ping_is_answered_by_the_fix_of_its_beacon_and_no_other():
    device = make()
    replies, _ = ask(device, command(0x40, b"\x01\x04"))
    assert [read(reply) for reply in replies] == [SeaTracMessage(0x40, b"\x00\x01")]
    device.see(fixed("fish"))
    assert len(replies) == 1
    device.see(fixed("pole"))
    told = read(replies[1])
    assert told.number == 0x42
    # Ahead of a beacon that looks east.
    assert struct.unpack("<3h", told.payload[-6:]) == (150, 0, 40)
    assert struct.unpack_from("<H", told.payload, 12) == (15000,)
    device.see(fixed("pole"))
    assert len(replies) == 2


def test_a_navigation_query_brings_what_the_other_tells_of_itself():
    device = make()
    replies, _ = ask(device, command(0x50, b"\x02\x0f\x00"))
    device.see(fixed("fish"))
    told = read(replies[1])
    assert told.number == 0x52
    assert told.payload[2:4] == b"\x0f\x07"
    flags, depth, temperature, yaw, pitch, roll, local = struct.unpack("<BihhhhB", told.payload[47:])
    # Supply is not there, and so its flag is not.
    assert (flags, depth, temperature, yaw, pitch, roll, local) == (0x0D, 40, 115, 900, 0, 0, 1)


@pytest.mark.parametrize(("request_", "error"), [(b"\x01\x04", 0x43), (b"\x02\x01\x00", 0x53)])
def test_no_answer_is_told(request_: bytes, error: int):
    device = make()
    beacon = "pole" if request_[0] == 1 else "fish"
    replies, _ = ask(device, command(0x40 if error == 0x43 else 0x50, request_))
    device.see(sample(USBL, (beacon, None, None, None, (None,) * 3, None), 1.0, valid=False))
    assert read(replies[1]) == SeaTracMessage(error, bytes((0x34, request_[0])))


def test_a_beacon_that_is_not_there_does_not_answer():
    device = make()
    replies, _ = ask(device, command(0x40, b"\x09\x04"))
    device.see(fixed("fish"))
    assert read(replies[1]) == SeaTracMessage(0x43, b"\x34\x09")


def test_one_request_at_a_time_and_a_reset_ends_it():
    device = make()
    first, _ = ask(device, command(0x40, b"\x01\x04"))
    assert answers(device, command(0x3A)) == [SeaTracMessage(0x3A, b"\x3d")]
    assert answers(device, command(0x40, b"\x02\x04")) == [SeaTracMessage(0x40, b"\x30\x02")]
    device.reset()
    assert read(first[1]) == SeaTracMessage(0x43, b"\x34\x01")
    assert answers(device, command(0x3A)) == [SeaTracMessage(0x3A, b"\x3b")]


def test_status_comes_at_its_rate_and_holds_what_was_configured():
    device = make()
    assert answers(device, command(0x11)) == [SeaTracMessage(0x11, b"\x03\x01")]
    assert answers(device, command(0x12, b"\x02\x04")) == [SeaTracMessage(0x12, b"\x00")]
    said = [line for k in range(101) for line in device.see(sample(ATTITUDE, (EAST, 0.0), 1 + k / 50))]
    assert len(said) == 21
    content, ms, yaw, pitch, roll = struct.unpack("<BQhhh", read(said[-1]).payload)
    assert (content, ms, yaw, pitch, roll) == (2, 3000, 900, 0, 0)
    answers(device, command(0x12, b"\x01\x00"))
    assert device.see(sample(ATTITUDE, (EAST, 0.0), 10.0)) == []
    (status,) = answers(device, command(0x10))
    assert struct.unpack("<BQHhiiH", status.payload) == (1, 10_000, 0, 115, 0, 40, 15000)


@pytest.mark.parametrize(
    ("data", "answer"),
    [
        (command(0x40, b"\x01"), SeaTracMessage(0x40, b"\x04\x01")), (command(0x40, b"\x00\x04"), SeaTracMessage(0x40, b"\x05\x00")),
        (command(0x40, b"\x0f\x04"), SeaTracMessage(0x40, b"\x05\x0f")), (command(0x40, b"\x01\x00"), SeaTracMessage(0x40, b"\x05\x01")),
        (command(0x50, b"\x01"), SeaTracMessage(0x50, b"\x04\x00")), (command(0x12, b"\x04\x01"), SeaTracMessage(0x12, b"\x05")),
        (command(0x12, b"\x03\x06"), SeaTracMessage(0x12, b"\x05")), (command(0x12, b"\x03"), SeaTracMessage(0x12, b"\x04")),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_answered_by_the_makers_code_and_changes_nothing(data: bytes, answer: SeaTracMessage):
    device = make()
    replies, bad = ask(device, data)
    assert [read(reply) for reply in replies] == [answer]
    assert len(bad) == 1
    assert answers(device, command(0x11) + command(0x3A)) == [
        SeaTracMessage(0x11, b"\x03\x01"),
        SeaTracMessage(0x3A, b"\x3b"),
    ]


def test_an_unknown_command_is_counted():
    assert ask(make(), command(0x60, b"\x01")) == ([], ["command 0x60 is not simulated"])


def test_it_says_who_it_is():
    (alive, information) = answers(make(), command(1) + command(2))
    assert alive.payload == bytes(4)
    assert struct.unpack_from("<IBH", information.payload) == (0, 1, 795)
    assert len(information.payload) == 39


def test_two_beacons_of_one_number_are_refused():
    with pytest.raises(ValueError, match="same id"):
        SeaTracTable(usbl="rov/usbl", beacons={"a": SeaTracBeacon(id=15)}, tcp_port=0)


def test_a_peer_on_tcp_pings():
    async def scene() -> list[bytes]:
        adapter = DevicesAdapter(DevicesAdapter.Config(device={"usbl": TABLE}), make_context())
        async with serving(adapter) as context:
            host, _, port = cast(Any, context.stats.details["devices"])["usbl"]["tcp"].rpartition(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(b"garbage\r\n" + command(0x40, b"\x01\x02"))
            lines = [await reader.readline()]
            context.put([fixed("pole")])
            while len(lines) < 2 or not lines[-1].startswith(b"$42"):
                lines.append(await reader.readline())
            writer.close()
            assert context.stats.errors == 1
            return lines

    lines = asyncio.run(asyncio.wait_for(scene(), 120))
    assert read(lines[0]) == SeaTracMessage(0x40, b"\x00\x01")
    assert read(lines[-1]).payload[2:4] == b"\x01\x03"
