"""The imaging sonar: what a client fires reaches the sensor, pictures go by TCP, the status by UDP; refusals change nothing.

Its messages: both ways, whole, byte by byte, after garbage; layout as in a recorded ping and in public drivers.
"""

from __future__ import annotations

import asyncio
import math
import socket
import struct
from typing import Any, cast

import numpy as np
import pytest
from adapter_rig import serving
from devices_rig import ATTITUDE, MULTIBEAM, ask, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.device import Garbage, Report
from uwserver_adapters.devices.oculus import (
    Fire,
    Oculus,
    OculusMessage,
    OculusReader,
    OculusTable,
    Ping,
    encode,
    fire_of,
    result,
    status,
)

from uwserver.adapter import CannotServe
from uwserver.ports import Buffer, Fault, Field, Port, Sample
from uwserver.ports import Reply as Answer
from uwserver.ports.buffer import Layout
from uwserver.testing import CodecCase, FakeContext, check_codec
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


TABLE = OculusTable(sonar="rov/multibeam", attitude="rov/attitude", model="M1200d", device_id=77, tcp_port=0)
COUNTS = np.arange(12, dtype=np.uint8).reshape(4, 3)
AZIMUTH = np.radians([-30.0, 0.0, 30.0]).astype(np.float32)


def ping(t_s: float = 1.0, start: float = 0.0, counts: Any = COUNTS) -> Sample:
    return sample(MULTIBEAM, (Buffer.of(counts), 2.0, start, Buffer.of(AZIMUTH)), t_s)


def make() -> tuple[Oculus, FakeContext]:
    context = make_context()
    return TABLE.build(context), context


def fire(**values: Any) -> bytes:
    asked = Fire(**values)
    return encode(OculusMessage(0x15, asked.payload(), asked.version))


def pictures(said: Any) -> list[bytes]:
    return [report.data for report in said if not report.by_datagram]


def layout(data: bytes) -> tuple[int, int, int, float, bytes]:
    """Bits of an item, rows, beams, metres of a row, picture of a result of version 1."""
    size, row_m, rows, beams, offset, length, whole = struct.unpack_from("<BdHHIII", data, 97)
    assert whole == len(data)
    assert offset + length == whole
    return 8 * (size + 1), rows, beams, row_m, data[offset:]


def test_a_picture_goes_as_it_is():
    device, _ = make()
    (data,) = pictures(device.see(ping()))
    assert layout(data) == (8, 4, 3, 0.5, COUNTS.tobytes())
    assert struct.unpack_from("<3h", data, 122) == (-3000, 0, 3000)
    assert data[2:4] == b"\x4d\x00"


def test_rows_before_the_first_are_empty():
    device, _ = make()
    (data,) = pictures(device.see(ping(start=1.0)))
    # Four rows from 1 m to 2 m: four of the same length stand before them.
    assert layout(data) == (8, 8, 3, 0.25, bytes(12) + COUNTS.tobytes())


def test_wide_items_and_gains_are_told_to_who_asks():
    device, _ = make()
    ask(device, fire(flags=0x01 | 0x02 | 0x04))
    (data,) = pictures(device.see(ping()))
    bits, rows, beams, _, picture = layout(data)
    assert (bits, rows, beams) == (16, 4, 3)
    assert picture[:10] == struct.pack("<I3H", 1, 0, 257, 514)
    assert len(picture) == 4 * 10


def test_attitude_goes_with_version_2():
    device, _ = make()
    half = math.radians(45.0)
    device.see(sample(ATTITUDE, ((math.cos(half), 0.0, 0.0, math.sin(half)), 0.0)))
    ask(device, fire(extended=(0,) * 9, version=2))
    (data,) = pictures(device.see(ping()))
    assert struct.unpack_from("<3d", data, 89 + 32) == pytest.approx((90.0, 0.0, 0.0))


def test_what_a_client_fires_reaches_the_sensor_once():
    async def scene() -> None:
        device, context = make()
        assert ask(device, fire(mode=2, reach=12.5, gain=75.0) * 3) == ([], [])
        assert [dict(call.args) for call in context.calls] == [{"range": 12.5, "gain": 10.0, "mode": "high"}]
        ask(device, fire(mode=2, flags=0x08, reach=50.0, gain=75.0))
        ask(device, fire(mode=2, reach=500.0, gain=75.0))
        assert [call.args["range"] for call in context.calls[1:]] == [20.0, 40.0]

    asyncio.run(scene())


def test_pings_come_no_faster_than_asked_for_and_not_in_standby():
    device, _ = make()
    ask(device, fire(ping_rate=3))
    said = [data for k in range(150) for data in pictures(device.see(ping(k / 15)))]
    assert len(said) == 50
    ask(device, fire(ping_rate=5))
    said = [data for k in range(150) for data in pictures(device.see(ping(20 + k / 15)))]
    # In standby clients hear that it lives.
    assert {data[6:8] for data in said} == {b"\xff\x00"}
    assert len(said) == 10


@pytest.mark.parametrize(
    "data",
    [fire(mode=0), fire(ping_rate=9), fire(reach=0.0), fire(reach=math.nan), fire(gain=101.0), fire(gain=math.inf), fire(sound_speed=1.0),
     fire(salinity=-1.0), encode(OculusMessage(0x15, b"\x01")), encode(OculusMessage(0x55, bytes(12)))],
)  # fmt: skip
def test_what_cannot_be_done_is_counted_and_changes_nothing(data: bytes):
    device, context = make()
    before = device.fire
    replies, bad = ask(device, data)
    assert (replies, len(bad), device.fire, context.calls) == ([], 1, before, [])


def test_what_the_sensor_refuses_later_is_counted():
    async def scene() -> None:
        device, context = make()
        context.held.add("rov/multibeam/set")
        ask(device, fire(reach=3.0))
        context.calls[0].finish(Answer(0, 0, fault=Fault("internal", "it is broken")))
        assert context.stats.errors == 1
        assert "broken" in context.stats.last_error

    asyncio.run(scene())


def test_out_of_the_water_there_is_no_picture():
    device, _ = make()
    assert pictures(device.see(sample(MULTIBEAM, (None, 2.0, 0.0, None), 1.0, valid=False))) == []


def test_a_sensor_of_pressures_is_refused():
    context = make_context()
    image = Field("image", "Pa", "x", type="buffer", buffer=Layout("float32", (-1, -1)))
    context.ports = {
        **context.ports,
        MULTIBEAM.path: Port(MULTIBEAM.path, "sensor", "multibeam", (image, *MULTIBEAM.fields[1:]), "x", 15.0),
    }
    with pytest.raises(CannotServe, match="counts"):
        TABLE.build(context)


def test_pictures_go_by_tcp_and_the_status_by_udp():
    async def scene() -> tuple[bytes, bytes]:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.bind(("127.0.0.1", 0))
        listener.setblocking(False)
        table = OculusTable(sonar="rov/multibeam", tcp_port=0, udp_to=(f"127.0.0.1:{listener.getsockname()[1]}",))
        loop = asyncio.get_running_loop()
        async with serving(DevicesAdapter(DevicesAdapter.Config(device={"sonar": table}), make_context())) as context:
            host, _, port = cast(Any, context.stats.details["devices"])["sonar"]["tcp"].rpartition(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(fire(mode=2))
            while not context.calls:
                await asyncio.sleep(0.01)
            context.put([ping()])
            status = await loop.sock_recv(listener, 4096)
            head = await reader.readexactly(16)
            (size,) = struct.unpack_from("<I", head, 10)
            data = head + await reader.readexactly(size)
            writer.close()
        listener.close()
        return status, data

    status, data = asyncio.run(asyncio.wait_for(scene(), 120))
    assert (len(status), status[52:56]) == (142, bytes((127, 0, 0, 1)))
    assert layout(data)[4] == COUNTS.tobytes()
    assert data[16] == 2


def test_a_report_says_by_which_way_it_goes():
    device, _ = make()
    assert [report.by_datagram for report in device.see(ping())] == [True, False]
    assert isinstance(device.see(ping(5.0))[0], Report)
