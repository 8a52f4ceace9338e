"""The adapter over real sockets and a pseudo-terminal: reports, answers, limits, errors of its table."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pty
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import msgspec
import pytest
from adapter_rig import serving
from devices_rig import ALTIMETER, DVL, LOCKED, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.device import REQUESTS_PER_S
from uwserver_adapters.devices.nmea0183 import Nmea0183Table, is_sentence
from uwserver_adapters.devices.ping360 import Ping360Table
from uwserver_adapters.devices.water_linked_a50 import WaterLinkedA50Table

from uwserver.adapter import CannotListen, CannotServe
from uwserver.ports import Event
from uwserver.testing import FakeContext

GET = b'{"command":"get_config"}\n'


def run(scene: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(scene(), 120))


@asynccontextmanager
async def running(**device: Any) -> AsyncIterator[FakeContext]:
    async with serving(DevicesAdapter(DevicesAdapter.Config(device=device), make_context())) as context:
        yield context


def address(context: FakeContext, name: str, way: str = "tcp") -> tuple[str, int]:
    devices = cast(dict[str, dict[str, str]], context.stats.details["devices"])
    host, _, port = devices[name][way].rpartition(":")
    return host, int(port)


async def until(is_so: Callable[[], bool]) -> None:
    while not is_so():
        await asyncio.sleep(0.005)


class Datagrams(asyncio.DatagramProtocol):
    """A peer that keeps what it hears."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[bytes] = asyncio.Queue()

    def datagram_received(self, data: bytes, address: object) -> None:
        self.heard.put_nowait(data)


def a50(**keys: Any) -> WaterLinkedA50Table:
    return WaterLinkedA50Table(sensor="rov/dvl", **{"tcp_port": 0, **keys})


def test_peers_on_tcp_get_reports_and_each_its_own_answers():
    async def scene() -> None:
        async with running(dvl=a50()) as context:
            assert context.subscriptions == {"rov/dvl"}
            host, port = address(context, "dvl")
            one, to_one = await asyncio.open_connection(host, port)
            two, to_two = await asyncio.open_connection(host, port)
            to_one.write(GET)
            assert json.loads(await one.readline())["response_to"] == "get_config"
            to_two.write(GET)
            await two.readline()
            context.put([sample(DVL, LOCKED)])
            assert json.loads(await one.readline())["vx"] == json.loads(await two.readline())["vx"] == 0.5
            await until(lambda: context.stats.peers == 2)
            assert (context.stats.samples_sent, context.stats.commands) == (2, 2)
            to_one.close()
            to_two.close()
            await until(lambda: context.stats.peers == 0)

    run(scene)


def test_garbage_is_counted_by_cause_and_the_connection_stays():
    async def scene() -> None:
        async with running(dvl=a50()) as context:
            reader, writer = await asyncio.open_connection(*address(context, "dvl"))
            writer.write(b"\xff nonsense\n" + b"x" * 10000 + b"\n" + GET)
            assert json.loads(await reader.readline())["success"] is False
            assert json.loads(await reader.readline())["response_to"] == "get_config"
            assert context.stats.details["refused"] == {"garbage": 1, "unknown message": 1}
            writer.close()

    run(scene)


def test_one_peer_too_many_is_told():
    async def scene() -> None:
        async with running(dvl=a50(max_clients=1)) as context:
            _, first = await asyncio.open_connection(*address(context, "dvl"))
            first.write(GET)
            reader, writer = await asyncio.open_connection(*address(context, "dvl"))
            assert b"max_clients" in await reader.read()
            first.close()
            writer.close()

    run(scene)


def test_who_asks_too_often_waits():
    async def scene() -> None:
        async with running(dvl=a50()) as context:
            reader, writer = await asyncio.open_connection(*address(context, "dvl"))
            writer.write(GET * (REQUESTS_PER_S + 1))
            for _ in range(REQUESTS_PER_S):
                await reader.readline()
            assert context.stats.commands == REQUESTS_PER_S
            await reader.readline()  # in the next second
            writer.close()

    run(scene)


def test_a_web_page_cannot_command_a_device():
    async def scene() -> None:
        async with running(dvl=a50()) as context:
            reader, writer = await asyncio.open_connection(*address(context, "dvl"))
            writer.write(
                b'POST / HTTP/1.1\r\nHost: x\r\n\r\n{"command":"set_config","parameters":{"speed_of_sound":1400}}\n'
            )
            assert b"HTTP/1.1 4" in await reader.read()
            assert context.stats.commands == 0
            writer.close()

    run(scene)


def test_udp_peers_are_served_for_their_lease_and_targets_always():
    async def scene() -> None:
        loop = asyncio.get_running_loop()
        listening, target = await loop.create_datagram_endpoint(Datagrams, local_addr=("127.0.0.1", 0))
        to = f"127.0.0.1:{listening.get_extra_info('sockname')[1]}"
        sounder = Nmea0183Table(altimeter="rov/ping", sentences=("DBT",), udp_to=(to,))
        async with running(dvl=a50(tcp_port=None, udp_port=0, udp_lease_s=1.0), sounder=sounder) as context:
            sending, peer = await loop.create_datagram_endpoint(Datagrams, remote_addr=address(context, "dvl", "udp"))
            context.put([sample(ALTIMETER, (5.0, 1.0)), sample(DVL, LOCKED)])
            assert is_sentence((await target.heard.get()).strip())
            sending.sendto(GET)
            assert json.loads(await peer.heard.get())["response_to"] == "get_config"
            context.put([sample(DVL, LOCKED)])
            assert json.loads(await peer.heard.get())["type"] == "velocity"
            await asyncio.sleep(1.1)
            sent = context.stats.samples_sent
            context.put([sample(DVL, LOCKED)])
            assert context.stats.samples_sent == sent
            listening.close()
            sending.close()

    run(scene)


def test_udp_senders_are_few():
    async def scene() -> None:
        loop = asyncio.get_running_loop()
        async with running(dvl=a50(tcp_port=None, udp_port=0, max_clients=2)) as context:
            ends = [
                await loop.create_datagram_endpoint(Datagrams, remote_addr=address(context, "dvl", "udp"))
                for _ in range(3)
            ]
            for sending, _ in ends:
                sending.sendto(GET)
            await until(lambda: context.stats.errors == 1)
            for _, peer in ends[:2]:
                await peer.heard.get()
            assert ends[2][1].heard.empty()
            for sending, _ in ends:
                sending.close()

    run(scene)


def test_a_serial_line_says_the_same():
    async def scene() -> None:
        ours, theirs = pty.openpty()
        os.set_blocking(ours, False)
        try:
            async with running(dvl=a50(tcp_port=None, serial=os.ttyname(theirs))) as context:
                os.write(ours, b"\x00rubbish\n" + GET)
                heard = b""

                async def hear(lines: int) -> None:
                    nonlocal heard
                    while heard.count(b"\n") < lines:
                        await asyncio.sleep(0.01)
                        with contextlib.suppress(BlockingIOError):
                            heard += os.read(ours, 4096)

                await hear(2)
                assert json.loads(heard.splitlines()[1])["response_to"] == "get_config"
                assert context.stats.peers <= 1
                context.put([sample(DVL, LOCKED)])
                await hear(3)
                assert b'"type":"velocity"' in heard
        finally:
            os.close(ours)
            os.close(theirs)

    run(scene)


def test_a_reset_reaches_the_devices():
    async def scene() -> None:
        async with running(dvl=a50()) as context:
            reader, writer = await asyncio.open_connection(*address(context, "dvl"))
            writer.write(GET)
            await reader.readline()
            context.put([sample(DVL, LOCKED, 10.0)])
            context.say(Event("reset", 0, 0, "reset"))
            context.put([sample(DVL, LOCKED, 0.5)])
            assert [json.loads(await reader.readline())["time"] for _ in range(2)] == [0.0, 0.0]
            context.put([sample(DVL, LOCKED, 0.6)])
            assert json.loads(await reader.readline())["time"] == pytest.approx(100.0)
            writer.close()

    run(scene)


def test_what_cannot_be_served_is_told_with_its_key():
    async def wrong_sensor() -> None:
        adapter = DevicesAdapter(
            DevicesAdapter.Config(device={"log": WaterLinkedA50Table(sensor="rov/dvll")}), make_context()
        )
        with pytest.raises(CannotServe, match=r'device\.log\.sensor: no sensor "rov/dvll"'):
            await adapter.run(asyncio.Event())

    async def taken_port() -> None:
        async with running(dvl=a50()) as context:
            port = address(context, "dvl")[1]
            for ways, word in (({"tcp_port": port}, r"device\.two\.tcp_port"),):
                adapter = DevicesAdapter(DevicesAdapter.Config(device={"two": a50(**ways)}), make_context())
                with pytest.raises(CannotListen, match=word):
                    await adapter.run(asyncio.Event())

    run(wrong_sensor)
    run(taken_port)


def test_a_check_tells_the_same_for_each_device():
    devices = {
        "log": a50(),
        "far": WaterLinkedA50Table(sensor="rov/dvll"),
        "ping": Ping360Table(sensor="rov/dvl", udp_port=0),
        "gps": Nmea0183Table(gps="rov/dvl", tcp_port=0),
    }
    context = make_context()
    found = dict(DevicesAdapter.Config(device=devices).faults(context.ports, context.services))
    assert list(found) == [("device", "far", "sensor"), ("device", "ping", "sensor"), ("device", "gps", "gps")]
    assert found["device", "far", "sensor"].startswith('no sensor "rov/dvll"; there are: ')
    assert '"rov/dvl" has no field "head_angle"' in found["device", "ping", "sensor"]


def test_the_addresses_of_all_devices_are_told():
    async def scene() -> None:
        async with running(dvl=a50(), other=a50(udp_port=0)) as context:
            said = context.stats.address.split(", ")
            ways = [("dvl", "tcp"), ("other", "tcp"), ("other", "udp")]
            assert said == ["{} {} {}:{}".format(*way, *address(context, *way)) for way in ways]
        async with running(dvl=a50()) as context:
            assert context.stats.address == "{}:{}".format(*address(context, "dvl"))

    run(scene)


def test_tables_are_read_by_kind():
    text = {
        "device": {
            "dvl": {"kind": "water_linked_a50", "sensor": "rov/dvl"},
            "gps": {"kind": "nmea0183", "gps": "a", "tcp_port": 10110},
        }
    }
    config = msgspec.convert({"kind": "devices", **text}, DevicesAdapter.Config)
    assert config.device["dvl"].tcp_port == 16171
    for wrong, word in (
        ({"kind": "nmea0183", "gps": "rov/gps"}, "no address"),
        ({"kind": "nmea0183", "gps": "rov/gps", "udp_to": ["here"]}, '"here" is no address'),
        ({"kind": "sextant"}, "sextant"),
    ):
        with pytest.raises(msgspec.ValidationError, match=word):
            msgspec.convert({"kind": "devices", "device": {"x": wrong}}, DevicesAdapter.Config)


def test_a_table_tells_its_parts():
    devices = {
        "bridge": Nmea0183Table(gps="a/gps", heading="a/ahrs", tcp_port=0, udp_to=("127.0.0.1:10110",)),
        "dvl": WaterLinkedA50Table(sensor="a/dvl", bind="::1"),
    }
    assert DevicesAdapter.Config(device=devices).parts() == {
        "device.bridge": "nmea0183 of a/gps (gps), a/ahrs (heading) at tcp 127.0.0.1, a free port, udp to 127.0.0.1:10110",
        "device.dvl": "water_linked_a50 of a/dvl (sensor) at tcp [::1]:16171",
    }
