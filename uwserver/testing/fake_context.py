"""An `AdapterContext` for tests: plain lists of ports and services with scripted answers, and no world."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from uwserver.adapter import AdapterStats, Driver, Subscriber, VehicleFacts, WorldFacts
from uwserver.ports import (
    Argument,
    Buffer,
    Command,
    EntityList,
    Event,
    Field,
    Json,
    OnReply,
    Port,
    Progress,
    Refused,
    Reply,
    Sample,
    SceneState,
    SceneView,
    Service,
    Value,
    matches,
)
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.testing.fake_scene import NOBODY, bare_scene

TICK_NS = 4_000_000
"""Simulation time of a tick."""

Script = Callable[[Mapping[str, Json]], Json]
"""Returns the answer of a service; may raise `Refused`, or any other exception to simulate a fault of the server."""

IMU = Port(
    "rov/imu",
    "sensor",
    "imu",
    (
        Field("f_S", "m/s^2", "specific force", "S", (3,)),
        Field("w_S", "rad/s", "angular rate", "S", (3,)),
        Field("temperature", "degC", "temperature of the water"),
    ),
    "Inertial unit.",
    rate_hz=125.0,
    message="Imu",
)
DEPTH = Port(
    "rov/depth",
    "sensor",
    "pressure",
    (Field("depth", "m", "depth below the surface"),),
    "Depth.",
    rate_hz=25.0,
    message="FluidPressure",
)
THRUSTERS = Port(
    "rov/thrusters",
    "actuator",
    "thrusters",
    (Field("u", "1", "command of each thruster", shape=(8,), minimum=-1.0, maximum=1.0),),
    "All thrusters.",
    timeout_s=1.0,
)
PORTS = (IMU, DEPTH, THRUSTERS)
WORLD = WorldFacts(
    server="uwserver",
    scenario="fake",
    rate_hz=1e9 / TICK_NS,
    epoch_utc="2024-01-01T00:00:00Z",
    mode="lockstep",
    speed=1.0,
    vehicles=(VehicleFacts("rov", "fake"),),
)
"""A world in lockstep, so that drivers are asked. For adapters without a driver it makes no difference."""

SERVICES = (
    Service("world/status", "State of the world.", reads_only=True),
    Service("world/pause", "Stop the time."),
    Service(
        "world/step",
        "Run ticks.",
        (Argument("n", "int", "number of ticks", required=False, default=1, minimum=1),),
        long_running=True,
    ),
    Service("world/run_until", "Run to a time.", (Argument("t_s", "float", "time", "s"),), long_running=True),
    Service("world/echo", "Gives back its argument.", (Argument("value", "json", "anything", required=False),)),
)


@dataclass
class HeldCall:
    """A call that the test answers.

    Attributes:
        service: path of the service, or of the port of a command.
        args: the checked arguments.
        source: who called.
        on_reply: gets progress and the answer.
        is_done: whether it is answered.
    """

    service: str
    args: Mapping[str, Json]
    source: str
    on_reply: OnReply
    is_done: bool = False

    def progress(self, fraction: float, t_ns: int = 0) -> None:
        """Report the progress of the call, from 0 to 1."""
        self.on_reply(Progress(fraction, t_ns))

    def finish(self, reply: Reply) -> None:
        """Give the one answer."""
        self.is_done = True
        self.on_reply(reply)


@dataclass
class FakeContext:
    """An implementation of `uwserver.adapter.AdapterContext` for tests. It belongs to the loop.

    Commands and calls are checked as in the server, recorded, and answered in the next turn of the loop; services that only read answer at once.

    Attributes:
        name: name of the adapter.
        stats: counters of the adapter.
        world: facts about the world.
        ports, services: the ports and services by path; `set_ports` replaces the ports.
        scripts: answers of services by path; other services answer null.
        held: paths of services and actuators whose answers wait for the test.
        commands: all commands in order.
        calls: all calls in order, and the commands of `held` actuators.
        queues: queue of each command and call, in order; "" for that of its source.
        joined: clients in the lockstep barrier.
        drivers: drivers that are asked for orders now, each millisecond of wall time; each tick of an order is an `emit`.
        subscribers: subscribers that are attached now.
        subscriptions: ports that subscribers or drivers subscribe to; no others are delivered.
        described: patterns for which `describe` was called.
        tick: number of the tick, which grows with each `emit`.
        scene_state: where bodies are; the test may replace it.
        scene_requests: how often `request_scene_state` was called.
        files: triangles and glTF files by hash.
    """

    name: str = "fake"
    stats: AdapterStats = field(default_factory=AdapterStats)
    world: WorldFacts = WORLD
    ports: Mapping[str, Port] = field(default_factory=lambda: {port.path: port for port in PORTS})
    services: Mapping[str, Service] = field(default_factory=lambda: {service.path: service for service in SERVICES})
    scripts: dict[str, Script] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    commands: list[Command] = field(default_factory=list)
    calls: list[HeldCall] = field(default_factory=list)
    queues: list[str] = field(default_factory=list)
    joined: list[str] = field(default_factory=list)
    drivers: list[Driver] = field(default_factory=list)
    subscribers: list[Subscriber] = field(default_factory=list)
    subscriptions: frozenset[str] = frozenset()
    described: list[str] = field(default_factory=list)
    tick: int = 0
    scene_state: SceneState = NOBODY
    scene_requests: int = 0
    files: dict[str, bytes] = field(default_factory=dict)
    _seq: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scripts.setdefault("world/echo", lambda args: args["value"])

    # -- what an adapter calls --------------------------------------------------------------------------------------------------------

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """Return the ports and services that match."""
        self.described.append(pattern)
        return {
            "server": {"name": self.world.server, "version": "test"},
            "world": {
                "scenario": self.world.scenario,
                "rate_hz": self.world.rate_hz,
                "epoch_utc": self.world.epoch_utc,
                "seed": 1,
            },
            "ports": msgspec.to_builtins([port for path, port in self.ports.items() if matches(pattern, path)]),
            "services": msgspec.to_builtins([s for path, s in self.services.items() if matches(pattern, path)]),
        }

    def hello(self) -> dict[str, Json]:
        """Return the common part of the answer to `hello`."""
        return {"server": "uwserver test", "scenario": "fake"}

    def last(self, port: str) -> Sample | None:
        """Return a sample of the port if it is a sensor, or None."""
        known = self.ports.get(port)
        return sample_of(known) if known is not None and known.direction == "sensor" else None

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        """Deliver a sample of each sensor among the ports, in the next turn of the loop."""
        samples = [sample for path in ports if (sample := self.last(path)) is not None]
        asyncio.get_running_loop().call_soon(on_samples, samples)

    def request_scene_state(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        """Deliver `scene_state` in the next turn of the loop."""
        self.scene_requests += 1
        asyncio.get_running_loop().call_soon(lambda: on_state(self.scene_state))

    def scene(self, entities: EntityList) -> SceneView:
        """Return a world with nothing but bodies in it."""
        return bare_scene(entities, self.world)

    def mesh(self, sha256: str) -> bytes | None:
        """Return a file of the test."""
        return self.files.get(sha256)

    model_file = mesh

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        """Begin to deliver samples and events; the returned function ends that."""
        self.subscribers.append(subscriber)
        self.subscriptions_changed()

        def detach() -> None:
            self.subscribers.remove(subscriber)
            self.subscriptions_changed()

        return detach

    def subscriptions_changed(self) -> None:
        """Read what subscribers and drivers subscribe to."""
        readers = [*self.subscribers, *self.drivers]
        subscriptions = [
            self.ports.keys() if (some := getattr(r, "subscriptions", None)) is None else some for r in readers
        ]
        self.subscriptions = frozenset().union(*subscriptions)

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """Check and record a command, and answer it."""
        find("port", port, self.ports)
        checked = checked_command(self.ports[port], value)
        self.commands.append(Command(port, checked, source))
        self.queues.append(queue)
        if on_reply is None:
            return
        if port in self.held:
            self.calls.append(HeldCall(port, {}, source, on_reply))
        else:
            asyncio.get_running_loop().call_soon(on_reply, Reply(self.tick, self.tick * TICK_NS))

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        source: str,
        on_reply: OnReply,
        client: str = "",
        queue: str = "",
    ) -> Callable[[], bool]:
        """Check and record a call, and answer it as scripted."""
        find("service", service, self.services)
        call = HeldCall(service, checked_args(self.services[service], args), source, on_reply)
        self.calls.append(call)
        self.queues.append(queue)
        if service not in self.held:
            script = self.scripts.get(service, lambda _: None)
            reply = self._scripted(script, call.args)
            if self.services[service].reads_only:
                call.finish(reply)
            else:
                asyncio.get_running_loop().call_soon(lambda: None if call.is_done else call.finish(reply))
        return lambda: self._cancel(call)

    def tell_conflict(self, text: str) -> None:
        """Send the event `conflict` to every subscriber."""
        self.say(Event("conflict", self.tick, self.tick * TICK_NS, text))

    def join(self, client: str) -> Callable[[], None]:
        """Count a named client; the returned function ends that."""
        self.joined.append(client)
        return lambda: self.joined.remove(client)

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """Ask a driver for orders on the loop from now on, as the simulation thread would; the returned function ends that."""

        async def ask() -> None:
            try:
                while True:
                    self._carry_out(client, driver)
                    await asyncio.sleep(1e-3)
            except Exception as error:  # noqa: BLE001  # as the server does
                fault = Refused("internal", f"{type(error).__name__}: {error}", client).fault
                on_reply(Reply(self.tick, self.tick * TICK_NS, fault=fault))

        task = asyncio.get_running_loop().create_task(ask())
        self.drivers.append(driver)
        self.subscriptions_changed()

        def end() -> None:
            self.drivers.remove(driver)
            self.subscriptions_changed()
            task.cancel()

        return end

    def _carry_out(self, client: str, driver: Driver) -> None:
        """Carry out the driver's next order, if there is one."""
        order = driver.order(0.0)
        if order is None:
            return
        for path, value in order.commands:
            try:
                self.command(path, value, client, None)
            except Refused as refused:
                driver.refuse(refused.fault)
        for _ in range(order.ticks):
            self.emit()
        driver.answer(self.tick * TICK_NS)

    def _scripted(self, script: Script, args: Mapping[str, Json]) -> Reply:
        try:
            return Reply(self.tick, self.tick * TICK_NS, script(args))
        except Refused as refused:
            return Reply(self.tick, self.tick * TICK_NS, fault=refused.fault)

    def _cancel(self, call: HeldCall) -> bool:
        if call.is_done:
            return False
        fault = Refused("preempted", "cancelled by its caller", call.service).fault
        call.finish(Reply(self.tick, self.tick * TICK_NS, fault=fault))
        return True

    # -- what a test calls ----------------------------------------------------------------------------------------------------------

    def emit(self, *paths: str) -> list[Sample]:
        """Run one tick: deliver the next sample of these sensors, by default of all, to every subscriber, and return the samples."""
        self.tick += 1
        chosen = paths or tuple(path for path, port in self.ports.items() if port.direction == "sensor")
        samples = []
        for path in chosen:
            seq = self._seq.get(path, 0)
            self._seq[path] = seq + 1
            samples.append(sample_of(self.ports[path], seq, self.tick * TICK_NS))
        self.put(samples)
        return samples

    def put(self, samples: Sequence[Sample]) -> None:
        """Deliver those of these samples that somebody wants, as one tick, to every driver and subscriber."""
        samples = [sample for sample in samples if sample.port in self.subscriptions]
        for driver in list(self.drivers):
            driver.see(self.tick * TICK_NS, samples)
        for subscriber in list(self.subscribers):
            subscriber.put_samples(samples)
            getattr(subscriber, "send_samples", lambda: None)()

    def say(self, event: Event) -> None:
        """Send an event to every subscriber."""
        for subscriber in list(self.subscribers):
            subscriber.put_event(event)

    def set_ports(self, ports: Iterable[Port]) -> None:
        """Replace the ports, and send every subscriber the event of it."""
        self.ports = {port.path: port for port in ports}
        self.say(Event("ports_changed", self.tick, self.tick * TICK_NS, "the test changed the ports"))
        self.subscriptions_changed()


def sample_of(port: Port, seq: int = 0, t_ns: int = 0, valid: bool = True) -> Sample:
    """Return a sample of a sensor. Its numbers differ by field, component and `seq`; if it is not `valid`, it has no values."""
    values = [_value(field, 100.0 * index + seq * 1e-3, valid) for index, field in enumerate(port.fields)]
    return Sample(port.path, seq, t_ns, t_ns, valid, tuple(values))


def _value(field: Field, base: float, valid: bool) -> Value:
    if not valid:
        return (None,) * field.size if field.shape else None
    if field.buffer:
        shape = tuple(2 if extent < 0 else extent for extent in field.buffer.shape)
        return Buffer.of(np.full(shape, base % 128, field.buffer.dtype))
    if field.type == "bytes":
        return Buffer(data=f"{field.name} {base}".encode())
    components = tuple(_component(field, base, component) for component in range(field.size))
    return components if field.shape else components[0]


def _component(field: Field, base: float, component: int) -> float | int | bool | str:
    if field.type == "float":
        return base + component
    if field.type == "int":
        return int(base) + component
    return component % 2 == 0 if field.type == "bool" else f"{field.name}{component}"
