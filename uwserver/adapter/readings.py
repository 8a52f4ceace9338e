"""The newest good readings of the ports that an adapter's table names. All of it belongs to one thread: the loop's, or that of a driver."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

from uwserver.adapter.refusals import CannotServe
from uwserver.adapter.roles import port_of
from uwserver.ports import Port, Sample, Value


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
        self._wanted: dict[str, list[Reading]] = {}

    @property
    def wanted(self) -> Collection[str]:
        """The paths of these ports."""
        return self._wanted.keys()

    def want(self, role: str, name: str, choices: Sequence[Sequence[str]], keeps: bool = True) -> Reading:
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
        self._wanted.setdefault(port.path, []).append(reading)
        return reading

    def see(self, samples: Iterable[Sample]) -> None:
        """Take in the samples of a tick."""
        wanted = self._wanted
        for sample in samples:
            for reading in wanted.get(sample.port, ()):
                reading.take(sample)
