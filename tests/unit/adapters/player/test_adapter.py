"""The adapter on real sockets, over a fake server, with a client that knows Player by its bytes alone."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest
from uwserver_adapters.player.adapter import PlayerAdapter, PlayerConfig

from uwserver.adapter import CannotListen, CannotServe
from uwserver.ports import Field, Port
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import DEPTH, IMU, PORTS, THRUSTERS

VELOCITY = Port(
    "rov/autopilot/velocity",
    "actuator",
    "autopilot",
    (Field("v_B", "m/s", "x", shape=(3,)), Field("yaw_rate", "rad/s", "x")),
    "x",
)
STATE = Port(
    "rov/autopilot/state", "sensor", "autopilot",
    (Field("p_N", "m", "x", "N", (3,)), Field("v_N", "m/s", "x", "N", (3,)), Field("q_NB", "1", "x", "NB", (4,)), Field("w_B", "1", "x", "B", (3,))),
    "x", rate_hz=10.0, message="Estimate",
)  # fmt: skip


class Client:
    """A client of Player."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def connect(cls, port: int) -> Client:
        client = cls(*await asyncio.open_connection("127.0.0.1", port))
        assert (await client.reader.readexactly(32)).startswith(b"Player v.3")
        return client

    def send(self, interface: int, number: int, kind: int, subtype: int, body: bytes = b"") -> None:
        self.writer.write(struct.pack(">6IdII", 0, 0, interface, number, kind, subtype, 0.0, 5, len(body)) + body)

    async def hear(self) -> tuple[tuple[int, ...], float, bytes]:
        """Interface, number, type and subtype; time; body."""
        *head, time, _, size = struct.unpack(">6IdII", await self.reader.readexactly(40))
        return tuple(head[2:]), time, await self.reader.readexactly(size)

    async def ask(self, interface: int, number: int, subtype: int, body: bytes = b"") -> tuple[int, bytes]:
        self.send(interface, number, 3, subtype, body)
        head, _, said = await self.hear()
        assert (*head[:2], head[3]) == (interface, number, subtype)
        return head[2], said

    async def open(self, interface: int, number: int, access: int = 1) -> int:
        """Gives the access that was granted."""
        kind, said = await self.ask(1, 0, 3, struct.pack(">7I", 0, 0, interface, number, access, 0, 0))
        granted = struct.unpack_from(">I", said, 16)[0]
        assert (kind == 4) == (granted == access)
        return int(granted)

    def close(self) -> None:
        self.writer.transport.abort()


def octets(data: bytes) -> bytes:
    return struct.pack(">II", len(data), len(data)) + data + b"\0" * (-len(data) % 4)


def data_of(body: bytes) -> object:
    return json.loads(body[8 : 8 + struct.unpack(">I", body[:4])[0]])


@asynccontextmanager
async def serving(config: PlayerConfig, context: FakeContext) -> AsyncIterator[int]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(PlayerAdapter(config, context).run(ready))
    waiting = asyncio.ensure_future(ready.wait())
    try:
        await asyncio.wait([task, waiting], timeout=60, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if task.done():
            task.result()
        yield int(context.stats.address.rpartition(":")[2])
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def run(story: Callable[[FakeContext], Awaitable[None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(story(FakeContext(ports={port.path: port for port in (*PORTS, VELOCITY, STATE)})), 120)

    asyncio.run(bounded())


async def until(true: Callable[[], object]) -> None:
    while not true():
        await asyncio.sleep(0.01)


FREE = PlayerConfig(port=0)


def test_the_list_of_devices_and_their_drivers() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            kind, said = await client.ask(1, 0, 1)
            count, again, *rest = struct.unpack(f">{len(said) // 4}I", said)
            assert kind == 4
            assert count == again == len(rest) // 4 == context.stats.details["devices"]
            assert rest[2:4] == [30, 0]
            assert rest[1] == port
            kind, said = await client.ask(1, 0, 2, struct.pack(">5I", 0, 0, 60, 0, 0))
            assert said[16:] == octets(b"rov/imu\0")
            assert await client.ask(1, 0, 2, struct.pack(">5I", 0, 0, 60, 9, 0)) == (6, b"")
            client.close()

    run(story)


def test_data_are_told_to_who_has_opened_the_device() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            assert context.subscriptions == frozenset()
            assert await client.open(60, 0) == 1
            assert context.subscriptions == {IMU.path}
            context.emit()
            head, time, body = await client.hear()
            assert head == (60, 0, 1, 2)
            assert time == pytest.approx(1_704_067_200.004)
            assert struct.unpack(">9f", body)[:6] == (0.0, -1.0, -2.0, 100.0, -101.0, -102.0)
            assert await client.open(60, 0, 2) == 2
            assert context.subscriptions == frozenset()
            assert await client.open(60, 7) == 3
            client.close()
            await until(lambda: context.stats.peers == 0)

    run(story)


def test_who_pulls_gets_the_newest_of_each_and_then_their_end() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            assert await client.ask(1, 0, 5, b"\0\0\0\2") == (4, b"")
            assert await client.ask(1, 0, 10, struct.pack(">5i", -1, -1, 1, -1, 1)) == (4, b"")
            for address in ((60, 0), (51, 1)):
                assert await client.open(*address) == 1
            context.emit()
            context.emit()
            assert await client.ask(1, 0, 4) == (4, b"")
            heads = [await client.hear() for _ in range(3)]
            assert [head for head, _, _ in heads] == [(60, 0, 1, 2), (51, 1, 1, 1), (1, 0, 5, 1)]
            assert data_of(heads[1][2]) == {"t_ns": 8_000_000, "seq": 1, "valid": True, "value": {"depth": 0.001}}
            assert await client.ask(1, 0, 4) == (4, b"")  # nothing new yet: told with the next tick
            context.emit(DEPTH.path)
            assert [(await client.hear())[0] for _ in range(2)] == [(51, 1, 1, 1), (1, 0, 5, 1)]
            assert (await client.ask(1, 0, 5, b"\0\0\0\7"))[0] == 6
            client.close()

    run(story)


def test_an_actuator_takes_commands_and_answers_requests() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            number = list(context.ports).index(THRUSTERS.path)
            body = octets(b'{"u": [0.5,0.5,0.5,0.5,0.5,0.5,0.5,0.5]}')
            client.send(51, number, 2, 1, body)  # not open yet
            assert await client.open(51, number) == 1
            assert not context.commands
            assert "not open" in context.stats.last_error
            client.send(51, number, 2, 1, body)
            kind, said = await client.ask(51, number, 1, body)
            assert (kind, data_of(said)) == (4, {"result": None})
            kind, said = await client.ask(51, number, 1, octets(b'{"v": 1}'))
            assert kind == 6
            assert "it takes: u" in data_of(said)["error"]  # type: ignore[index, call-overload]
            client.send(51, number, 2, 1, octets(b'{"v": 1}'))
            await until(lambda: "player#1" in context.stats.last_error)
            assert [command.value for command in context.commands] == [((0.5,) * 8,)] * 2
            client.close()

    run(story)


def test_services_are_called_by_an_opaque_device() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            number = len(context.ports)
            await client.open(51, number)
            kind, said = await client.ask(51, number, 1, octets(b'{"service":"world/echo","args":{"value":[1,"a"]}}'))
            assert (kind, data_of(said)) == (4, {"result": [1, "a"]})
            kind, said = await client.ask(51, number, 1, octets(b'{"service":"world/ecko"}'))
            assert kind == 6
            assert 'did you mean "world/echo"' in data_of(said)["error"]  # type: ignore[index, call-overload]
            client.close()

    run(story)


def test_speed_is_the_autopilots() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            await client.open(30, 0)
            client.send(30, 0, 2, 1, struct.pack(">6dI", 1.0, 0.5, 0.25, 0.0, 0.0, 0.1, 1))
            await until(lambda: context.commands)
            assert context.commands[0].value == ((1.0, -0.5, -0.25), (-0.1,))
            assert (await client.ask(30, 0, 2, b"\0\0\0\1"))[0] == 6  # this world has nothing to arm
            assert "rov/autopilot/arm" in context.stats.last_error
            client.close()

    run(story)


def test_a_sensor_takes_nothing_and_what_is_unknown_is_refused() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            await client.open(51, 0)
            assert (await client.ask(51, 0, 1, octets(b"{}")))[0] == 6
            assert (await client.ask(60, 5, 1))[0] == 6
            assert (await client.ask(1, 0, 99))[0] == 6
            await client.open(60, 0)
            assert (await client.ask(60, 0, 1, b"\0\0\0\2"))[0] == 4
            assert (await client.ask(60, 0, 1, b"\0\0\0\4"))[0] == 6
            client.send(1, 0, 2, 1)
            client.send(4, 0, 2, 1)
            await until(lambda: context.stats.errors >= 5)
            client.close()

    run(story)


def test_devices_come_and_go_with_the_world() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(FREE, context) as port:
            client = await Client.connect(port)
            await client.open(60, 0)
            context.set_ports((DEPTH,))
            assert context.subscriptions == frozenset()
            _, said = await client.ask(1, 0, 1)
            numbers = struct.unpack(f">{len(said) // 4}I", said)
            assert numbers[:2] == (2, 2)
            assert (numbers[4:6], numbers[8:]) == ((51, 0), (51, 1))
            context.set_ports((IMU, DEPTH))
            assert context.subscriptions == {IMU.path}
            client.close()

    run(story)


def test_who_floods_is_refused_and_read_later() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(PlayerConfig(port=0, max_requests_per_s=10), context) as port:
            client = await Client.connect(port)
            for _ in range(50):
                client.send(1, 0, 2, 1)
            await until(lambda: "more than 10 messages a second" in context.stats.last_error)
            client.close()

    run(story)


def test_who_has_said_nothing_valid_takes_no_place_and_is_ended_in_time() -> None:
    async def story(context: FakeContext) -> None:
        async with serving(PlayerConfig(port=0, max_clients=1, hello_timeout_s=0.3), context) as port:
            silent, client = await Client.connect(port), await Client.connect(port)
            assert (await client.ask(1, 0, 1))[0] == 4
            late = await Client.connect(port)
            late.send(1, 0, 3, 1)
            assert await late.reader.read() == b""
            assert await silent.reader.read() == b""
            assert (await client.ask(1, 0, 1))[0] == 4
            for each in (silent, client, late):
                each.close()

    run(story)


@pytest.mark.parametrize(
    ("config", "error", "text"),
    [
        (PlayerConfig(bind="0.0.0.0"), CannotListen, "allow_network"),
        (PlayerConfig(port=0, pose="truth"), CannotServe, "truth = true"),
    ],
)
def test_what_is_not_allowed_is_not_served(config: PlayerConfig, error: type[Exception], text: str) -> None:
    async def story(context: FakeContext) -> None:
        with pytest.raises(error, match=text):
            async with serving(config, context):
                pass

    run(story)
