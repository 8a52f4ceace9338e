"""The imaging sonar: what a client fires reaches the sensor, pictures go by TCP, the status by UDP; refusals change nothing."""

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
from uwserver_adapters.devices.device import Report
from uwserver_adapters.devices.oculus import Oculus, OculusTable
from uwserver_adapters.devices.oculus_messages import Fire, OculusMessage, encode

from uwserver.adapter import CannotServe
from uwserver.ports import Buffer, Fault, Field, Port, Sample
from uwserver.ports import Reply as Answer
from uwserver.ports.buffer import Layout
from uwserver.testing import FakeContext

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
