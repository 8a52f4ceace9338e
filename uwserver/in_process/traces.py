"""The samples of sensors as arrays, which grow while a world is stepped."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Port, Refused, Sample, matches
from uwserver.ports.sample_batch import Samples
from uwserver.units import NANOSECONDS
from uwserver.world.sensing.reading import as_array

if TYPE_CHECKING:
    import pandas


class _Column:
    """One value of each sample, as an array that grows: each value is converted once, when the array is read for the first time after it."""

    def __init__(self, convert: Callable[[Sequence[Sample]], NDArray[Any]]) -> None:
        """Begin without samples. `convert` makes one entry for each sample of a sequence, which may be empty."""
        self._convert = convert
        self._store = convert(())
        self._count = 0

    def of(self, samples: Sequence[Sample]) -> NDArray[Any]:
        """Return the array for all samples, of which those of the last call are the first ones. It cannot be written to."""
        if len(samples) > self._count:
            self._append(self._convert(samples[self._count :]))
        view = self._store[: self._count]
        view.flags.writeable = False
        return view

    def _append(self, new: NDArray[Any]) -> None:
        count = self._count + len(new)
        if new.shape[1:] != self._store.shape[1:] or new.dtype != self._store.dtype:
            if self._count:  # pictures of different sizes
                new, self._store = _loose(new), _loose(self._store)
            else:
                self._store = new[:0]
        if count > len(self._store):
            store = np.empty((max(count, 2 * self._count), *self._store.shape[1:]), self._store.dtype)
            store[: self._count] = self._store[: self._count]
            self._store = store
        self._store[self._count : count] = new
        self._count = count


def _loose(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array (n) of objects, one for each entry."""
    if values.dtype == object and values.ndim == 1:
        return values
    loose = np.empty(len(values), dtype=object)
    for k, value in enumerate(values):
        loose[k] = value
    return loose


class Trace:
    """All samples of one port, in their order: ``trace.t``, and ``trace.depth`` or ``trace["depth"]`` of shape (n, *shape of the field).

    Numbers are floats, NaN where the sensor gave none. The arrays cannot be written to: copy one to change it. They are made when they are
    first read, kept until there are new samples, and then only these are added.

    When the time of the world is set (`reset`, `load`, ``world/restore``), the trace is cleared, so that times never run back.

    Attributes:
        port: the port.
        samples: as they were delivered.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.samples: list[Sample] = []
        self._grows = True
        self._columns: dict[str, _Column] = {}

    @property
    def t(self) -> FloatArray:
        """(n) simulation times of the measurements, s."""
        return self._column("", lambda new: np.array([sample.t_ns for sample in new], dtype=float) / NANOSECONDS)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n) whether the sensor could measure."""
        return self._column(" ", lambda new: np.array([sample.valid for sample in new], dtype=bool))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return arrays (n) by name: `t`, `valid`, and each number of each field: ``depth``, ``f_S_x``, ``q_NS_w``, ``beam_ranges_0``.

        The axes of vectors are those of the field's frame, quaternions are w x y z, and everything else is numbered from 0. Buffers, such
        as pictures, are left out, as each of them is a table itself.
        """
        columns: dict[str, NDArray[Any]] = {"t": self.t, "valid": self.valid}
        for field in self.port.fields:
            if not field.is_packed:
                values = self[field.name].reshape(len(self.samples), field.size)
                columns |= zip(field.components, values.T, strict=True)
        return columns

    def to_frame(self) -> pandas.DataFrame:
        """Return the `columns` as a pandas.DataFrame, a row for each sample. The time `t`, s, is a column: ``frame.plot("t", "depth")``.

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            text = (
                "to_frame() needs pandas: pip install pandas. columns() gives the same as a dict of arrays, without it"
            )
            raise ImportError(text) from None
        return pandas.DataFrame(self.columns())

    def clear(self) -> None:
        """Drop all samples, and go on with new ones. Arrays that were read before stay as they are."""
        self.samples = []
        self._columns = {}

    def stop(self) -> None:
        """Take no more samples, and keep those that there are."""
        self._grows = False

    def take(self, sample: Sample) -> None:
        """Add a sample, unless the trace was stopped."""
        if self._grows:
            self.samples.append(sample)

    def begin_anew(self) -> None:
        """Clear the trace, as the time was set, unless it was stopped."""
        if self._grows:
            self.clear()

    def _column(self, key: str, convert: Callable[[Sequence[Sample]], NDArray[Any]]) -> NDArray[Any]:
        column = self._columns.get(key)
        if column is None:
            column = self._columns[key] = _Column(convert)
        return column.of(self.samples)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return all values of a field; KeyError if the port has no such field."""
        for k, field in enumerate(self.port.fields):
            if field.name == name:
                return self._column(name, _converter(field, k))
        fields = ", ".join(field.name for field in self.port.fields)
        raise KeyError(f'{self.port.path} has no field "{name}"; there are: {fields}')

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(field.name for field in self.port.fields)]

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        fields = ", ".join(field.name for field in self.port.fields)
        return f"<{self.port.path}: {len(self)} samples of {fields}>"


def _converter(field: Field, k: int) -> Callable[[Sequence[Sample]], NDArray[Any]]:
    """Return the function that gives value k of samples, which is of this field, as an array (n, *shape of the field)."""

    def convert(samples: Sequence[Sample]) -> NDArray[Any]:
        values = [as_array(field, sample.value[k]) for sample in samples]
        if not values:
            return np.empty((0, *field.shape), dtype=object if field.is_packed or field.type == "str" else float)
        if len({value.shape for value in values}) == 1:
            return np.stack(values)
        whole = np.empty(len(values), dtype=object)
        whole[:] = values
        return whole

    return convert


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
            self._traces[sample.port].take(sample)

    def begin_anew(self) -> None:
        """Clear all traces that still grow, as the time of the world was set."""
        for trace in self._traces.values():
            trace.begin_anew()

    def clear(self) -> None:
        """Drop all samples, and go on with new ones."""
        for trace in self._traces.values():
            trace.clear()

    def stop(self) -> None:
        """Take no more samples, and keep those that there are."""
        for trace in self._traces.values():
            trace.stop()
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
