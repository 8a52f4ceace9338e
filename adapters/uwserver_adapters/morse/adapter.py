"""The `morse` adapter: MORSE's own socket protocol, for pymorse, scripts of old, and ArduPilot's MORSE backend."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

import msgspec

from uwserver.adapter import (
    AdapterContext,
    CannotListen,
    Conversation,
    Listener,
    Peers,
    Refusals,
    address_text,
    is_loopback,
    serve_tcp,
    serving,
)
from uwserver.ports import Event, Json, Refused, Reply, Sample
from uwserver_adapters.morse import codec
from uwserver_adapters.morse.autopilot import Autopilot
from uwserver_adapters.morse.components import GOTO, Component, check_names, components, details, places
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.morse.connections import Requests, Stream

TRIES = 64
"""Ports that are tried for a stream when those before are in use."""
WATCH_S = 0.2
"""Wall time between two looks whether there are new components, which need streams."""


class MorseAdapter:
    """Serves requests on one port, and a stream for each component.

    Attributes:
        components: all of them, by name.
    """

    Config = MorseConfig

    def __init__(self, config: MorseConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.components: Mapping[str, Component] = components(context.ports, context.services, config.component_of)
        refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self._peers: Peers[Requests | Stream] = Peers(config.max_clients, refusals, context.stats)
        self._streams: dict[str, Listener] = {}
        self._open: dict[str, set[Stream]] = {}
        self._pose: dict[str, Sample] = {}
        self._autopilot: Autopilot | None = None
        self._count = 0
        self._places: dict[str, dict[str, str]] | None = None
        self._details: Json = None
        self._next_port = config.stream_port

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there; or the address is not loopback, and the table does not allow it.
            CannotServe: the table names what is not there.
        """
        config, context = self.config, self.context
        if not (is_loopback(config.bind) or config.allow_network):
            text = f"MORSE's protocol knows no token: whoever reaches {config.bind} could read and command all"
            raise CannotListen(f"{text}. Say allow_network = true if that is wanted")
        check_names(config.component_of, context.ports)
        async with contextlib.AsyncExitStack() as stack:
            server = await stack.enter_async_context(
                serve_tcp(self._requests, self._peers, config.bind, config.port, rival="MORSE")
            )
            await self._listen(stack)
            if config.ardupilot is not None:
                self._autopilot = Autopilot(config.ardupilot, config, context)
                await stack.enter_async_context(self._autopilot.serving())
            with serving(context, self, address_text(config.bind, server.port), ready):
                while True:
                    await asyncio.sleep(WATCH_S)
                    await self._listen(stack)

    @property
    def places(self) -> dict[str, dict[str, str]]:
        """See `Stage`: worked out once, as `details` are."""
        if self._places is None:
            names = [each.name for each in self.context.world.vehicles]
            self._places = places(self.components, self.context.services, names)
        return self._places

    @property
    def details(self) -> Json:
        """See `Stage`: worked out once, as in a swarm it takes a while."""
        if self._details is None:
            world = self.context.world
            names = [each.name for each in world.vehicles]
            self._details = details(self.components, self.places, names, world.scenario)
        return self._details

    # -- streams --------------------------------------------------------------------------------------------------------------------------

    async def _listen(self, stack: contextlib.AsyncExitStack) -> None:
        """A stream for each component that has none yet. Those of vehicles that were removed stay, so that no number changes its meaning."""
        for component in list(self.components.values()):
            if component.name not in self._streams:
                self._streams[component.name] = await self._listener(stack, component.name)
        self.context.stats.details["streams"] = {name: each.port for name, each in self._streams.items()}

    async def _listener(self, stack: contextlib.AsyncExitStack, name: str) -> Listener:
        make = partial(self._stream, name)
        for attempt in range(TRIES):
            port = self._next_port
            if port:
                self._next_port += 1
            try:
                return await stack.enter_async_context(
                    serve_tcp(make, self._peers, self.config.bind, port, key="stream_port", rival="MORSE")
                )
            except CannotListen:
                if attempt == TRIES - 1:
                    raise
        raise AssertionError("unreachable")

    def stream_port(self, name: str) -> int | None:
        """See `Stage`."""
        listener = self._streams.get(name) if name in self.components else None
        return None if listener is None else listener.port

    def companions(self, component: Component) -> list[str]:
        """See `Stage`."""
        own = [component.path] if component.direction == "OUT" else []
        if component.kind == "truth_velocity":
            own.append(self._pose_path(component))
        return own

    def _pose_path(self, component: Component) -> str:
        return f"{component.path.rpartition('/')[0]}/pose"

    def data(self, component: Component, samples: Sequence[Sample]) -> dict[str, object] | None:
        """See `Stage`."""
        by_port = {sample.port: sample for sample in samples}
        own = by_port.get(component.path)
        return None if own is None else self._said(component, own, by_port.get(self._pose_path(component)))

    def _said(self, component: Component, own: Sample, pose: Sample | None) -> dict[str, object]:
        assert component.port is not None
        attitude = pose.value[1] if pose is not None and pose.valid else None
        stamp = codec.timestamp(self.context.world.epoch_ns, own.t_ns)
        said = codec.reading(component.port, own.value, attitude if isinstance(attitude, tuple) else None)  # type: ignore[arg-type]
        return {"timestamp": stamp, "valid": own.valid} | said

    # -- uwserver.adapter.Subscriber ------------------------------------------------------------------------------------------------------

    @property
    def wanted(self) -> Collection[str]:
        """Ports at whose stream somebody listens."""
        heard = {
            path for name in self._open if name in self.components for path in self.companions(self.components[name])
        }
        return heard | set(self._autopilot.wanted if self._autopilot is not None else ())

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Tell the streams."""
        by_port = {sample.port: sample for sample in samples}
        for name, streams in self._open.items():
            component = self.components.get(name)
            if component is None or component.direction == "IN":
                continue
            if component.kind == "truth_velocity":
                path = self._pose_path(component)
                self._pose[path] = by_port.get(path) or self._pose.get(path)  # type: ignore[assignment]  # None before the first
            own = by_port.get(component.path)
            if own is None:
                continue
            said = self._said(component, own, self._pose.get(self._pose_path(component)))
            line = msgspec.json.encode(said) + b"\n"
            self.context.stats.encoded += 1
            for stream in list(streams):
                stream.tell(line)
        if self._autopilot is not None:
            self._autopilot.put_samples(samples)

    def put_event(self, event: Event) -> None:
        """Vehicles that came have components; those that went have none."""
        if event.event in ("ports_changed", "reset"):
            self._pose.clear()
            self._places = self._details = None
            self.components = components(self.context.ports, self.context.services, self.config.component_of)
            self.context.follow_wants()

    # -- for the connections --------------------------------------------------------------------------------------------------------------

    def _requests(self) -> Requests:
        return Requests(self, self.config, self._peers, self._name("client"))

    def _stream(self, name: str) -> Stream:
        component = self.components.get(name)
        if component is None:  # its vehicle was removed
            component = Component(name, "gone", None, "port", (), "")
        return Stream(
            self, component, self.config, self._peers, self._name(name), self._enter, self._leave, self._carry_out
        )

    def _name(self, of: str) -> str:
        self._count += 1
        return f"{of}#{self._count}"

    def _enter(self, stream: Stream) -> None:
        self._open.setdefault(stream.component.name, set()).add(stream)
        self.context.follow_wants()

    def _leave(self, stream: Stream) -> None:
        name = stream.component.name
        self._open[name].discard(stream)
        if not self._open[name]:
            del self._open[name]
        self.context.follow_wants()

    def _carry_out(
        self, peer: Conversation, component: Component, said: dict[str, object], answered: Callable[[Reply], None]
    ) -> None:
        """What a stream commands."""
        if component.name not in self.components:
            raise Refused("unknown_port", f"{component.name} is gone")
        if component.role == "motion":
            peer.command(component.path, codec.motion(said), answered)
        elif component.role == "waypoint":
            self._go(peer, component, said, answered)
        else:
            assert component.port is not None
            peer.command(component.path, codec.command(component.port, said), answered)

    def _go(
        self, peer: Conversation, component: Component, said: dict[str, object], answered: Callable[[Reply], None]
    ) -> None:
        unknown = set(said) - {"x", "y", "z", "tolerance", "speed", "timestamp"}
        if unknown or not {"x", "y", "z"} <= set(said):
            raise Refused("bad_argument", "write {x, y, z}, and perhaps tolerance and speed: m east, north, up")
        x, y, z = (codec.number(said, key) for key in ("x", "y", "z"))
        args: dict[str, object] = {"position_ned_m": codec.place(x, y, z)}
        args |= {
            ours: said[theirs] for theirs, ours in (("tolerance", "radius_m"), ("speed", "speed_mps")) if theirs in said
        }
        peer.call(f"{component.robot}/{GOTO}", args, answered)
