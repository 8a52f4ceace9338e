"""The contract between the server and an adapter, and how adapters are found.

An adapter serves ports in one protocol. It lives on the asyncio loop, never on the simulation thread, and sees the world only through its
`AdapterContext`; what it knows without a request is in `WorldFacts`. A new adapter is one folder, or one distribution, with an entry point in the
group ``uwserver.adapters``; nothing in uwserver has to be edited for it. If each packet of a peer is a tick, the adapter has a `Driver`, which runs
on the simulation thread.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, Protocol, runtime_checkable

from msgspec import Struct

from uwserver.ports import EntityList, Event, Fault, Json, OnReply, Port, Sample, SceneState, SceneView, Service
from uwserver.table import Table
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)


ENTRY_POINT_GROUP = "uwserver.adapters"
ERROR_LIMIT = 500
"""Longest `AdapterStats.last_error`, characters: it may quote a peer."""


class VehicleFacts(Struct, frozen=True):
    """A vehicle of the scenario.

    Attributes:
        name: name in the scenario.
        model: name that the vehicle file gives to the model (``BlueROV2 Heavy``).
    """

    name: str
    model: str


class WorldFacts(Struct, frozen=True, kw_only=True):
    """The world at the time of asking.

    Attributes:
        server: name of the server.
        scenario: name of the scenario.
        rate_hz: physics ticks per simulated second.
        epoch_utc: UTC of simulation time zero, ISO 8601.
        mode: what sets the pace.
        speed: simulated seconds per second of wall time; it has a meaning only in mode realtime.
        vehicles: vehicles in the order of the scenario; spawned ones last.
    """

    server: str
    scenario: str
    rate_hz: float
    epoch_utc: str
    mode: Literal["realtime", "freerun", "lockstep"]
    speed: float
    vehicles: tuple[VehicleFacts, ...]

    @property
    def epoch_ns(self) -> int:
        """UTC of simulation time zero, ns since 1970."""
        epoch = datetime.fromisoformat(self.epoch_utc.replace("Z", "+00:00"))
        if epoch.tzinfo is None:
            epoch = epoch.replace(tzinfo=timezone.utc)
        return round(epoch.timestamp()) * NANOSECONDS


class AdapterTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """What the table of any adapter may hold.

    Attributes:
        truth: serve the ports under ``<vehicle>/truth/`` too.
        required: a scenario whose adapter cannot start is not run (otherwise it is retried and reported).
    """

    truth: bool = False
    required: bool = True

    def needs(self) -> Mapping[str, str]:
        """Return modules that are imported only when the adapter runs, each with its requirement: ``{"h5py": "uwserver[netcdf]"}``.

        Modules that are not installed are reported before anything else is done.
        """
        return {}

    def faults(
        self, ports: Mapping[str, Port], services: Mapping[str, Service]
    ) -> Iterable[tuple[tuple[str, ...], str]]:
        """Return the names in the table that the adapter cannot serve in this world. `uwserver check` reports them, as a run would.

        Args:
            ports: the ports that the adapter may serve when the scenario begins, by path.
            services: the services of the scenario's components, by path.

        Returns:
            For each fault the keys below the adapter's table, and what is wrong.
        """
        return ()

    def parts(self) -> Mapping[str, str]:
        """Return a text for each key of the table that has something served of its own, if there are several. `uwserver check` shows the texts."""
        return {}


@dataclass
class AdapterStats:
    """What an adapter reports about itself in ``world/status`` and in metrics. The adapter counts on the loop.

    Attributes:
        state: one of starting, running, retrying, failed, stopped.
        address: where a peer finds the adapter, as a user would type it.
        peers: number of peers that are connected now.
        samples_sent, bytes_sent, commands, calls, errors, dropped: counts since the start; `dropped` are samples lost because peers are slow.
        encoded: samples that were encoded since the start. A sample is encoded once for all peers with the same encoding and fields.
        restarts: how often the adapter was started again after a failure.
        last_error: text of the last failure.
        details: further values of the adapter by name.
    """

    state: str = "starting"
    address: str = ""
    peers: int = 0
    samples_sent: int = 0
    bytes_sent: int = 0
    commands: int = 0
    calls: int = 0
    errors: int = 0
    dropped: int = 0
    encoded: int = 0
    restarts: int = 0
    last_error: str = ""
    details: dict[str, Json] = field(default_factory=dict)

    def count_error(self, text: str) -> None:
        """Count an error, and keep its text as `last_error`."""
        self.errors += 1
        self.last_error = text[:ERROR_LIMIT]


class Subscriber(Protocol):
    """Receives samples and events for an adapter. It is called on the loop, once for each tick, and must not block.

    A subscriber may have some of these optional attributes and methods:

    - `subscriptions`, an attribute or property: the paths of the ports whose samples it reads, or None for all ports, which is the default. Samples
      are made only for ports to which some subscriber subscribes; a subscriber also gets those of others. The attribute is read when the subscriber
      is attached, after it has received the event of changed ports, and at `AdapterContext.subscriptions_changed`. Until then, samples of new ports
      are made in any case.
    - `decimations`: for each path the `uwserver.ports.decimation.Decimation` objects that are enough for that port. The subscriber needs only
      samples that one of them takes, and gets all of these, perhaps with others. The attribute is read together with `subscriptions`, and holds until
      the event of a reset or of changed ports.
    - `put_batch`: a method that gets the samples of several successive ticks at once, as rows of numbers (`SampleBatch`). It is called in place of
      `put_samples` if all of these samples are rows; while others read too, it gets one tick at a time.
    - `send_samples`: a method without arguments, which is called when no more samples wait, so that several ticks can be sent together.
    """

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Take in all samples that were delivered in one tick (truth only if the adapter may serve it)."""

    def put_event(self, event: Event) -> None:
        """Take in an event that every client should know."""


@dataclass(frozen=True)
class Order:
    """What a driver's peer wants next.

    Attributes:
        ticks: number of ticks that the world may go on, at least 1. The peer is answered after the last one.
        commands: paths of actuators, each with its values by field. They are checked like any command, and act in the first of these ticks.
    """

    ticks: int
    commands: Sequence[tuple[str, Mapping[str, object]]]


class Driver(Protocol):
    """The part of an adapter that sets the pace of a lockstep world, for protocols in which each packet of a peer is a tick.

    It is the only part of an adapter that is called on the simulation thread, because handing over to the loop and back takes longer than a
    tick. So it needs a socket of its own that does not block or has a time limit, must not touch anything that the loop changes, and must never
    take longer than it is allowed. It may have the attribute `subscriptions` of a `Subscriber`, which is read on the loop.
    """

    def order(self, wait_s: float) -> Order | None:
        """Return the peer's next order, or None if none came within `wait_s` of wall time; with 0 it does not wait."""

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Take in the samples of a tick that ended at t_ns (truth only if the adapter may serve it). Called for every tick, ordered or not."""

    def answer(self, t_ns: int) -> None:
        """Tell the peer that the last tick of its order has ended, or that the world was set to another time."""

    def refuse(self, fault: Fault) -> None:
        """Tell the peer that a command of its order was refused. The ticks of the order are carried out."""


class AdapterContext(Protocol):
    """Everything that an adapter may use of the server. All of it belongs to the loop thread, except for calls of a `Driver`.

    Attributes:
        name: name of the adapter's table in the scenario.
        stats: counters that the adapter keeps.
    """

    name: str
    stats: AdapterStats

    @property
    def world(self) -> WorldFacts:
        """The world as it is now: scenario, rate, epoch, mode, speed, vehicles."""

    @property
    def ports(self) -> Mapping[str, Port]:
        """The ports that this adapter may serve, by path."""

    @property
    def services(self) -> Mapping[str, Service]:
        """All services, by path."""

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """Return the result of `describe` (docs/reference/protocol.md) for the ports and services that match."""

    def hello(self) -> dict[str, Json]:
        """Return the common part of the answer to `hello`: name and version of the server, and the name of the scenario."""

    def last(self, port: str) -> Sample | None:
        """Return the newest delivered sample of a port, or None before the first.

        A subscriber of this adapter must subscribe to all samples of the port; the samples since then count.
        """

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        """Ask for the newest delivered samples of some ports. No subscriber needs to subscribe to them.

        Args:
            ports: paths. Ports that do not exist, or have sent nothing yet, are left out.
            on_samples: gets the samples on the loop, once.
            source: as for `command`.

        Raises:
            Refused: `overload`; too many requests wait already.
        """

    def request_scene_state(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        """Ask where all bodies are, and what their actuators achieve.

        This is ground truth. An adapter that passes it on to peers must say so in its table.

        Args:
            on_state: gets the state on the loop, once.
            source: as for `command`.

        Raises:
            Refused: `overload`; too many requests wait already.
        """

    def scene(self, entities: EntityList) -> SceneView:
        """Return a description of the world with these bodies, which a `SceneState` names. The first call with a large seabed takes some 10 ms."""

    def mesh(self, sha256: str) -> bytes | None:
        """Return the triangles that a scene names by hash, or None if no scene has named them.

        They are the u32 numbers of vertices and triangles, then f32 x, y, z of each vertex, then u32 vertex numbers of each triangle, all in
        little endian.
        """

    def model_file(self, sha256: str) -> bytes | None:
        """Return the glTF file that a scene names by hash, or None if no scene has named it."""

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        """Begin to deliver samples and events; the returned function ends that."""

    def subscriptions_changed(self) -> None:
        """Read again what the subscribers and drivers of this adapter subscribe to. A step that is requested after this gives those samples."""

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """Check and post a command; it is applied at the start of the next tick.

        Args:
            port: path of an actuator.
            value: for each field name a number or a (nested) list.
            source: name of the sender, unique for each client.
            on_reply: gets the one Reply on the loop; None if the protocol has no acknowledgement.
            queue: name of the queue in which the command waits, for several peers that share a source. Queues take turns, and each keeps its
                order. Default: the queue of the source.

        Raises:
            Refused: unknown port or field, wrong shape, not finite, out of range; nothing was changed.
        """

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        source: str,
        on_reply: OnReply,
        client: str = "",
        queue: str = "",
    ) -> Callable[[], bool]:
        """Check and start a call of a service. If the service only reads, its Reply comes before this returns.

        Args:
            service: path of the service.
            args: value for each argument name.
            source: as for `command`.
            on_reply: gets any Progress and the one Reply on the loop.
            client: name with which the client joined, for the lockstep barrier.
            queue: as for `command`.

        Returns:
            A function that cancels the call. It returns True if the call was still running; its Reply is then `preempted`.

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or busy.
        """

    def tell_conflict(self, text: str) -> None:
        """Send all clients the event `conflict`, because two peers command the same. May be called on any thread; use it sparingly."""

    def join(self, client: str) -> Callable[[], None]:
        """Count a named client in the lockstep barrier; the returned function ends that when the client leaves."""

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """Grant the ticks of a lockstep client through a driver, which is called on the simulation thread from now on.

        Args:
            client: a name in the scenario's `lockstep_clients`.
            driver: the driver.
            on_reply: gets a Reply with a fault if the driver raises an exception, after which the driver is not called any more.

        Returns:
            A function that ends this. When it returns, the driver is not called any more, and its resources may be closed.

        Raises:
            Refused: the world is not in lockstep, does not know the client, or the client has a driver already.
        """


@runtime_checkable
class Adapter(Protocol):
    """One configured adapter. It is constructed on the loop as ``Kind(config, context)``; the class attribute `Config` is its AdapterTable."""

    Config: type[Any]

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        It sets `ready` once peers can connect. If the adapter is the client of its protocol, it reconnects by itself. It leaves no task, thread,
        socket or file behind when it ends or is cancelled. It may raise: the server reports that, and starts the adapter again with back-off.
        """


class AdapterNotFound(Exception):
    """An entry point names an adapter that cannot be imported; the text says what to install."""


def installed_adapters() -> dict[str, type[Any]]:
    """Return the configuration type of each installed adapter by kind. Adapters that cannot be loaded are left out, with a warning."""
    configs: dict[str, type[Any]] = {}
    for kind, entry in adapter_entries().items():
        try:
            configs[kind] = _loaded(kind, entry).Config
        except AdapterNotFound as reason:
            log.warning("%s; scenarios cannot use it", reason)
    return configs


def adapter_entries() -> dict[str, EntryPoint]:
    """Return the entry points by kind, without importing them. This takes a millisecond or more for each hundred installed packages."""
    entries: Iterable[EntryPoint] = entry_points(group=ENTRY_POINT_GROUP)
    return {entry.name: entry for entry in sorted(entries, key=lambda entry: entry.name)}


def load_adapter(kind: str) -> type[Any]:
    """Return the adapter class of a kind.

    Raises:
        AdapterNotFound: there is no such entry point, its module cannot be imported, or it is no adapter; the text names the distribution.
    """
    entry = adapter_entries().get(kind)
    if entry is None:
        raise AdapterNotFound(f'no adapter "{kind}" is installed, there are: {", ".join(adapter_entries()) or "none"}')
    return _loaded(kind, entry)


def _loaded(kind: str, entry: EntryPoint) -> type[Any]:
    try:
        loaded = entry.load()
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise AdapterNotFound(f'adapter "{kind}" of {_owner(entry)} cannot be imported: {reason}') from error
    config = getattr(loaded, "Config", None)
    if (
        not isinstance(loaded, type)
        or not callable(getattr(loaded, "run", None))
        or not (isinstance(config, type) and issubclass(config, AdapterTable))
    ):
        text = (
            f'adapter "{kind}" of {_owner(entry)} needs run() and a Config derived from uwserver.adapter.AdapterTable'
        )
        raise AdapterNotFound(text)
    return loaded


def _owner(entry: EntryPoint) -> str:
    """Return the name of the distribution. It is asked for only in an error, because it is read from the distribution's metadata."""
    return entry.dist.name if entry.dist else "unknown distribution"
