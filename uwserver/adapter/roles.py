"""Finds the vehicle, port and field that the table of an adapter names. Each fault is a `CannotServe` that lists what there is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from uwserver.adapter.refusals import CannotServe
from uwserver.ports import Field, Port


def vehicles_of(ports: Mapping[str, Port]) -> list[str]:
    """Return the names of all vehicles with a port, in alphabetical order."""
    return sorted({path.split("/")[0] for path in ports})


def vehicle_of(name: str | None, ports: Mapping[str, Port]) -> str:
    """Return the vehicle of this name, or the only vehicle if no name is given.

    Raises:
        CannotServe: there is no such vehicle, or no name is given and there is not exactly one vehicle.
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
    """Return the port that a key of the adapter's table names.

    Args:
        role: the key, for errors.
        name: name of the port below the vehicle (``imu``), or a whole path.
        ports: ports of the context.
        vehicle: name of the vehicle.
        direction: whether the port must be a sensor or an actuator.

    Raises:
        CannotServe: there is no such sensor or actuator.
    """
    path = name if name in ports else f"{vehicle}/{name}"
    port = ports.get(path)
    if port is None or port.direction != direction:
        there = sorted(path for path, port in ports.items() if port.direction == direction)
        hint = "; set truth = true for this adapter, or name a sensor" if "/truth/" in path else ""
        raise CannotServe(f'{role}: no {direction} "{path}"{hint}; there are: {", ".join(there) or "none"}')
    return port


def field_of(role: str, port: Port, name: str) -> Field:
    """Return a field of a port by its name.

    Raises:
        CannotServe: the port has no such field.
    """
    fields = {field.name: field for field in port.fields}
    if name not in fields:
        raise CannotServe(f'{role}: "{port.path}" has no field "{name}", it has: {", ".join(fields)}')
    return fields[name]


def port_of_kind(kind: str, ports: Mapping[str, Port], vehicle: str) -> Port | None:
    """Return the first port of a vehicle that has this kind (``teleport``, ``gps``) and is no ground truth, or None."""
    own = (port for path, port in ports.items() if path.startswith(f"{vehicle}/") and not port.is_truth)
    return next((port for port in own if port.kind == kind), None)
