"""Which vehicle, port and field the table of an adapter means. Each fault is a `CannotServe` that lists what there is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from uwserver.adapter.refusals import CannotServe
from uwserver.ports import Field, Port


def vehicles_of(ports: Mapping[str, Port]) -> list[str]:
    """Names of all vehicles with a port, in alphabetical order."""
    return sorted({path.split("/")[0] for path in ports})


def vehicle_of(name: str | None, ports: Mapping[str, Port]) -> str:
    """The vehicle of this name, or the only one there is.

    Raises:
        CannotServe: there is no such vehicle, or none is named and there is not exactly one.
    """
    names = vehicles_of(ports)
    there = ", ".join(names) or "none"
    if name is not None and name not in names:
        raise CannotServe(f'no vehicle "{name}"; there are: {there}')
    if name is None and len(names) != 1:
        raise CannotServe(f"say which vehicle this is: vehicle = one of {there}")
    return name or names[0]


def port_of(
    role: str, name: str, ports: Mapping[str, Port], vehicle: str, direction: Literal["sensor", "actuator"]
) -> Port:
    """The port that a key of the adapter's table names.

    Args:
        role: the key, for errors.
        name: below the vehicle (``imu``), or a whole path.
        ports: those of the context.
        vehicle: that is meant.
        direction: what it must be.

    Raises:
        CannotServe: there is no such sensor (actuator).
    """
    path = name if name in ports else f"{vehicle}/{name}"
    port = ports.get(path)
    if port is None or port.direction != direction:
        there = sorted(path for path, port in ports.items() if port.direction == direction)
        hint = "; set truth = true for this adapter, or name a sensor" if "/truth/" in path else ""
        raise CannotServe(f'{role}: no {direction} "{path}"{hint}; there are: {", ".join(there) or "none"}')
    return port


def field_of(role: str, port: Port, name: str) -> Field:
    """A field of a port, by its name.

    Raises:
        CannotServe: it has no such field.
    """
    for field in port.fields:
        if field.name == name:
            return field
    names = ", ".join(field.name for field in port.fields)
    raise CannotServe(f'{role}: "{port.path}" has no field "{name}", it has: {names}')


def port_of_kind(kind: str, ports: Mapping[str, Port], vehicle: str) -> Port | None:
    """The vehicle's first port of a kind (``teleport``, ``gps``); ground truth is none."""
    for path, port in ports.items():
        if port.kind == kind and path.startswith(f"{vehicle}/") and not port.is_truth:
            return port
    return None
