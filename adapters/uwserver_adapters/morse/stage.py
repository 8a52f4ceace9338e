"""The components of MORSE that ports and services stand for, and their description for clients.

All clients of the adapter share them, with their streams: samples out, commands in.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Literal, NamedTuple

import msgspec

from uwserver.adapter import AdapterContext, CannotServe, Conversation, did_you_mean
from uwserver.ports import Json, Port, Refused, Reply, Sample, Service
from uwserver_adapters.morse import codec

CLASS = "uwserver.adapters.morse"
"""Stands where MORSE names the class of a data stream."""

VELOCITY = "autopilot/velocity"
GOTO = "autopilot/goto"

Role = Literal["port", "motion", "waypoint"]


class Component(NamedTuple):
    """A component: something that clients see under one name.

    Attributes:
        name: such as ``heavy.imu``.
        kind: kind of its port, or MORSE's word for the component.
        port: the port behind it; None for a `waypoint`.
        role: "port" for a whole port, or MORSE's "motion" (the autopilot's velocity) or "waypoint" (the autopilot's goto).
        services: names of its services.
        path: path of the port or service behind it.
    """

    name: str
    kind: str
    port: Port | None
    role: Role
    services: tuple[str, ...]
    path: str

    @property
    def message(self) -> str:
        """The standard message that the fields of its port fit; "" for none."""
        return "" if self.port is None else self.port.message or ""

    @property
    def robot(self) -> str:
        """Name of the vehicle."""
        return self.name.partition(".")[0]

    @property
    def direction(self) -> Literal["IN", "OUT"]:
        """Direction of its stream, seen from the simulator."""
        return "OUT" if self.port is not None and self.port.direction == "sensor" else "IN"

    @property
    def pose_path(self) -> str:
        """Path of the vehicle's pose, for a component of its ground truth."""
        return f"{self.path.rpartition('/')[0]}/pose"


def components(
    ports: Mapping[str, Port], services: Mapping[str, Service], names: Mapping[str, str] | None = None
) -> dict[str, Component]:
    """Return all components by name, in alphabetical order.

    Args:
        ports, services: those of the context.
        names: path of a port -> name of its component, where the usual name is not wanted.

    Raises:
        CannotServe: such a name is not possible, or two ports share one.
    """
    names = names or {}
    found: dict[str, Component] = {}
    for path in sorted(ports, key=lambda path: (path not in names, "/truth/" in path, path)):
        name = _named(path, names[path], found) if path in names else _usual(path, found)
        port = ports[path]
        own = ("get_local_data",) if port.direction == "sensor" else ()
        more = ("get_properties", "set_property", "get_configurations") if f"{path}/get" in services else ()
        found[name] = Component(name, port.kind, port, "port", own + more, path)
    for component in _of_autopilots(ports, services):
        found.setdefault(component.name, component)
    return dict(sorted(found.items()))


def check_names(names: Mapping[str, str], ports: Mapping[str, Port]) -> None:
    """Check that the ports that the table names are there.

    Raises:
        CannotServe: one is not; the text says which port may be meant.
    """
    for path in names:
        if path not in ports:
            hint = "; ground truth needs truth = true" if "/truth/" in path else did_you_mean(path, ports)
            raise CannotServe(f'names: no port "{path}"{hint}')


def _usual(path: str, taken: Collection[str]) -> str:
    """Return the usual name of a port: heavy.imu for ``heavy/imu``. Ground truth has MORSE's names (heavy.pose): there it is a sensor like others."""
    vehicle, _, rest = path.partition("/")
    whole = rest.replace("/", "_")
    choices = itertools.chain(
        [rest.removeprefix("truth/").replace("/", "_"), whole], (f"{whole}_{n}" for n in itertools.count(2))
    )
    return next(name for choice in choices if (name := f"{vehicle}.{choice}") not in taken)


def _named(path: str, name: str, taken: Iterable[str]) -> str:
    """Return the name that the table gives a port, if it is possible."""
    vehicle = path.partition("/")[0]
    rest = name.removeprefix(f"{vehicle}.")
    if rest == name or not rest.isidentifier():
        raise CannotServe(f'names: "{name}" of {path} is {vehicle}. and one word of letters, digits and _')
    if name in taken:
        raise CannotServe(f'names: two ports are called "{name}"')
    return name


def _of_autopilots(ports: Mapping[str, Port], services: Mapping[str, Service]) -> Iterable[Component]:
    for path in (*ports, *services):
        vehicle, _, rest = path.partition("/")
        if rest == VELOCITY and path in ports:
            yield Component(f"{vehicle}.motion", "motion", ports[path], "motion", (), path)
        elif rest == GOTO:
            yield Component(f"{vehicle}.waypoint", "waypoint", None, "waypoint", ("goto", "stop"), path)


def places(
    found: Mapping[str, Component], services: Mapping[str, Service], vehicles: Iterable[str]
) -> dict[str, dict[str, str]]:
    """Return the services that belong to no port, by name -> path, for each vehicle and each other first level (``world``, ``playback``).

    A service with more levels (`autopilot/arm`) has an underscore in its name (`autopilot_arm`).
    """
    ports = {component.path for component in found.values() if component.role == "port"}
    there: dict[str, dict[str, str]] = {vehicle: {} for vehicle in vehicles}
    for path in services:
        if path.rpartition("/")[0] not in ports:
            place, _, rest = path.partition("/")
            there.setdefault(place, {})[rest.replace("/", "_")] = path
    return there


def details(
    found: Mapping[str, Component], there: Mapping[str, Mapping[str, str]], vehicles: Iterable[str], scene: str
) -> Json:
    """Return the answer of ``simulation details``; `there` are the `places`."""
    told: dict[str, dict[str, Json]] = {vehicle: {} for vehicle in vehicles}
    for component in found.values():
        told.setdefault(component.robot, {})[component.name] = {
            "type": component.kind,
            "services": list(component.services),
            "service_interfaces": [],
            "stream_interfaces": [[CLASS, component.direction]],
        }
    robots: list[Json] = [
        {"name": vehicle, "type": "uwserver", "services": list(there.get(vehicle, ())), "components": parts}
        for vehicle, parts in told.items()
    ]
    return {"robots": robots, "environment": scene}


Tell = Callable[[bytes], None]
"""Sends a line to a client of a stream."""


class Stage:
    """The components of the world as they are now.

    Args:
        context: the world.
        names: path of a port -> name of its component, where the usual name is not wanted.

    Attributes:
        context: as given.
        components: all components, by name.
        stream_ports: name of a component -> TCP port of its stream. Those of removed vehicles stay, so that no number changes its meaning.
    """

    def __init__(self, context: AdapterContext, names: Mapping[str, str]) -> None:
        self.context = context
        self.stream_ports: dict[str, int] = {}
        self._names = names
        self._hearers: dict[str, list[Tell]] = {}
        self.refresh()

    def refresh(self) -> None:
        """Find all components again: vehicles came or went, or the time of the world was set back."""
        self.components = components(self.context.ports, self.context.services, self._names)
        self._poses: dict[str, Sample] = {}
        for name in ("places", "details"):
            vars(self).pop(name, None)  # the cached properties

    @cached_property
    def places(self) -> dict[str, dict[str, str]]:
        """Services that belong to no component, by name -> path, for each vehicle, and for ``world`` and the like."""
        return places(self.components, self.context.services, [each.name for each in self.context.world.vehicles])

    @cached_property
    def details(self) -> Json:
        """The answer of ``simulation details``. In a swarm it takes a while to make it, so it is kept."""
        world = self.context.world
        return details(self.components, self.places, [each.name for each in world.vehicles], world.scenario)

    # -- what streams say -----------------------------------------------------------------------------------------------------------------

    def enter(self, name: str, tell: Tell) -> None:
        """A client listens to the stream of a component."""
        self._hearers.setdefault(name, []).append(tell)
        self.context.subscriptions_changed()

    def leave(self, name: str, tell: Tell) -> None:
        """A client that listened has gone."""
        self._hearers[name].remove(tell)
        if not self._hearers[name]:
            del self._hearers[name]
        self.context.subscriptions_changed()

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports to whose streams clients listen."""
        heard = [self.components[name] for name in self._hearers if name in self.components]
        return {path for component in heard for path in self.sources(component)}

    def sources(self, component: Component) -> list[str]:
        """Return the paths of the ports that a component's data need: its own, and for a velocity in the world's axes the vehicle's pose."""
        own = [component.path] if component.direction == "OUT" else []
        return [*own, component.pose_path] if component.message == codec.TRUE_VELOCITY else own

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send samples of a tick to the clients that listen."""
        by_port = {sample.port: sample for sample in samples}
        # The pose may come in another tick than the velocity.
        self._poses |= {path: sample for path, sample in by_port.items() if path.endswith("/pose")}
        for name, hearers in self._hearers.items():
            component = self.components.get(name)
            own = None if component is None or component.direction == "IN" else by_port.get(component.path)
            if component is None or own is None:
                continue
            line = msgspec.json.encode(self.data(component, own, self._poses.get(component.pose_path))) + b"\n"
            self.context.stats.encoded += 1
            for tell in list(hearers):
                tell(line)

    def data(self, component: Component, own: Sample, pose: Sample | None) -> dict[str, object]:
        """Return what the stream of a component says of a sample.

        Args:
            component: the component.
            own: sample of its port.
            pose: newest sample of the vehicle's pose; None where it is not known.
        """
        assert component.port is not None
        attitude = pose.value[1] if pose is not None and pose.valid else None
        stamp = codec.timestamp(self.context.world.epoch_ns, own.t_ns)
        said = codec.reading(component.port, own.value, attitude if isinstance(attitude, tuple) else None)  # type: ignore[arg-type]
        return {"timestamp": stamp, "valid": own.valid} | said

    # -- what streams command -------------------------------------------------------------------------------------------------------------

    def carry_out(
        self, peer: Conversation, component: Component, said: dict[str, object], answered: Callable[[Reply], None]
    ) -> None:
        """Carry out a command of a stream.

        Raises:
            Refused: the component is gone, or does not take it.
        """
        if component.name not in self.components:
            raise Refused("unknown_port", f"{component.name} is gone")
        if component.role == "motion":
            peer.command(component.path, codec.motion(said), answered)
        elif component.role == "waypoint":
            peer.call(f"{component.robot}/{GOTO}", _goto(said), answered)
        else:
            assert component.port is not None
            peer.command(component.path, codec.command(component.port, said), answered)


def _goto(said: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments of the autopilot's goto for what MORSE's `waypoint` takes."""
    unknown = set(said) - {"x", "y", "z", "tolerance", "speed", "timestamp"}
    if unknown or not {"x", "y", "z"} <= set(said):
        raise Refused("bad_argument", "write {x, y, z}, and perhaps tolerance and speed: m east, north, up")
    x, y, z = (codec.number(said, key) for key in ("x", "y", "z"))
    more = {
        ours: said[theirs] for theirs, ours in (("tolerance", "radius_m"), ("speed", "speed_mps")) if theirs in said
    }
    return {"position_ned_m": codec.place(x, y, z), **more}
