"""A server that a test owns: the `AdapterContext` over plain lists of ports and services, with scripted answers and no world."""

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
    Cast,
    Command,
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
"""What a service answers; may raise `Refused`, or anything else to play a fault of the server."""

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
)
DEPTH = Port(
    "rov/depth", "sensor", "pressure", (Field("depth", "m", "depth below the surface"),), "Depth.", rate_hz=25.0
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
"""In lockstep, so that drivers are asked; adapters without one see no difference."""

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
    """A call that the test answers itself."""

    service: str
    args: Mapping[str, Json]
    source: str
    on_reply: OnReply
    is_done: bool = False

    def progress(self, fraction: float, t_ns: int = 0) -> None:
        """Report how far it is."""
        self.on_reply(Progress(fraction, t_ns))

    def finish(self, reply: Reply) -> None:
        """Give the one answer."""
        self.is_done = True
        self.on_reply(reply)


@dataclass
class FakeContext:
    """Implements `uwserver.adapter.AdapterContext`. Commands and calls are checked as the server does it, recorded, and answered with the next
    turn of the loop (services that only read: at once). All on the loop.

    Attributes:
        world: facts of the world.
        ports, services: what there is, by path; replaced by `set_ports`.
        scripts: what a service answers, by path; null for the others.
        held: services and actuator ports whose answers wait for the test, by path.
        commands: as they came.
        calls: those of `held` paths, and all others as they came.
        queues: in which commands and calls wait, in their order; "" for that of their source.
        joined: clients in the barrier.
        drivers: asked for orders now, each millisecond of wall time; a tick of an order is an `emit`.
        subscribers: attached now.
        wanted: ports that they or the drivers want; no others are given.
        described: patterns for which `describe` was called.
        tick: grows with each `emit`.
        state: where bodies are; replaced by the test.
        looked: how often somebody asked for it.
        files: triangles and looks by hash.
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
    wanted: frozenset[str] = frozenset()
    described: list[str] = field(default_factory=list)
    tick: int = 0
    scene_state: SceneState = NOBODY
    looked: int = 0
    files: dict[str, bytes] = field(default_factory=dict)
    _seq: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scripts.setdefault("world/echo", lambda args: args["value"])

    # -- what an adapter calls --------------------------------------------------------------------------------------------------------

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """Ports and services that match."""
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
        """Common part of the answer to `hello`."""
        return {"server": "uwserver test", "scenario": "fake"}

    def last(self, port: str) -> Sample | None:
        """A sample of the port, if it is a sensor."""
        known = self.ports.get(port)
        return sample_of(known) if known is not None and known.direction == "sensor" else None

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        """A sample of each sensor among the ports, with the next turn of the loop."""
        samples = [sample for path in ports if (sample := self.last(path)) is not None]
        asyncio.get_running_loop().call_soon(on_samples, samples)

    def look(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        """The state of the test, with the next turn of the loop."""
        self.looked += 1
        asyncio.get_running_loop().call_soon(lambda: on_state(self.scene_state))

    def scene(self, cast: Cast) -> SceneView:
        """A world with nothing but bodies in it."""
        return bare_scene(cast, self.world)

    def mesh(self, sha256: str) -> bytes | None:
        """What the test has put there."""
        return self.files.get(sha256)

    def looks(self, sha256: str) -> bytes | None:
        """Likewise."""
        return self.mesh(sha256)

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        """Begin to deliver."""
        self.subscribers.append(subscriber)
        self.follow_wants()

        def detach() -> None:
            self.subscribers.remove(subscriber)
            self.follow_wants()

        return detach

    def follow_wants(self) -> None:
        """Ask subscribers and drivers what they want."""
        readers = [*self.subscribers, *self.drivers]
        wanted = [self.ports.keys() if (some := getattr(r, "wanted", None)) is None else some for r in readers]
        self.wanted = frozenset().union(*wanted)

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """Check, record, answer."""
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
        """Check, record, answer as scripted."""
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
        """An event, to every subscriber."""
        self.say(Event("conflict", self.tick, self.tick * TICK_NS, text))

    def join(self, client: str) -> Callable[[], None]:
        """A named client is there."""
        self.joined.append(client)
        return lambda: self.joined.remove(client)

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """Ask a driver from now on."""
        pump = _Pump(self, client, driver, on_reply)
        self.drivers.append(driver)
        self.follow_wants()

        def end() -> None:
            self.drivers.remove(driver)
            self.follow_wants()
            pump.end()

        return end

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
        """One tick: the next sample of these sensors (default: of all), to every subscriber."""
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
        """Those of these samples that somebody wants, as one tick, to every subscriber."""
        samples = [sample for sample in samples if sample.port in self.wanted]
        for driver in list(self.drivers):
            driver.see(self.tick * TICK_NS, samples)
        for subscriber in list(self.subscribers):
            subscriber.put_samples(samples)
            getattr(subscriber, "send_samples", lambda: None)()

    def say(self, event: Event) -> None:
        """An event, to every subscriber."""
        for subscriber in list(self.subscribers):
            subscriber.put_event(event)

    def set_ports(self, ports: Iterable[Port]) -> None:
        """Other ports from now on; every subscriber is told."""
        self.ports = {port.path: port for port in ports}
        self.say(Event("ports_changed", self.tick, self.tick * TICK_NS, "the test changed the ports"))
        self.follow_wants()


class _Pump:
    """Plays the simulation thread to a driver, on the loop."""

    def __init__(self, context: FakeContext, client: str, driver: Driver, on_reply: OnReply) -> None:
        self._context = context
        self._client = client
        self._driver = driver
        self._on_reply = on_reply
        self._loop = asyncio.get_running_loop()
        self._next: asyncio.Handle = self._loop.call_soon(self._turn)

    def _turn(self) -> None:
        try:
            self._step()
        except Exception as error:  # noqa: BLE001  # as the server does
            fault = Refused("internal", f"{type(error).__name__}: {error}", self._client).fault
            self._on_reply(Reply(self._context.tick, self._context.tick * TICK_NS, fault=fault))
            return
        self._next = self._loop.call_later(1e-3, self._turn)

    def _step(self) -> None:
        context = self._context
        order = self._driver.order(0.0)
        if order is None:
            return
        for path, value in order.commands:
            try:
                context.command(path, value, self._client, None)
            except Refused as refused:
                self._driver.refuse(refused.fault)
        for _ in range(order.ticks):
            context.emit()
        self._driver.answer(context.tick * TICK_NS)

    def end(self) -> None:
        """Ask no more."""
        self._next.cancel()


def sample_of(port: Port, seq: int = 0, t_ns: int = 0, valid: bool = True) -> Sample:
    """A sample of a sensor whose numbers tell field, component and `seq` apart; without values when not `valid`."""
    values = [_value(field, 100.0 * index + seq * 1e-3, valid) for index, field in enumerate(port.fields)]
    return Sample(port.path, seq, t_ns, t_ns, valid, tuple(values))


def _value(field: Field, base: float, valid: bool) -> Value:
    if field.type == "float":
        components: list[float | int | bool | str] = [base + component for component in range(field.size)]
    elif field.type == "int":
        components = [int(base) + component for component in range(field.size)]
    elif field.type == "bool":
        components = [component % 2 == 0 for component in range(field.size)]
    elif field.buffer:
        shape = tuple(2 if extent < 0 else extent for extent in field.buffer.shape)
        return Buffer.of(np.full(shape, base % 128, field.buffer.dtype)) if valid else None
    elif field.type == "bytes":
        return Buffer(data=f"{field.name} {base}".encode()) if valid else None
    else:
        components = [f"{field.name}{component}" for component in range(field.size)]
    if not valid:
        return (None,) * field.size if field.shape else None
    return tuple(components) if field.shape else components[0]
