"""The vehicle, ports and fields that the table of an adapter names, and the newest good readings of such ports.

A name that does not exist is a `CannotServe` that lists what there is. `Readings` belong to one thread: the loop's, or that of a driver.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal

from uwserver.adapter.base import CannotServe
from uwserver.ports import Field, Port, Sample, Value


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


class Reading:
    """The newest values of some fields of a sensor.

    Attributes:
        path: path of the port.
        rate_hz: rate of the port.
        values: an entry for each field from the newest good sample; None before the first, and also after a bad sample if it does not keep values.
        t_ns: simulation time at which the values were true.
        count: number of good samples so far.
    """

    def __init__(self, port: Port, fields: Sequence[str], keeps: bool) -> None:
        names = [field.name for field in port.fields]
        self.path = port.path
        self.rate_hz = port.rate_hz or 0.0
        self.values: tuple[Value, ...] | None = None
        self.t_ns = 0
        self.count = 0
        self._indices = [names.index(name) for name in fields]
        self._keeps = keeps

    def take(self, sample: Sample) -> None:
        """Take in a newer sample."""
        picked = [sample.value[i] for i in self._indices]
        if sample.valid and all(map(_is_finite, picked)):
            self.values, self.t_ns = tuple(picked), sample.t_ns
            self.count += 1
        elif not self._keeps:
            self.values = None


def _is_finite(value: Value) -> bool:
    try:
        # A sum is not finite if one of its terms is not. Terms so large that their sum overflows are no readings either.
        return math.isfinite(sum(value) if isinstance(value, tuple) else value)  # type: ignore[arg-type]  # None: see below
    except TypeError:
        # A value, or a component, is None.
        return False


class Readings:
    """The readings of all ports that were asked for.

    Args:
        ports: ports of the context.
        vehicle: vehicle below which names are looked up.
    """

    def __init__(self, ports: Mapping[str, Port], vehicle: str) -> None:
        self._ports = ports
        self._vehicle = vehicle
        self._subscriptions: dict[str, list[Reading]] = {}

    @property
    def subscriptions(self) -> Collection[str]:
        """The paths of these ports."""
        return self._subscriptions.keys()

    def subscribe(self, role: str, name: str, choices: Sequence[Sequence[str]], keeps: bool = True) -> Reading:
        """Follow a port, and return its reading.

        Args:
            role: key of the adapter's table, for errors.
            name: name of the port below the vehicle, or its whole path.
            choices: sets of fields. The first set of which the port has all fields is read.
            keeps: keep the last good values when a bad sample comes.

        Raises:
            CannotServe: there is no such sensor, or it has none of the sets of fields.
        """
        port = port_of(role, name, self._ports, self._vehicle, "sensor")
        has = {field.name for field in port.fields}
        fields = next((fields for fields in choices if has.issuperset(fields)), None)
        if fields is None:
            needs = " or ".join(" and ".join(fields) for fields in choices)
            raise CannotServe(f'{role}: "{port.path}" has the fields {", ".join(sorted(has))}; needed is {needs}')
        reading = Reading(port, fields, keeps)
        self._subscriptions.setdefault(port.path, []).append(reading)
        return reading

    def see(self, samples: Iterable[Sample]) -> None:
        """Take in the samples of a tick."""
        subscriptions = self._subscriptions
        for sample in samples:
            for reading in subscriptions.get(sample.port, ()):
                reading.take(sample)
