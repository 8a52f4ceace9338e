"""Samples of sensors, recorded as arrays while a world is stepped: one table for each port."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Port, Refused, Sample, matches
from uwserver.ports.sample_batch import Samples
from uwserver.units import NANOSECONDS
from uwserver.world.reading import as_array


class Trace:
    """All samples of one port, in their order: ``trace.t``, and ``trace.depth`` or ``trace["depth"]`` of shape (n, *shape of the field).

    Attributes:
        port: the port.
        samples: as they were delivered.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.samples: list[Sample] = []

    @property
    def t(self) -> FloatArray:
        """(n) simulation times of the measurements, s."""
        return np.array([sample.t_ns for sample in self.samples], dtype=float) / NANOSECONDS

    @property
    def valid(self) -> NDArray[Any]:
        """(n) whether the sensor could measure."""
        return np.array([sample.valid for sample in self.samples], dtype=bool)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return arrays (n) by name, as ``pandas.DataFrame`` takes them: `t`, `valid`, and each number of each field: `depth`, `p_NS_0`,
        `p_NS_1`, `p_NS_2`.

        Buffers are left out, as each of them is a table itself.
        """
        columns = {"t": self.t, "valid": self.valid}
        for field in self.port.fields:
            if field.is_packed:
                continue
            values = self[field.name].reshape(len(self.samples), field.size)
            names = [field.name] if not field.shape else [f"{field.name}_{k}" for k in range(field.size)]
            columns |= {name: values[:, k] for k, name in enumerate(names)}
        return columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return all values of a field; KeyError if the port has no such field."""
        for k, field in enumerate(self.port.fields):
            if field.name == name:
                values = [as_array(field, sample.value[k]) for sample in self.samples]
                if len({value.shape for value in values}) > 1:  # pictures of different sizes
                    whole = np.empty(len(values), dtype=object)
                    whole[:] = values
                    return whole
                return np.stack(values) if values else np.empty((0, *field.shape))
        fields = ", ".join(field.name for field in self.port.fields)
        raise KeyError(f'{self.port.path} has no field "{name}"; there are: {fields}')

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        fields = ", ".join(field.name for field in self.port.fields)
        return f"<{self.port.path}: {len(self)} samples of {fields}>"


class Traces(Mapping[str, Trace]):
    """Traces by the path of their port. They grow with each step until `stop`, or until the end of a ``with`` block."""

    def __init__(self, ports: Iterable[Port], growing: list[Traces]) -> None:
        """Record these ports; `growing` has all traces that still grow, and takes this one in."""
        self._traces = {port.path: Trace(port) for port in ports}
        self._growing = growing
        growing.append(self)

    def take(self, samples: Samples) -> None:
        """Keep the samples of the recorded ports."""
        for sample in samples.of(self._traces):
            self._traces[sample.port].samples.append(sample)

    def stop(self) -> None:
        """Take no more samples, and keep those that there are."""
        if self in self._growing:
            self._growing.remove(self)

    def __enter__(self) -> Traces:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __getitem__(self, path: str) -> Trace:
        if path not in self._traces:
            raise KeyError(f'"{path}" is not recorded; there are: {", ".join(self._traces)}')
        return self._traces[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._traces)

    def __len__(self) -> int:
        return len(self._traces)

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return "\n".join(map(repr, self._traces.values()))


def chosen(ports: Mapping[str, Port], patterns: Sequence[str]) -> list[Port]:
    """Return the sensor ports that match one of the patterns; all of them if there is no pattern.

    Raises:
        Refused: no sensor matches.
    """
    wanted = patterns or ("**",)
    sensors = [port for port in ports.values() if port.direction == "sensor"]
    found = [port for port in sensors if any(matches(pattern, port.path) for pattern in wanted)]
    if not found:
        there = ", ".join(port.path for port in sensors) or "none"
        raise Refused("unknown_port", f"no sensor matches {', '.join(wanted)}; there are: {there}", "patterns")
    return found
