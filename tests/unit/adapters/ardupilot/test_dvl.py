"""The DVL as messages: what pymavlink reads of them, and a connection that comes and goes."""

from __future__ import annotations

import asyncio
import math
import socket
from typing import Any

import pytest
from uwserver_adapters.ardupilot import dvl
from uwserver_adapters.ardupilot.dvl import DvlTable, MavlinkOut, Movement

from uwserver.adapter import Readings
from uwserver.ports import Field, Port, Sample

mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="pymavlink is not installed")

TICK_NS = 2_500_000
PORTS = {
    "rov/imu": Port(
        "rov/imu",
        "sensor",
        "imu",
        (Field("f_S", "m/s^2", "f", "S", (3,)), Field("w_S", "rad/s", "w", "S", (3,))),
        "IMU.",
        400.0,
    ),
    "rov/dvl": Port(
        "rov/dvl",
        "sensor",
        "dvl",
        (Field("v_S", "m/s", "v", "S", (3,)), Field("figure_of_merit", "m/s", "f")),
        "DVL.",
        8.0,
    ),
}


class Rig:
    def __init__(self) -> None:
        self.readings = Readings(PORTS, "rov")
        dvl = self.readings.subscribe("dvl", "dvl", [("v_S", "figure_of_merit")], keeps=False)
        imu = self.readings.subscribe("imu", "imu", [("w_S", "f_S")])
        self.reader = mavlink.MAVLink(None)
        self.messages: list[Any] = []
        self.movement = Movement(
            DvlTable(), dvl, imu, lambda data: self.messages.extend(self.reader.parse_buffer(data))
        )
        self.t_ns = 0

    def tick(
        self, w: tuple[float, ...] = (0.0, 0.0, 0.0), v: tuple[Any, ...] | None = None, merit: float | None = 0.0
    ) -> None:
        self.t_ns += TICK_NS
        samples = [Sample("rov/imu", 0, self.t_ns, self.t_ns, True, ((0.0, 0.0, -9.8), w))]
        if v is not None:
            samples.append(Sample("rov/dvl", 0, self.t_ns, self.t_ns, merit is not None, (v, merit)))
        self.readings.see(samples)
        self.movement.see(self.t_ns)


def test_turn_and_shift_from_one_measurement_to_the_next() -> None:
    rig = Rig()
    rig.tick(v=(1.0, 0.0, 0.5))
    assert not rig.messages, "there is nothing before it"
    for n in range(1, 51):
        rig.tick((0.1, -0.2, 0.4), v=(2.0, -1.0, 0.5) if n == 50 else None, merit=0.1)
    (message,) = rig.messages
    assert message.get_type() == "VISION_POSITION_DELTA"
    assert message.time_usec == 127_500
    assert message.time_delta_usec == 125_000
    assert message.angle_delta == pytest.approx([0.0125, -0.025, 0.05])
    assert message.position_delta == pytest.approx([1.5 * 0.125, -0.5 * 0.125, 0.5 * 0.125])
    assert message.confidence == pytest.approx(75.0)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 197)


def test_a_lost_bottom_leaves_a_gap_that_is_bridged_only_when_short() -> None:
    rig = Rig()
    rig.tick(v=(1.0, 0.0, 0.0))
    rig.tick(v=(None,) * 3, merit=None)
    rig.tick(v=(math.nan,) * 3)
    assert not rig.messages
    for _ in range(100):
        rig.tick((0.0, 0.0, 0.1))
    rig.tick(v=(1.0, 0.0, 0.0))
    assert len(rig.messages) == 1
    assert rig.messages[0].time_delta_usec == 103 * 2500
    for _ in range(500):
        rig.tick()
    rig.tick(v=(1.0, 0.0, 0.0))
    assert len(rig.messages) == 1, "more than a second"
    for _ in range(50):
        rig.tick((0.0, 0.0, 0.1))
    rig.tick(v=(1.0, 0.0, 0.0))
    assert rig.messages[1].angle_delta == pytest.approx([0.0, 0.0, 50 * 0.0025 * 0.1], abs=1e-7), (
        "turns before the gap are forgotten"
    )


def test_confidence() -> None:
    rig = Rig()
    for merit, confidence in ((0.0, 100.0), (0.2, 50.0), (0.4, 0.0), (3.0, 0.0)):
        rig.tick(v=(0.0,) * 3)
        rig.tick(v=(0.0,) * 3, merit=merit)
        assert rig.messages[-1].confidence == pytest.approx(confidence)


def test_a_reset_world_begins_anew() -> None:
    rig = Rig()
    for _ in range(10):
        rig.tick(v=(1.0, 0.0, 0.0))
    sent = len(rig.messages)
    rig.t_ns = 0
    rig.tick(v=(1.0, 0.0, 0.0))
    assert len(rig.messages) == sent
    rig.tick(v=(1.0, 0.0, 0.0))
    assert len(rig.messages) == sent + 1


def test_the_connection_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dvl, "RETRY_S", 0.05)

    async def check() -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        link = MavlinkOut(f"tcp:127.0.0.1:{port}")
        link.send(b"nobody")
        assert link.dropped == 1
        running = asyncio.ensure_future(link.run())
        for _ in range(2):
            come: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
            server = await asyncio.start_server(lambda r, w, come=come: come.put_nowait((r, w)), "127.0.0.1", port)
            reader, writer = await come.get()
            dropped = link.dropped
            link.send(b"hello")
            while link.dropped > dropped:  # the peer knew of the connection first
                await asyncio.sleep(0.01)
                dropped = link.dropped
                link.send(b"hello")
            assert await reader.readexactly(5) == b"hello"
            writer.transport.abort()
            server.close()
            await server.wait_closed()
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(asyncio.wait_for(check(), 120))


def test_datagrams() -> None:
    async def check() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.bind(("127.0.0.1", 0))
            listener.setblocking(False)
            link = MavlinkOut(f"udp:127.0.0.1:{listener.getsockname()[1]}")
            running = asyncio.ensure_future(link.run())
            said = asyncio.ensure_future(asyncio.get_running_loop().sock_recv(listener, 100))
            while not said.done():
                link.send(b"one")  # nobody is there to send it before the socket is
                await asyncio.sleep(0.01)
            assert said.result() == b"one"
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    asyncio.run(asyncio.wait_for(check(), 120))
