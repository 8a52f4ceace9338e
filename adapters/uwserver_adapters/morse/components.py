"""The components of MORSE that ports and services stand for, and their description for clients."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping
from typing import Literal, NamedTuple

from uwserver.adapter import CannotServe, did_you_mean
from uwserver.ports import Json, Port, Service

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
