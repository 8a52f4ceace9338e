"""What a modifier is: a seeded change of one sensor's stream, between the ideal value and the sample."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cache
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
"""A time in a record, s: `NEVER`, or one that can be told in 64 bits of nanoseconds."""
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
"""Any other number in a record: finite, and so small that what is computed from it is too."""


class Memory(Struct):
    """What a sensor or modifier remembers from reading to reading: one record, which is saved with the world.

    A kind that remembers something derives its own, with a default for each field. Fields are bool, int, float, str, bytes, None, tuples of
    these, or frozen records of these, never numpy's numbers; their types state the limits within which any value is harmless (`Number`,
    `Time`, `msgspec.Meta`).
    """


NOTHING = Memory()
"""The record of all kinds that remember nothing."""


def check_lengths(record: Memory, own: Memory) -> None:
    """ValueError where a tuple of a record has another length than in one of the same kind that fits."""
    for name, value in structs.asdict(own).items():
        given = getattr(record, name)
        if isinstance(value, tuple) and len(given) != len(value):
            raise ValueError(f'"{name}" has {len(given)} numbers, here it needs {len(value)}')


class ModifierTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """Base of the table of every modifier; each has ``build(stream) -> Modifier``, which raises ValueError for a stream that it does not fit."""


@dataclass(slots=True)
class Measurement:
    """A reading on its way through the chain of its sensor; private to the chain, turned into an immutable Sample at its end.

    Attributes:
        values: one entry per field of the port.
        valid: the sensor could measure.
        delay_ns: simulated time from the instant to which the reading belongs until the device delivers.
        dropped: the reading is lost.
        t_ns: simulation time at which it was true.
        stamp_ns: error of the time that the device writes on it.
        since_ns: how long ago that instant was.
        number: how many the sensor has made before.
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
        """Time (s) since a reading at `last` (s), which a device that pings at its own pace, or was off, decides; `dt` where `last` is `NEVER`."""
        return dt if last < 0.0 else max(0.0, self.t_ns / NANOSECONDS - last)


class Draws:
    """Random numbers of one path for who draws in Python: a generator that begins anew with each reading, and for each purpose.

    So what is drawn depends on the path, the reading and the purpose alone, and nothing has to be kept of it.
    """

    def __init__(self, key: int) -> None:
        """Of a path with this key (`key_of`); it stands where who is switched on draws."""
        self.key = key
        self._bits = np.random.Philox(key=key)
        self._form = self._bits.state
        self.rng = np.random.Generator(self._bits)
        self.seek(0, TURN_ON)

    def seek(self, number: int, purpose: int = SAMPLE) -> None:
        """Begin with what is drawn for a reading of this number."""
        form = self._form
        counter = form["state"]["counter"]
        counter[0], counter[1], counter[2], counter[3] = 0, 0, number, purpose
        form["buffer_pos"], form["has_uint32"] = 4, 0
        self._bits.state = form


@dataclass(slots=True)
class Stream:
    """What a modifier knows of the stream it changes.

    Attributes:
        fields: of the port.
        dt: sample interval, s.
        key: of the random numbers of the modifier's own path.
    """

    fields: tuple[Field, ...]
    dt: float
    key: int
    _draws: Draws | None = field(default=None, repr=False)

    @property
    def draws(self) -> Draws:
        """The numbers of that key, for who draws in Python."""
        if self._draws is None:
            self._draws = Draws(self.key)
        return self._draws

    @property
    def rng(self) -> np.random.Generator:
        """Draws the numbers of this path that belong to the present reading."""
        return self.draws.rng

    def index(self, name: str) -> int:
        """Position of a field whose components errors may change.

        Raises:
            ValueError: no such field, or it holds no floats, or a rotation, which no error of components leaves one; the text lists those
                that can be modified.
        """
        floats = [field.name for field in self.fields if field.type == "float" and not field.is_rotation]
        if name not in floats:
            raise ValueError(f'no field "{name}" to modify here, there are: {", ".join(floats)}')
        return next(i for i, field in enumerate(self.fields) if field.name == name)

    def of_each(self, name: str, key: str, value: float | tuple[float, ...]) -> tuple[int, tuple[float, ...]]:
        """Position of a field as `index`, and the key's value for each of its components, where one number may stand for all.

        Raises:
            ValueError: as `index`, or another number of values than components.
        """
        index = self.index(name)
        size = self.fields[index].size
        values = value if isinstance(value, tuple) else (value,) * size
        if len(values) != size:
            raise ValueError(f'"{key}" needs one number or {size}, one for each component of "{name}"')
        return index, values


class Modifier(ABC):
    """One change of a stream, which depends on the reading, on `memory` and on the random numbers of `stream`, and on nothing else.

    Kinds that come with uwserver are operations (`uwserver.modifiers.operations`), which compiled code carries out.
    """

    memory: Memory = NOTHING

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    @abstractmethod
    def apply(self, reading: Measurement) -> None:
        """Change the reading in place. The random numbers stand at those of this reading."""

    def valid(self, record: Memory) -> None:
        """Raise ValueError where a record of another run, though of the right types, cannot be the memory of this one."""
        check_lengths(record, self.memory)


def plain_of(row: Any, kind: type[Struct]) -> dict[str, Any]:
    """Fields of a record of numpy as plain values, nested as those of a typed record."""
    plain: dict[str, Any] = {}
    for name, inner in _fields(kind):
        plain[name] = row[name].tolist() if inner is None else plain_of(row[name], inner)
    return plain


@cache
def _fields(kind: type[Struct]) -> tuple[tuple[str, type[Struct] | None], ...]:
    """Of a typed record by name, and the type of those that are records; found once, as msgspec reads the source of types each time."""
    types = [(field.name, field.type) for field in structs.fields(kind)]
    return tuple((name, t if isinstance(t, type) and issubclass(t, Struct) else None) for name, t in types)


def write_record(row: Any, record: Struct) -> None:
    """Write a typed record into one of numpy with the same names."""
    for name in record.__struct_fields__:
        value = getattr(record, name)
        if isinstance(value, Struct):
            write_record(row[name], value)
        else:
            row[name] = value
