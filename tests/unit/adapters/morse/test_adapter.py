"""The adapter on real sockets, over a fake server: streams that tell and are told, and ArduPilot's two ports."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from uwserver_adapters.morse.adapter import MorseAdapter
from uwserver_adapters.morse.config import AutopilotTable, MorseConfig

from uwserver.adapter import CannotListen, CannotServe
from uwserver.ports import Field, Port
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import DEPTH, PORTS

POSE = Port(
    "rov/truth/pose", "sensor", "truth_pose",
    (Field("p_NB", "m", "x", "N", (3,)), Field("q_NB", "1", "x", "NB", (4,))), "x", rate_hz=250.0, message="TruePose",
)  # fmt: skip
VELOCITY = Port(
    "rov/truth/velocity", "sensor", "truth_velocity",
    (Field("v_NB_B", "m/s", "x", "B", (3,)), Field("w_NB_B", "rad/s", "x", "B", (3,))), "x", rate_hz=250.0, message="TrueVelocity",
)  # fmt: skip


@asynccontextmanager
async def serving(config: MorseConfig, context: FakeContext) -> AsyncIterator[dict[str, Any]]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(MorseAdapter(config, context).run(ready))
    waiting = asyncio.ensure_future(ready.wait())
    try:
        await asyncio.wait([task, waiting], timeout=60, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if task.done():
            task.result()
        yield context.stats.details
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def connect(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    await turns()
    return reader, writer


async def turns() -> None:
    """The loop takes up what has come."""
    for _ in range(50):
        await asyncio.sleep(0)


def run(story: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(story(), 120)

    asyncio.run(bounded())


def test_a_stream_tells_the_samples_of_its_component_alone() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(MorseConfig(port=0, stream_port=0), context) as details:
            assert context.subscriptions == frozenset()
            reader, writer = await connect(details["streams"]["rov.depth"])
            assert context.subscriptions == {DEPTH.path}
            context.emit()
            said = json.loads(await reader.readline())
            assert set(said) == {"timestamp", "valid", "depth"}
            writer.close()
            await writer.wait_closed()
            await turns()
            assert context.subscriptions == frozenset()

    run(story)


def test_velocity_in_the_world_takes_the_attitude() -> None:
    async def story() -> None:
        context = FakeContext(ports={port.path: port for port in (POSE, VELOCITY)})
        async with serving(MorseConfig(port=0, stream_port=0, truth=True), context) as details:
            reader, writer = await connect(details["streams"]["rov.velocity"])
            assert context.subscriptions == {POSE.path, VELOCITY.path}
            context.emit()
            assert "world_linear_velocity" in json.loads(await reader.readline())
            writer.close()

    run(story)


def test_a_stream_takes_commands_and_tells_what_it_refuses() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(MorseConfig(port=0, stream_port=0), context) as details:
            reader, writer = await connect(details["streams"]["rov.thrusters"])
            line = json.dumps({"u": [0.5] * 8}).encode() + b"\n"
            for at in range(len(line)):
                writer.write(line[at : at + 1])
                await writer.drain()
            writer.write(b'{"v": 1}\n')
            said = json.loads(await reader.readline())
            assert said["code"] == "bad_argument"
            assert "it has: u" in said["error"]
            assert [command.value for command in context.commands] == [((0.5,) * 8,)]
            assert "rov.thrusters" in context.stats.last_error
            writer.close()

    run(story)


def test_a_sensor_takes_nothing() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(MorseConfig(port=0, stream_port=0), context) as details:
            reader, writer = await connect(details["streams"]["rov.depth"])
            writer.write(b"{}\n")
            assert json.loads(await reader.readline())["code"] == "denied"
            writer.close()

    run(story)


def test_a_vehicle_that_comes_has_streams_and_one_that_goes_keeps_its_numbers() -> None:
    async def story() -> None:
        context = FakeContext()
        async with serving(MorseConfig(port=0, stream_port=0), context) as details:
            before = dict(details["streams"])
            other = Port("auv/depth", "sensor", "pressure", DEPTH.fields, "x", rate_hz=25.0, message="FluidPressure")
            context.set_ports((*PORTS, other))
            while "auv.depth" not in details["streams"]:
                await asyncio.sleep(0.02)
            reader, writer = await connect(details["streams"]["auv.depth"])
            context.emit()
            assert "depth" in json.loads(await reader.readline())
            writer.close()
            context.set_ports((other,))
            await asyncio.sleep(0.3)
            assert before.items() <= details["streams"].items()
            gone, hand = await connect(details["streams"]["rov.thrusters"])
            hand.write(b'{"u": [0,0,0,0,0,0,0,0]}\n')
            assert json.loads(await gone.readline())["code"] == "unknown_port"
            hand.close()

    run(story)


def test_a_port_in_use_is_passed_over() -> None:
    async def story() -> None:
        async with serving(MorseConfig(port=0, stream_port=0), FakeContext()) as first:
            taken = first["streams"]["rov.depth"]
            async with serving(MorseConfig(port=0, stream_port=taken), FakeContext()) as second:
                assert min(second["streams"].values()) > taken

    run(story)


@pytest.mark.parametrize(
    ("table", "error", "text"),
    [
        ({"bind": "0.0.0.0"}, CannotListen, "allow_network"),
        ({"names": {"rov": {"x": "imy"}}}, CannotServe, "did you mean"),
        ({"ardupilot": AutopilotTable()}, CannotServe, "truth = true"),
    ],
)
def test_what_cannot_be_served(table: dict[str, Any], error: type[Exception], text: str) -> None:
    async def story() -> None:
        with pytest.raises(error, match=text):
            async with serving(MorseConfig(port=0, stream_port=0, **table), FakeContext()):
                pass

    run(story)


def test_an_autopilot_hears_sensors_and_moves_thrusters() -> None:
    async def story() -> None:
        context = FakeContext(ports={port.path: port for port in (*PORTS, POSE, VELOCITY)})
        table = AutopilotTable(sensors_port=0, control_port=0)
        async with serving(MorseConfig(port=0, stream_port=0, truth=True, ardupilot=table), context) as details:
            sensors_port, control_port = map(int, details["ardupilot"].split(":")[-2:])
            reader, writer = await connect(sensors_port)
            _, hand = await connect(control_port)
            context.emit()
            context.emit()
            assert (await reader.readline()).startswith(b'{"timestamp": ')
            hand.write(b'{"pwm": [1900, 1100f, 1500, 1500, 1500, 1500f, 1500, 1700, 0, 0f]}\n{"steer": 1}\n')
            while not context.stats.errors:
                await asyncio.sleep(0.01)
            assert [command.value for command in context.commands] == [((1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5),)]
            assert "morse-pwm" in context.stats.last_error
            writer.close()
            hand.close()

    run(story)
