"""The server as an adapter sees it: one `Context` for each adapter, over one `Hub`. Loop thread only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from uwserver.adapter import AdapterStats, Driver, Subscriber, VehicleFacts, WorldFacts
from uwserver.ports import (
    Call,
    Command,
    EntityList,
    Event,
    Fault,
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
    matching,
)
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.ports.crossing import is_stop
from uwserver.recording.player.player import Player
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.profiling import PROFILE, Profiling
from uwserver.server.recordings import SERVICES as RECORDING_SERVICES
from uwserver.server.recordings import Recordings
from uwserver.server.state_files import StateFiles
from uwserver.server.without_truth import DriverWithoutTruth, WithoutTruth
from uwserver.simulation.bus import Bus
from uwserver.simulation.mailbox import Mailbox, client_of
from uwserver.simulation.thread import CLOCK_SERVICES, Simulation
from uwserver.version import __version__
from uwserver.world.state.saving import LOAD, SAVE

PROTOCOL_VERSION = 1
CLOCK = {service.path: service for service in CLOCK_SERVICES}

TickProvider = Simulation | Player
"""What gives ticks to a server: a world that is stepped, or a recording that is played."""

LOOP_SERVICES = (
    Service("world/describe", "Every port and service with fields, units and frames.", reads_only=True),
    Service("world/status", "Time, real-time factor, lateness, adapters and their peers.", reads_only=True),
    Service("world/shutdown", "Shut the server down in an orderly way, with the recording intact."),
    PROFILE,
    *RECORDING_SERVICES.values(),
)


@dataclass
class Hub:
    """Everything that adapters share.

    Attributes:
        server: name of the server.
        simulation, bus, mailbox: the provider of ticks, and the two queues to its thread.
        shutdown, status: begins an orderly end of the server; returns the answer of `world/status`.
        files, profiling: saved states, and measurements of ticks; None if nothing is computed.
        scenery: describes what the world looks like.
        clock, objection: the services that control time; returns why a command to a port or a call is refused (None: it is not).
        playback: returns what a status says about the recording that is played; None for a world that runs.
        recordings: recordings that clients begin and end; None if they cannot.
        stats: counts of each adapter, by name.
    """

    server: str
    simulation: TickProvider
    bus: Bus
    mailbox: Mailbox
    shutdown: Callable[[str], None]
    status: Callable[[], dict[str, Json]]
    files: StateFiles | None
    profiling: Profiling | None
    scenery: Scenery
    clock: Mapping[str, Service] = field(default_factory=CLOCK.copy)
    objection: Callable[[str], Fault | None] = lambda path: None
    playback: Callable[[], dict[str, Json]] | None = None
    recordings: Recordings | None = None
    stats: dict[str, AdapterStats] = field(default_factory=dict)
    _shown: dict[tuple[type, str], tuple[Port | Service, Json]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make the descriptions of all ports and services before the first tick: in a large world this takes longer than a tick may be
        delayed."""
        self.shown([*self.ports.values(), *self.services.values(), *LOOP_SERVICES, *self.clock.values()])

    def shown(self, entries: Sequence[Port | Service]) -> list[Json]:
        """Return ports or services as `describe` shows them. Each description is made once."""
        shown: list[Json] = []
        if len(self._shown) > 2 * (len(self.ports) + len(self.services) + len(LOOP_SERVICES) + len(self.clock)):
            self._shown.clear()  # descriptions of bodies that were removed
        for entry in entries:
            known = self._shown.get((type(entry), entry.path))
            if known is None or known[0] is not entry:
                known = self._shown[type(entry), entry.path] = (entry, msgspec.to_builtins(entry))
            shown.append(known[1])
        return shown

    def event(self, kind: Literal["conflict", "shutdown", "adapter_failed"], text: str) -> Event:
        """Return an event of the present tick."""
        return Event(kind, self.simulation.world.tick, self.simulation.world.t_ns, text)

    @property
    def ports(self) -> Mapping[str, Port]:
        """All ports, truth included, that fit the samples which the loop has got so far."""
        return self.simulation.world.ports if self.bus.ports is None else self.bus.ports

    @property
    def services(self) -> Mapping[str, Service]:
        """All services."""
        return self.simulation.world.services


class Context:
    """The `AdapterContext` of one adapter."""

    def __init__(self, hub: Hub, name: str, truth: bool) -> None:
        self.name = name
        self.stats = hub.stats.setdefault(name, AdapterStats())
        self._hub = hub
        self._truth = truth
        self._seen: Mapping[str, Port] | None = None
        self._ports: dict[str, Port] = {}
        self._seen_services: Mapping[str, Service] | None = None
        self._services: dict[str, Service] = {}

    @property
    def world(self) -> WorldFacts:
        """The world as it is now."""
        simulation = self._hub.simulation
        world = simulation.world
        return WorldFacts(
            server=self._hub.server,
            scenario=world.name,
            rate_hz=float(world.rate_hz),
            epoch_utc=world.epoch_utc,
            mode=simulation.timing.mode,
            speed=simulation.pace.speed,
            # Made of `members`, which is replaced as a whole; `vehicles` is changed in place by a tick.
            vehicles=tuple(VehicleFacts(name, member.vehicle.model) for name, member in world.members.items()),
        )

    @property
    def ports(self) -> Mapping[str, Port]:
        """The ports that this adapter may serve, by path."""
        if (everything := self._hub.ports) is not self._seen:
            self._seen = everything
            self._ports = {path: port for path, port in everything.items() if self._truth or not port.is_truth}
        return self._ports

    @property
    def services(self) -> Mapping[str, Service]:
        """All services by path, except those of ports that this adapter may not serve."""
        if (everything := self._hub.services) is not self._seen_services:
            self._seen_services = everything
            visible = {path: service for path, service in everything.items() if self._truth or "/truth/" not in path}
            self._services = {
                service.path: service for service in (*LOOP_SERVICES, *self._hub.clock.values())
            } | visible
        return self._services

    def hello(self) -> dict[str, Json]:
        """Return the common part of the answer to `hello`."""
        return {
            "version": PROTOCOL_VERSION,
            "server": f"{self._hub.server} {__version__}",
            "scenario": self._hub.simulation.world.name,
        }

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """Return the ports and services that match a pattern, as in docs/reference/protocol.md."""
        world = self._hub.simulation.world
        ports = [self.ports[path] for path in matching(pattern, self.ports)]
        services = [self.services[path] for path in matching(pattern, self.services)]
        return {
            "server": {"name": self._hub.server, "version": __version__, "protocol": PROTOCOL_VERSION},
            "world": {
                "scenario": world.name,
                "rate_hz": float(world.rate_hz),
                "epoch_utc": world.epoch_utc,
                "seed": world.seed,
                "vehicles": list(world.members),
            },
            "ports": self._hub.shown(ports),
            "services": self._hub.shown(services),
        }

    def last(self, port: str) -> Sample | None:
        """See `uwserver.adapter.AdapterContext.last`."""
        return self._hub.bus.last.get(port) if port in self.ports else None

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        """See `uwserver.adapter.AdapterContext.read`."""
        there = self.ports
        visible = [path for path in ports if path in there and there[path].direction == "sensor"]
        self._hub.simulation.readers.read(visible, on_samples, f"{self.name}:{source}")

    def request_scene_state(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        """See `uwserver.adapter.AdapterContext.request_scene_state`."""
        self._hub.simulation.readers.request_scene_state(on_state, f"{self.name}:{source}")

    def scene(self, entities: EntityList) -> SceneView:
        """See `uwserver.adapter.AdapterContext.scene`."""
        return self._hub.scenery.scene(entities)

    def mesh(self, sha256: str) -> bytes | None:
        """See `uwserver.adapter.AdapterContext.mesh`."""
        return self._hub.scenery.meshes.data.get(sha256)

    def model_file(self, sha256: str) -> bytes | None:
        """See `uwserver.adapter.AdapterContext.model_file`."""
        return self._hub.scenery.model_files.get(sha256)

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        """Begin to deliver samples and events to a subscriber. The returned function ends it."""
        return self._hub.bus.attach(subscriber if self._truth else WithoutTruth(subscriber, self))

    def subscriptions_changed(self) -> None:
        """Take over changed subscriptions."""
        self._hub.bus.subscriptions_changed()

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """See `uwserver.adapter.AdapterContext.command`."""
        ports = self.ports
        find("port", port, ports)
        fields, checked = ports[port].fields, checked_command(ports[port], value)
        self._object(port)
        command = Command(port, checked, f"{self.name}:{source}")
        self._hub.mailbox.post(command, on_reply, self._queue(source, queue), fields=fields)

    def _object(self, path: str) -> None:
        if (fault := self._hub.objection(path)) is not None:
            raise Refused(fault.code, fault.text, fault.where)

    def _queue(self, source: str, queue: str) -> str:
        return f"{self.name}:{queue or client_of(source)}"

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        source: str,
        on_reply: OnReply,
        client: str = "",
        queue: str = "",
    ) -> Callable[[], bool]:
        """See `uwserver.adapter.AdapterContext.call`."""
        services = self.services
        find("service", service, services)
        checked = checked_args(services[service], args)
        self._object(service)
        queue, source = self._queue(source, queue), f"{self.name}:{source}"
        if service in ("world/describe", "world/status", "world/shutdown"):
            self._answer(service, source, on_reply)
            return _too_late
        hub = self._hub
        if service in (SAVE.path, LOAD.path) and checked["name"] and hub.files is not None:
            hub.files.call(service, checked, source, on_reply)
            return _too_late
        if service == PROFILE.path and hub.profiling is not None:
            return hub.profiling.call(checked["seconds"], source, on_reply)  # type: ignore[arg-type]  # checked
        if service in RECORDING_SERVICES:
            if hub.recordings is None:
                raise Refused("denied", "nothing can be recorded here", service)
            hub.recordings.call(service, checked, source, on_reply)
            return _too_late
        if service in hub.clock:
            return hub.simulation.call(service, checked, client, on_reply, source)
        if services[service].long_running:
            return self._begin(Call(service, checked, source), on_reply, queue)
        if is_stop(service):
            self._stop(Call(service, checked, source), on_reply, queue)
        else:
            hub.mailbox.post(Call(service, checked, source), on_reply, queue)
        return _too_late

    def _stop(self, call: Call, on_reply: OnReply, queue: str) -> None:
        """Queue a call that stops something. In real time a tick carries out only a part of the waiting requests, so the stop overtakes the
        requests of its client. In other modes the next tick carries out all of them, and the client's order stays."""
        hub = self._hub
        if hub.simulation.timing.mode != "realtime":
            hub.mailbox.post(call, on_reply, queue, first=True)
            return
        world = hub.simulation.world
        fault = Fault("preempted", f"{call.service}, which was called later, has overtaken it", call.service)
        for older in hub.mailbox.stop(call, on_reply, queue):
            if older.on_reply is not None:
                hub.bus.reply(older.on_reply, Reply(world.tick, world.t_ns, fault=fault))

    def _begin(self, call: Call, on_reply: OnReply, queue: str) -> Callable[[], bool]:
        """Post a call that is answered much later. Its cancellation is a call of its own, so that a recording has it too."""
        over = asked = False

        def answered(answer: Reply | Progress) -> None:
            nonlocal over
            over = isinstance(answer, Reply)
            on_reply(answer)

        def cancel() -> bool:
            nonlocal asked
            if not over and not asked:
                asked = True
                path, _, name = call.service.rpartition("/")
                # Posted even if too many requests wait: a call whose peer has left would otherwise go on, and no client could end it.
                self._hub.mailbox.post(Call(f"{path}/cancel_{name}", {}, call.source), None, queue, always=True)
            return not over

        self._hub.mailbox.post(call, answered, queue)
        return cancel

    def _answer(self, service: str, source: str, on_reply: OnReply) -> None:
        world, result = self._hub.simulation.world, None
        if service == "world/describe":
            result = self.describe()
        elif service == "world/status":
            result = self._hub.status()
        on_reply(Reply(world.tick, world.t_ns, result))
        if service == "world/shutdown":
            self._hub.shutdown(f"world/shutdown by {source}")

    def tell_conflict(self, text: str) -> None:
        """See `uwserver.adapter.AdapterContext.tell_conflict`."""
        self._hub.bus.say(self._hub.event("conflict", f"{self.name}: {text}"))

    def join(self, client: str) -> Callable[[], None]:
        """Let a named client take part in lockstep. The returned function ends it."""
        barrier = self._hub.simulation.lockstep.barrier
        barrier.join(client)
        return lambda: barrier.leave(client)

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """See `uwserver.adapter.AdapterContext.drive`."""
        source = f"{self.name}:{client}"
        visible = driver if self._truth else DriverWithoutTruth(driver, self)
        forget = self._hub.bus.add_reader(visible)  # before its first tick
        try:
            leave = self._hub.simulation.lockstep.drive(client, source, visible, on_reply)
        except Refused:
            forget()
            raise

        def end() -> None:
            leave()
            forget()

        return end


def _too_late() -> bool:
    return False
