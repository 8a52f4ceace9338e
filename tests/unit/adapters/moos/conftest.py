"""A world with a torpedo-shaped vehicle, and what MOOS clients say, for tests of the MOOS adapters."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from adapter_rig import serving
from msgspec.structs import replace
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.wire import MoosMessage

from uwserver.ports import Argument, Field, Port, Service
from uwserver.testing import FakeContext

POSE = Port(
    "auv/truth/pose",
    "sensor",
    "truth_pose",
    (Field("p_NB", "m", "position", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,))),
    "Pose.",
    20.0,
    message="TruePose",
)
VELOCITY = Port(
    "auv/truth/velocity",
    "sensor",
    "truth_velocity",
    (Field("v_NB_B", "m/s", "velocity", "B", (3,)), Field("w_NB_B", "rad/s", "rate", "B", (3,))),
    "Velocity.",
    20.0,
    message="TrueVelocity",
)
DEPTH = Port(
    "auv/depth", "sensor", "pressure", (Field("depth", "m", "depth"),), "Depth.", 10.0, message="FluidPressure"
)
ALTIMETER = Port(
    "auv/altimeter", "sensor", "altimeter", (Field("range", "m", "range"),), "Altimeter.", 5.0, message="Range"
)
PROPELLER = Port(
    "auv/propeller", "actuator", "thruster", (Field("u", "1", "command", minimum=-1.0, maximum=1.0),), "Propeller."
)
RUDDER = Port(
    "auv/rudder", "actuator", "fin", (Field("angle_rad", "rad", "angle", minimum=-0.3, maximum=0.3),), "Rudder."
)
THRUSTERS = Port(
    "auv/thrusters", "actuator", "thrusters", (Field("u", "1", "commands", shape=(2,), minimum=-1.0, maximum=1.0),), "Two.",
)  # fmt: skip
TELEPORT = Port(
    "auv/teleport",
    "actuator",
    "teleport",
    tuple(
        Field(name, "1", "x", "N", (size,)) for name, size in (("p_NB", 3), ("q_NB", 4), ("v_NB_B", 3), ("w_NB_B", 3))
    ),
    "Teleport.",
    message="Teleport",
)
PORTS = (POSE, VELOCITY, DEPTH, ALTIMETER, PROPELLER, RUDDER, THRUSTERS, TELEPORT)
SERVICES = (
    Service("world/status", "State.", reads_only=True),
    Service("world/pause", "Stop."),
    Service("world/resume", "Go on."),
    Service("world/set_current", "Current.", (Argument("velocity_N", "float", "water", "m/s", shape=(3,), minimum=-10.0, maximum=10.0),)),
    Service("world/run_until", "Run.", (Argument("t_s", "float", "time", "s"),), long_running=True),
    Service("world/echo", "Gives back.", (Argument("value", "json", "anything", required=False),)),
)  # fmt: skip


def _make_auv() -> FakeContext:
    context = FakeContext(ports={port.path: port for port in PORTS}, services={s.path: s for s in SERVICES})
    context.scripts["world/status"] = lambda _: {"mode": "realtime"}
    context.world = replace(context.world, mode="realtime")
    return context


class Client:
    """The smallest MOOS client: one connection, mail collected by variable."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, name: str) -> None:
        self.reader, self.writer, self.name = reader, writer, name
        self.decoder = wire.Decoder()
        self.mail: list[MoosMessage] = []
        self.others: list[MoosMessage] = []

    @classmethod
    async def connect(cls, address: str, name: str = "probe", key: str = wire.ASYNCHRONOUS) -> Client:
        host, _, port = address.rpartition(":")
        client = cls(*await asyncio.open_connection(host, int(port)), name)
        hello = MoosMessage(wire.DATA, key, data=name.encode(), kind=wire.STRING, time=1.0)
        client.writer.write(wire.HELLO + wire.packet([wire.encode(hello)]))
        await client.read()
        return client

    async def read(self) -> None:
        """One more piece of bytes; the end of the stream raises ConnectionError."""
        data = await asyncio.wait_for(self.reader.read(1 << 16), 60.0)
        if not data:
            raise ConnectionError("closed")
        self.decoder.receive(data)
        while (event := self.decoder.next_event()) is not None:
            if isinstance(event, wire.Reading):
                continue
            assert isinstance(event, wire.Packet), event
            for message in event.messages:
                (self.mail if message.type == wire.NOTIFY else self.others).append(message)

    def send(self, *messages: MoosMessage) -> None:
        self.writer.write(wire.packet([wire.encode(message) for message in messages]))

    def notify(self, time: float = 2e9, **values: float | str | bytes) -> None:
        self.send(*(wire.notify(key, value, time, self.name) for key, value in values.items()))

    def register(self, *names: str, interval: float = 0.0) -> None:
        self.send(*(MoosMessage(wire.REGISTER, name, interval, src=self.name) for name in names))

    def wildcard(self, pattern: str = "*", app: str = "*") -> None:
        self.send(wire.wildcard(wire.WILDCARD_REGISTER, self.name, 1.0, pattern, app))

    async def until(self, condition: Callable[[Client], Any]) -> Any:
        while not (found := condition(self)):
            await self.read()
        return found

    async def hear(self, key: str) -> MoosMessage:
        """The next, or the last unread, mail of a variable."""
        await self.until(lambda c: any(m.key == key for m in c.mail))
        found = next(m for m in self.mail if m.key == key)
        self.mail.remove(found)
        return found

    def last(self, key: str) -> float | str | bytes | None:
        return next((m.value for m in reversed(self.mail) if m.key == key), None)

    async def close(self) -> None:
        self.writer.transport.abort()
        await asyncio.sleep(0)


async def eventually(condition: Callable[[], Any], what: str) -> None:
    end = asyncio.get_running_loop().time() + 60.0
    while not condition():
        assert asyncio.get_running_loop().time() < end, what
        await asyncio.sleep(0.005)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Tests of this folder may be coroutines; each gets a loop, and two minutes."""
    function = pyfuncitem.obj
    if not inspect.iscoroutinefunction(function):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in inspect.signature(function).parameters}
    asyncio.run(asyncio.wait_for(function(**arguments), 120.0))
    return True


@pytest.fixture
def make_auv() -> Callable[[], FakeContext]:
    return _make_auv


@pytest.fixture
def connect() -> Callable[..., Awaitable[Client]]:
    return Client.connect


@pytest.fixture
def serve() -> Callable[..., Any]:
    return serving


@pytest.fixture
def until() -> Callable[..., Awaitable[None]]:
    return eventually
