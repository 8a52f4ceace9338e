"""The Ping1D against the maker's own library, over UDP and a pseudo-terminal; settings reach the sensor; refusals change nothing."""

from __future__ import annotations

import asyncio
import os
import pty
import struct
from collections.abc import Callable
from typing import Any, cast

import pytest
from adapter_rig import serving
from devices_rig import ALTIMETER, ask, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.ping1d import Ping1D, Ping1DTable
from uwserver_adapters.devices.ping_protocol import Frame, encode

from uwserver.ports import Fault
from uwserver.ports import Reply as Answer
from uwserver.testing import FakeContext

brping = pytest.importorskip("brping", reason="bluerobotics-ping is not installed")


def session(
    device: Ping1DTable, connect: Callable[[Any, FakeContext], None], talk: Callable[[Any], Any]
) -> tuple[Any, FakeContext]:
    """What the library's client says in a thread, while the sensor pings ten times a second."""

    async def scene() -> tuple[Any, FakeContext]:
        async with serving(DevicesAdapter(DevicesAdapter.Config(device={"ping": device}), make_context())) as context:

            def client() -> Any:
                # Without its own messages the library takes those of all devices, where another's has the number of Ping1D's range.
                ping = brping.Ping1D(brping.definitions.payload_dict_ping1d)
                connect(ping, context)
                try:
                    return talk(ping)
                finally:
                    ping.iodev.close()

            done = asyncio.get_running_loop().run_in_executor(None, client)
            for i in range(1000):
                context.put([sample(ALTIMETER, (7.25 + i * 1e-3, 0.8), i / 10)])
                await asyncio.wait([done], timeout=0.005)
                if done.done():
                    break
            return done.result(), context

    return asyncio.run(asyncio.wait_for(scene(), 120))


def by_udp(ping: Any, context: FakeContext) -> None:
    devices = cast(dict[str, dict[str, str]], context.stats.details["devices"])
    host, _, port = devices["ping"]["udp"].rpartition(":")
    ping.connect_udp(host, int(port))


UDP = Ping1DTable(sensor="rov/ping", udp_port=0)


def test_the_makers_library_initialises_and_measures():
    def talk(ping: Any) -> Any:
        assert ping.initialize()
        return ping.get_distance(), ping.get_profile(), ping.get_device_information(), ping.get_general_info()

    (distance, profile, information, info), _ = session(UDP, by_udp, talk)
    assert 7250 <= distance["distance"] < 8250
    assert distance["confidence"] == 80
    assert (information["device_type"], info["ping_interval"]) == (1, 100)
    points = list(profile["profile_data"])
    assert len(points) == 200
    assert points.index(max(points)) == profile["distance"] * 200 // 30000


def test_the_makers_library_sets_range_and_interval():
    def talk(ping: Any) -> Any:
        assert ping.initialize()
        return ping.set_range(0, 20000), ping.set_ping_interval(200), ping.set_gain_setting(2), ping.get_range()

    said, context = session(UDP, by_udp, talk)
    assert said == (True, True, True, {"scan_start": 0, "scan_length": 20000})
    assert [dict(call.args) for call in context.calls] == [{"range": 20.0, "sound_speed": None}]


def test_profiles_come_by_themselves_once_asked_for():
    def talk(ping: Any) -> Any:
        ping.control_continuous_start(brping.definitions.PING1D_PROFILE)
        numbers = [ping.wait_message([brping.definitions.PING1D_PROFILE], 2.0).ping_number for _ in range(3)]
        ping.control_continuous_stop(brping.definitions.PING1D_PROFILE)
        return numbers

    numbers, _ = session(UDP, by_udp, talk)
    assert [number - numbers[0] for number in numbers] == [0, 1, 2]


def test_the_makers_library_speaks_over_a_serial_line():
    ours, theirs = pty.openpty()
    # The client's end of one pair is joined to ours by the name of the other side: the adapter opens `theirs`, the client speaks at `ours`.
    os.set_blocking(ours, False)

    class Line:
        """What the library needs of a serial port."""

        def recv(self, size: int) -> bytes:
            return os.read(ours, size)

        def send(self, data: bytes) -> int:
            return os.write(ours, data)

        def close(self) -> None:
            """The test closes both ends."""

    def connect(ping: Any, _: FakeContext) -> None:
        ping.iodev = Line()

    try:
        table = Ping1DTable(sensor="rov/ping", serial=os.ttyname(theirs))
        said, _ = session(table, connect, lambda ping: (ping.initialize(), ping.get_distance()))
        assert said[0]
        assert said[1]["confidence"] == 80
    finally:
        os.close(ours)
        os.close(theirs)


def make() -> tuple[Ping1D, FakeContext]:
    context = make_context()
    return Ping1DTable(sensor="rov/ping", udp_port=0).build(context), context


@pytest.mark.parametrize(
    ("message", "payload"),
    [(1005, b"\x07"), (1000, b"\x00"), (1001, b"\x00" * 7), (1400, b"\x01\x00"), (6, b"\x99\x99"), (1100, b""), (40000, b"x"),
     (1002, b"\x00" * 4), (1001, b"\xff" * 8)],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_and_changes_nothing(message: int, payload: bytes):
    device, context = make()
    before = str(device.settings)
    replies, _ = ask(device, encode(Frame(message, payload)))
    assert len(replies) == 1
    assert replies[0][4:6] == b"\x02\x00"
    assert str(device.settings) == before
    assert context.calls == []


def test_the_speed_of_sound_reaches_the_sensor_and_is_told_at_once_until_it_refuses():
    async def scene() -> None:
        device, context = make()
        context.held.add("rov/ping/set")
        replies, _ = ask(device, encode(Frame(1002, (1_480_000).to_bytes(4, "little"))) + encode(Frame(1203)))
        assert [dict(call.args) for call in context.calls] == [{"range": None, "sound_speed": 1480.0}]
        assert replies == [encode(Frame(1203, (1_480_000).to_bytes(4, "little"), 1))]
        context.calls[0].finish(Answer(0, 0, fault=Fault("internal", "no")))
        assert replies[1][4:6] == b"\x02\x00"
        assert device.settings.speed_of_sound == 1_500_000

    asyncio.run(scene())


def test_a_scan_that_begins_farther_off_is_listened_to_until_its_end():
    async def scene() -> None:
        device, context = make()
        scan = struct.pack("<II", 2_000, 5_000)
        replies, _ = ask(device, encode(Frame(1001, scan)) + encode(Frame(1204)))
        assert [dict(call.args) for call in context.calls] == [{"range": 7.0, "sound_speed": None}]
        assert encode(Frame(1204, scan, 1)) in replies

    asyncio.run(scene())


def test_what_is_meant_for_another_device_is_not_answered():
    device, _ = make()
    assert ask(device, encode(Frame(1212, b"", 0, 9))) == ([], [])


def test_without_an_echo_the_confidence_is_zero():
    device, _ = make()
    device.see(sample(ALTIMETER, (7.0, 0.9), 0.0))
    device.see(sample(ALTIMETER, (None, None), 0.5, valid=False))
    (reply,), _ = ask(device, encode(Frame(1211)))
    assert reply[8:13] == (7000).to_bytes(4, "little") + b"\x00"


def test_a_device_that_is_switched_off_does_not_ping():
    device, _ = make()
    ask(device, encode(Frame(1006, b"\x00")) + encode(Frame(1400, b"\xbc\x04")))
    assert device.see(sample(ALTIMETER, (7.0, 0.9), 0.0)) == []
    ask(device, encode(Frame(1006, b"\x01")))
    assert len(device.see(sample(ALTIMETER, (7.0, 0.9), 1.0))) == 1
