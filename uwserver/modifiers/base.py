"""The contract of a modifier: a seeded change of one stream of a sensor, between the ideal value and the sample."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, structs

from uwserver.physics.kernel.random import SAMPLE, TURN_ON
from uwserver.ports import Field, Value
from uwserver.table import Table
from uwserver.units import NANOSECONDS

NEVER = -1.0
"""A time (s) before the first reading."""
Time = Annotated[float, Meta(ge=NEVER, le=9e9)]
"""A time in a record, s: `NEVER`, or one that fits into 64 bits of nanoseconds."""
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
"""Any other number in a record: small enough that all that is computed from it stays finite."""


class Memory(Struct):
    """What a sensor or modifier remembers from reading to reading: one record, which is saved with the world.

    A kind that remembers something derives its own record, with a default for each field. Fields are bool, int, float, str, bytes, None, tuples of
    these, or frozen records of these, but never numbers of numpy. Their types state limits within which every value is harmless (`Number`, `Time`,
    `msgspec.Meta`).
    """


NOTHING = Memory()
"""The record of kinds that remember nothing."""


def check_lengths(record: Memory, own: Memory) -> None:
    """Raise ValueError if a tuple in a record has another length than in `own`, a valid record of the same type."""
    for name, value in structs.asdict(own).items():
        given = getattr(record, name)
        if isinstance(value, tuple) and len(given) != len(value):
            raise ValueError(f'"{name}" has {len(given)} numbers, here it needs {len(value)}')


class ModifierTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """Base of the tables of modifiers. Each has ``build(stream) -> Modifier``, which raises ValueError if the modifier does not fit the stream."""


@dataclass(slots=True)
class Measurement:
    """A reading on its way through the chain of modifiers, at whose end it becomes an immutable Sample.

    Attributes:
        values: one entry for each field of the port.
        valid: whether the sensor could measure.
        delay_ns: simulated time from the measurement until the device delivers.
        dropped: whether the reading is lost.
        since_ns: how long ago the measurement was.
        t_ns: simulation time of the measurement.
        stamp_ns: error of the time stamp of the device.
        number: number of readings that the sensor made before.
    """

    values: list[Value]
    valid: bool
    delay_ns: int = 0
    dropped: bool = False
    since_ns: int = 0
    t_ns: int = 0
    stamp_ns: int = 0
    number: int = 0

    def since(self, last: float, dt: float) -> float:
        """Return the time (s) since a reading at `last` (s); `dt` if `last` is `NEVER`.

        It is not always `dt`, because a device may ping at its own rate, or may have been off.
        """
        return dt if last < 0.0 else max(0.0, self.t_ns / NANOSECONDS - last)


class Draws:
    """The random numbers of one path, for code that draws in Python: a generator that starts again for each reading and for each purpose.

    So a drawn number depends only on the path, the reading and the purpose, and the state of the generator need not be saved.
    """

    def __init__(self, key: int) -> None:
        """Make the generator of the path with this key (`key_of`). It begins with the numbers for the turn-on."""
        self.key = key
        self._bits = np.random.Philox(key=key)
        self._form = self._bits.state
        self.rng = np.random.Generator(self._bits)
        self.seek(0, TURN_ON)

    def seek(self, number: int, purpose: int = SAMPLE) -> None:
        """Move to the random numbers for the reading with this number."""
        form = self._form
        counter = form["state"]["counter"]
        counter[0], counter[1], counter[2], counter[3] = 0, 0, number, purpose
        form["buffer_pos"], form["has_uint32"] = 4, 0
        self._bits.state = form


@dataclass
class Stream:
    """The stream that a modifier changes.

    Attributes:
        fields: fields of the port.
        dt: sample interval, s.
        key: key of the random numbers of the modifier's path.
    """

    fields: tuple[Field, ...]
    dt: float
    key: int

    @cached_property
    def draws(self) -> Draws:
        """The random numbers of the key, for modifiers that draw in Python."""
        return Draws(self.key)

    @property
    def rng(self) -> np.random.Generator:
        """The generator, at the numbers of the present reading."""
        return self.draws.rng

    def index(self, name: str) -> int:
        """Return the position of a field whose components can have errors.

        Raises:
            ValueError: no such field, or it holds no floats, or it is a rotation, which would not stay one; the text lists the fields that can be
                modified.
        """
        floats = [field.name for field in self.fields if field.type == "float" and not field.is_rotation]
        if name not in floats:
            raise ValueError(f'no field "{name}" to modify here, there are: {", ".join(floats)}')
        return next(i for i, field in enumerate(self.fields) if field.name == name)

    def of_each(self, name: str, key: str, value: float | tuple[float, ...]) -> tuple[int, tuple[float, ...]]:
        """Return the position of a field, as `index` does, and the value of a key for each of its components. One number counts for all components.

        Raises:
            ValueError: as `index`, or the field has another number of components.
        """
        index = self.index(name)
        size = self.fields[index].size
        values = value if isinstance(value, tuple) else (value,) * size
        if len(values) != size:
            raise ValueError(f'"{key}" needs one number or {size}, one for each component of "{name}"')
        return index, values


class Modifier(ABC):
    """One change of a stream. It depends only on the reading, on `memory`, and on the random numbers of `stream`.

    The kinds of uwserver are operations, which compiled code carries out (`uwserver.modifiers.operations`).
    """

    memory: Memory = NOTHING

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    @abstractmethod
    def apply(self, reading: Measurement) -> None:
        """Change the reading in place. The generator of `stream` is at the numbers of this reading."""

    def valid(self, record: Memory) -> None:
        """Raise ValueError if a record of another run, which has the right types, cannot be the memory of this modifier."""
        check_lengths(record, self.memory)


def plain_of(row: Any, kind: type[Struct]) -> dict[str, Any]:
    """Return the fields of a numpy record as plain values, nested like the fields of a typed record of type `kind`."""
    plain: dict[str, Any] = {}
    for name, inner in _fields(kind):
        plain[name] = row[name].tolist() if inner is None else plain_of(row[name], inner)
    return plain


@cache
def _fields(kind: type[Struct]) -> tuple[tuple[str, type[Struct] | None], ...]:
    """Return the fields of a typed record: the name of each, and its type if it is a record itself.

    They are cached, because msgspec evaluates the annotations each time.
    """
    types = [(field.name, field.type) for field in structs.fields(kind)]
    return tuple((name, t if isinstance(t, type) and issubclass(t, Struct) else None) for name, t in types)


def write_record(row: Any, record: Struct) -> None:
    """Write a typed record into a numpy record with the same names."""
    for name in record.__struct_fields__:
        value = getattr(record, name)
        if isinstance(value, Struct):
            write_record(row[name], value)
        else:
            row[name] = value
