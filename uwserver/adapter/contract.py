"""The contract between the server and an adapter, and how adapters are found.

An adapter turns ports into one protocol. It lives on the asyncio loop, never on the simulation thread, and sees the world only through its
`AdapterContext`. A new adapter is one folder (or one distribution) with an entry point in the group ``uwserver.adapters``; nothing in uwserver
is edited for it. Where a packet of a peer is a tick, the adapter has a `Driver`, which is asked on the simulation thread.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, runtime_checkable

from uwserver.adapter.world import WorldFacts
from uwserver.ports import Cast, Event, Fault, Json, OnReply, Port, Sample, SceneState, SceneView, Service
from uwserver.table import Table

log = logging.getLogger(__name__)

ENTRY_POINT_GROUP = "uwserver.adapters"


class AdapterTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """What the table of any adapter may hold.

    Attributes:
        truth: serve the ports under ``<vehicle>/truth/`` too.
        required: a scenario whose adapter cannot start is not run (otherwise it is retried and reported).
    """

    truth: bool = False
    required: bool = True

    def needs(self) -> Mapping[str, str]:
        """Modules that are imported only once it runs, each with the requirement that brings it: ``{"h5py": "uwserver[netcdf]"}``.

        Those that are not installed are told before anything else is done.
        """
        return {}

    def faults(
        self, ports: Mapping[str, Port], services: Mapping[str, Service]
    ) -> Iterable[tuple[tuple[str, ...], str]]:
        """What it names of the world and cannot serve: keys below its table, and what is wrong. `uwserver check` tells it, as a run would.

        Args:
            ports: that it may serve, by path, when the scenario begins.
            services: of its components, by path.
        """
        return ()

    def parts(self) -> Mapping[str, str]:
        """What it serves where, if that is more than one thing: a text by the key of its table, which `uwserver check` tells."""
        return {}


@dataclass
class AdapterStats:
    """What an adapter reports of itself, in ``world/status`` and metrics. Counted by the adapter, on the loop.

    Attributes:
        state: one of starting, running, retrying, failed, stopped.
        address: where a peer finds it, as the user would type it.
        peers: connected now.
        samples_sent, bytes_sent, commands, calls, errors, dropped: since the start; `dropped` counts samples lost to slow peers.
        encoded: samples encoded since the start: once for all peers that take the same encoding and fields.
        restarts: times that it was started again after a failure.
        last_error: text of the last failure.
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


class Subscriber(Protocol):
    """Where an adapter takes in what the world says; called on the loop, once a tick; must not block.

    It may have an attribute (or property) `wanted`: paths of the ports whose samples it reads, a collection, or None for all, which holds where
    there is none. Samples are made of ports that somebody wants, and of no others; what others want comes too. It is looked at when the
    subscriber is attached, after the ports have changed, when it has had the event of that, and at `AdapterContext.follow_wants`. Until then
    samples of ports that just came are made in any case.

    It may also have `thinned`: path -> what is enough of that port (`uwserver.ports.thinning.Thinning`, some of them), for ports of which it
    needs no other samples than those that one of these takes. They are looked at together with `wanted`, and hold until the event of a reset or
    of other ports. More samples may come; those that are needed come all.

    It may have a method `put_told`, which gets samples of some ticks that follow each other at once (`Told`), as rows of
    numbers, and is called in place of `put_samples` where all of them are rows; where others read too, of one tick.

    It may have a method `send_samples`, without arguments, which is called where no more samples wait: the ticks may then be sent together.
    """

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """All samples delivered in one tick (truth only if the adapter may serve it)."""

    def put_event(self, event: Event) -> None:
        """Something every client should know."""


@dataclass(frozen=True)
class Order:
    """What a driver's peer wants next.

    Attributes:
        ticks: that time may go on, at least 1; the peer is answered after the last.
        commands: path of an actuator and field -> value, checked like any command, for the first of these ticks.
    """

    ticks: int
    commands: Sequence[tuple[str, Mapping[str, object]]]


class Driver(Protocol):
    """The part of an adapter that sets the pace of a lockstep world, for a protocol in which a peer's packet is a tick.

    It is called on the simulation thread, the only part of an adapter that is: the hand-over to the loop and back takes longer than a tick.
    So it has its own non-blocking or time-limited socket, touches nothing that the loop changes, and never takes longer than it is told.
    It may have `wanted`, as a `Subscriber`, which is looked at on the loop.
    """

    def order(self, wait_s: float) -> Order | None:
        """The peer's next order, or None when none came within `wait_s` (wall time; at 0 it does not wait)."""

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """A tick ended at t_ns, with these samples (truth only if the adapter may serve it). Every tick, also those of no order."""

    def answer(self, t_ns: int) -> None:
        """The last tick of the order has ended, or the world was put to another time: tell the peer."""

    def refuse(self, fault: Fault) -> None:
        """A command of the order was not taken; the ticks are."""


class AdapterContext(Protocol):
    """Everything an adapter may use of the server. All on the loop thread, but for what a `Driver` is asked.

    Attributes:
        name: the adapter's table name in the scenario.
        stats: counters that the adapter keeps.
    """

    name: str
    stats: AdapterStats

    @property
    def world(self) -> WorldFacts:
        """The world as it is now: scenario, rate, epoch, mode, speed, vehicles."""

    @property
    def ports(self) -> Mapping[str, Port]:
        """Ports that this adapter may serve, by path."""

    @property
    def services(self) -> Mapping[str, Service]:
        """All services, by path."""

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """The `describe` result of docs/reference/protocol.md for ports and services that match."""

    def hello(self) -> dict[str, Json]:
        """Server name and version, scenario name: the common part of the answer to `hello`."""

    def last(self, port: str) -> Sample | None:
        """The newest delivered sample of a port of which a subscriber of this adapter wants all, since it does; None before the first."""

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        """Ask for the newest delivered samples of some ports, which nobody needs to want.

        Args:
            ports: paths; those that are not there, or have said nothing yet, are left out.
            on_samples: gets them on the loop, once.
            source: as for `command`.

        Raises:
            Refused: `overload`; too much that was asked waits already.
        """

    def look(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        """Ask where all bodies are, and what their actuators achieve. This is ground truth: who tells it to peers says so in its table.

        Args:
            on_state: gets it on the loop, once.
            source: as for `command`.

        Raises:
            Refused: `overload`; too much that was asked waits already.
        """

    def scene(self, cast: Cast) -> SceneView:
        """What the world looks like with these bodies, which a `SceneState` names. The first of a large seabed takes some 10 ms."""

    def mesh(self, sha256: str) -> bytes | None:
        """Triangles that a scene names by hash: u32 numbers of vertices and triangles, then f32 x, y, z of each vertex, then u32 vertex
        numbers of each triangle, all little endian. None where no scene has named it."""

    def looks(self, sha256: str) -> bytes | None:
        """The glTF file that a scene names by hash; None where no scene has named it."""

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        """Begin to receive samples and events; the returned function ends it."""

    def follow_wants(self) -> None:
        """What a subscriber or driver of this adapter wants has changed. A step that is asked for after this gives those samples."""

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """Check and post a command; it is applied at the start of the next tick.

        Args:
            port: path.
            value: field name -> number or (nested) list.
            source: who sent it, unique for a client.
            on_reply: gets the one Reply on the loop; None where the protocol has no acknowledgement.
            queue: in which it waits, where several peers share a source: each queue has its turn, and its own order. Default: the source's.

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
        """Check and start a service call. Replies that only read come before this returns.

        Args:
            service: path.
            args: argument name -> value.
            source: as for `command`.
            on_reply: gets any Progress and the one Reply, on the loop.
            client: the name with which the client joined, for the lockstep barrier.
            queue: as for `command`.

        Returns:
            A function that cancels it: True when it was still under way (its Reply then says `preempted`).

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or busy.
        """

    def tell_conflict(self, text: str) -> None:
        """Tell all clients that two peers want to command the same: an event `conflict`. From any thread; sparingly."""

    def join(self, client: str) -> Callable[[], None]:
        """A named client is there (it counts in a lockstep barrier); the returned function says that it left."""

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """Grant the ticks of a lockstep client through a driver, which is called on the simulation thread from now on.

        Args:
            client: a name in the scenario's `lockstep_clients`.
            driver: see there.
            on_reply: gets a Reply with a fault when the driver raised an exception; it is not called any more then.

        Returns:
            A function that ends it. When it returns, the driver is not called any more, and what it used may be closed.

        Raises:
            Refused: the world is not in lockstep, does not know the client, or it has a driver already.
        """


@runtime_checkable
class Adapter(Protocol):
    """One configured adapter. Constructed on the loop as ``Kind(config, context)``; class attribute `Config` is its AdapterTable."""

    Config: type[Any]

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Sets `ready` once peers can connect. Reconnects by itself where it is the client. Leaves no task, thread, socket or file behind when it
        ends or is cancelled. May raise: the server reports it and starts it again with back-off.
        """


class AdapterNotFound(Exception):
    """An entry point names an adapter that cannot be imported; the text says what to install."""


def installed_adapters() -> dict[str, type[Any]]:
    """Configuration type of each installed adapter, by kind. One that cannot be loaded is left out with a warning: the others still serve."""
    configs: dict[str, type[Any]] = {}
    for kind, entry in adapter_entries().items():
        try:
            configs[kind] = _loaded(kind, entry).Config
        except AdapterNotFound as reason:
            log.warning("%s; scenarios cannot use it", reason)
    return configs


def adapter_entries() -> dict[str, EntryPoint]:
    """Entry points by kind, without importing them: to look for them takes a millisecond or more for each hundred packages that are installed."""
    entries: Iterable[EntryPoint] = entry_points(group=ENTRY_POINT_GROUP)
    return {entry.name: entry for entry in sorted(entries, key=lambda entry: entry.name)}


def load_adapter(kind: str) -> type[Any]:
    """The adapter class of a kind.

    Raises:
        AdapterNotFound: no such entry point, its module fails to import, or it is no adapter; names the distribution.
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
    """Looked for only where there is something to tell: its description is read for it."""
    return entry.dist.name if entry.dist else "unknown distribution"
