"""The Ping360 against the maker's own library over UDP, with a sonar that obeys its service; refusals change nothing."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import pytest
from adapter_rig import serving
from devices_rig import SONAR, ask, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.ping360 import Ping360, Ping360Table, resample
from uwserver_adapters.devices.ping_protocol import Frame, encode

from uwserver.adapter import CannotServe
from uwserver.ports import Fault, Field, Port, Sample
from uwserver.ports import Reply as Answer
from uwserver.testing import FakeContext

brping = pytest.importorskip("brping", reason="bluerobotics-ping is not installed")

TABLE = Ping360Table(sensor="rov/sonar", udp_port=0)
ROW = (10, 20, 30, 40, 50, 60, 70, 80)


class Head:
    """What the simulated sonar does with its settings: `sector_center` and on, step by step, round and round or to and fro."""

    def __init__(self) -> None:
        self.steps = 0

    def ping(self, set_to: Mapping[str, Any], t_s: float) -> Sample:
        width, step = set_to["sector_width"], set_to["step"]
        whole = width > 2 * math.pi - 1e-9
        count = max(1, round(width / step) + (0 if whole else 1))
        first = set_to["sector_center"] - (0.0 if whole else 0.5 * (count - 1) * step)
        angle = math.remainder(first + (self.steps % count) * step, 2 * math.pi)
        self.steps += 1
        return sample(SONAR, (angle, set_to["range"], set_to["gain"], ROW), t_s)


def session(talk: Callable[[Any], Any]) -> tuple[Any, FakeContext]:
    """What the library's client says in a thread, while the sonar pings."""

    async def scene() -> tuple[Any, FakeContext]:
        async with serving(DevicesAdapter(DevicesAdapter.Config(device={"ping": TABLE}), make_context())) as context:

            def client() -> Any:
                ping = brping.Ping360()
                host, _, port = cast(Any, context.stats.details["devices"])["ping"]["udp"].rpartition(":")
                ping.connect_udp(host, int(port))
                try:
                    return talk(ping)
                finally:
                    ping.iodev.close()

            done, head = asyncio.get_running_loop().run_in_executor(None, client), Head()
            start = {"sector_center": 0.0, "sector_width": 2 * math.pi, "step": 0.1, "range": 30.0, "gain": 0.0}
            for i in range(2000):
                set_to = context.calls[-1].args if context.calls else start
                context.put([head.ping(set_to, i / 10)])
                await asyncio.wait([done], timeout=0.005)
                if done.done():
                    break
            return done.result(), context

    return asyncio.run(asyncio.wait_for(scene(), 120))


def test_the_makers_library_turns_the_head_and_gets_the_ping_of_that_angle():
    def talk(ping: Any) -> Any:
        assert ping.initialize()
        ping.set_gain_setting(2)
        ping.set_sample_period(444)
        ping.set_number_of_samples(800)
        rows = []
        for angle in (0, 100, 399):
            ping.transmitAngle(angle)
            rows.append((ping._angle, len(ping._data), bytes(ping._data)))
        return rows, ping.get_device_information()

    (rows, information), context = session(talk)
    assert [row[:2] for row in rows] == [(0, 800), (100, 800), (399, 800)]
    # 800 samples of 11.1 us at 1500 m/s are 6.66 m; the eight bins of the sensor reach as far.
    assert rows[0][2] == b"".join(bytes([level]) * 100 for level in ROW)
    assert information["device_type"] == 2
    asked = [dict(call.args) for call in context.calls]
    assert [math.degrees(cast(float, a["sector_center"])) for a in asked] == pytest.approx([0.0, 90.0, -0.9])
    assert {round(cast(float, a["range"]), 6) for a in asked} == {6.66}
    assert {a["gain"] for a in asked} == {12.0}


def test_the_makers_library_lets_it_scan_a_sector_by_itself():
    def talk(ping: Any) -> Any:
        assert ping.initialize()
        ping.control_auto_transmit(1, 0, 32, 444, 740, 800, 350, 50, 10, 0)
        angles = []
        while len(angles) < 11:
            message = ping.wait_message([brping.definitions.PING360_AUTO_DEVICE_DATA], 2.0)
            angles.append(message.angle)
        ping.control_motor_off()
        return angles, message.start_angle, message.stop_angle, len(message.data)

    (angles, start, stop, length), context = session(talk)
    assert (start, stop, length) == (350, 50, 800)
    assert set(angles) == {(350 + 10 * k) % 400 for k in range(11)}
    (call,) = context.calls
    assert math.degrees(cast(float, call.args["sector_width"])) == pytest.approx(90.0)


def make() -> tuple[Ping360, FakeContext]:
    context = make_context()
    return TABLE.build(context), context


def transducer(
    gain: int = 0,
    angle: int = 0,
    duration: int = 32,
    period: int = 444,
    frequency: int = 740,
    samples: int = 800,
    transmit: int = 1,
) -> bytes:
    fields = (1, gain), (angle, duration, period, frequency, samples), (transmit, 0)
    return encode(
        Frame(2601, bytes(fields[0]) + b"".join(n.to_bytes(2, "little") for n in fields[1]) + bytes(fields[2]))
    )


@pytest.mark.parametrize(
    "data",
    [transducer(gain=3), transducer(angle=400), transducer(duration=0), transducer(period=79), transducer(frequency=499),
     transducer(samples=1201), encode(Frame(2601, b"\x00" * 13)), encode(Frame(2602, bytes(16))), encode(Frame(2600, b"\x01\x00")),
     encode(Frame(2000, b"\x00\x00")), encode(Frame(6, b"\x99\x99")), encode(Frame(40000, b"x"))],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_and_changes_nothing(data: bytes):
    device, context = make()
    before = device.settings
    replies, bad = ask(device, data)
    assert [reply[4:6] for reply in replies] == [b"\x02\x00"]
    assert len(bad) == 1
    assert device.settings == before
    assert context.calls == []


def test_the_ping_under_way_with_other_settings_is_not_the_one_that_was_asked_for():
    async def scene() -> None:
        device, _ = make()
        replies, _ = ask(device, transducer(angle=100))
        assert replies == []
        device.see(sample(SONAR, (0.0, 6.66, -12.0, ROW)))  # another angle
        device.see(sample(SONAR, (math.pi / 2, 30.0, -12.0, ROW)))  # another range
        assert replies == []
        device.see(sample(SONAR, (math.pi / 2, 6.66, -12.0, ROW)))
        assert [reply[4:6] for reply in replies] == [(2300).to_bytes(2, "little")]

    asyncio.run(scene())


def test_out_of_the_water_the_row_is_empty():
    async def scene() -> None:
        device, _ = make()
        replies, _ = ask(device, transducer(angle=100))
        device.see(sample(SONAR, (math.pi / 2, 6.66, -12.0, (None,) * 8), valid=False))
        assert replies[0].endswith(bytes(800) + replies[0][-2:])

    asyncio.run(scene())


def test_the_range_goes_as_far_as_the_sensor_and_no_farther():
    async def scene() -> None:
        device, context = make()
        replies, _ = ask(device, transducer(period=8000, samples=1200))  # 180 m
        assert context.calls[0].args["range"] == 50.0
        device.see(sample(SONAR, (0.0, 50.0, -12.0, ROW)))
        row = replies[0][-2 - 1200 : -2]
        assert row[333] == 80
        assert not any(row[334:])

    asyncio.run(scene())


def test_what_the_sensor_refuses_is_told_to_who_asked():
    async def scene() -> None:
        device, context = make()
        context.held.add("rov/sonar/set")
        replies, _ = ask(device, transducer())
        context.calls[0].finish(Answer(0, 0, fault=Fault("internal", "the sonar is broken")))
        assert [reply[4:6] for reply in replies] == [b"\x02\x00"]
        assert b"broken" in replies[0]

    asyncio.run(scene())


def test_a_newer_command_and_a_reset_tell_who_waits():
    async def scene() -> None:
        device, _ = make()
        first, _ = ask(device, transducer())
        ask(device, transducer(angle=7))
        assert [reply[4:6] for reply in first] == [b"\x02\x00"]
        second, _ = ask(device, transducer(angle=8))
        device.reset()
        assert [reply[4:6] for reply in second] == [b"\x02\x00"]

    asyncio.run(scene())


def test_a_full_turn_steps_round_and_round():
    async def scene() -> None:
        device, context = make()
        numbers = (32, 444, 740, 800, 0, 399)
        ask(device, encode(Frame(2602, b"\x01\x00" + b"".join(n.to_bytes(2, "little") for n in numbers) + b"\x01\x00")))
        assert context.calls[0].args["sector_width"] == pytest.approx(2 * math.pi)
        assert context.calls[0].args["sector_center"] == 0.0

    asyncio.run(scene())


def test_levels_are_peaks_of_what_a_sample_covers():
    assert resample((1, 9, 2, 3), 2.0, 2) == b"\x09\x03"
    assert resample((1, 9), 0.5, 5) == b"\x01\x01\x09\x09\x00"


def test_a_sensor_that_is_no_sonar_with_counts_is_refused():
    context = make_context()
    bins = Field("bins", "Pa", "x", shape=(8,))
    pressures = Port(SONAR.path, "sensor", "scanning_sonar", (*SONAR.fields[:3], bins), "Sonar.", 20.0)
    context.ports = {**context.ports, SONAR.path: pressures}
    with pytest.raises(CannotServe, match="counts"):
        TABLE.build(context)
    context.ports, context.services = {SONAR.path: SONAR}, {}
    with pytest.raises(CannotServe, match="scanning_sonar"):
        TABLE.build(context)
