"""Modifiers as operations on rows of numbers, which compiled code carries out: in a world, or one modifier alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from msgspec import convert, structs

from uwserver.modifiers.base import NOTHING, Measurement, Memory, Modifier, Stream
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.deferred import Elsewhere, compiled

PARAMETERS = 4
OPERATION = np.dtype(
    [
        ("code", "i8"),  # kind, as `chain.disturb` knows it
        ("first", "i8"),  # place of the first component in the row of the stream
        ("count", "i8"),  # number of components
        ("memory", "i8"),  # place of its first number in the memory of all operations
        ("key", "u8"),  # of its random numbers
        ("p", "f8", (PARAMETERS,)),  # parameters of the kind
    ]
)
"""One change of one field of a stream."""

READING = np.dtype(
    [
        ("t_ns", "i8"),  # time of the measurement
        ("number", "i8"),  # number of readings that the sensor made before
        ("delay_ns", "i8"),  # from the measurement to the delivery
        ("stamp_ns", "i8"),  # error of the time stamp
        ("valid", "i8"),
        ("dropped", "i8"),
    ]
)
"""A reading without its values; see `base.Measurement`."""

_DISTURB_ALONE = Elsewhere("uwserver.modifiers.chain", "disturb_alone")
"""Named by a text, because `chain` imports all kinds, and these import this module."""


@compiled
def since(reading: Any, last: float, dt: float) -> float:
    """Return the time since a reading at `last`, as `base.Measurement.since` does."""
    return dt if last < 0.0 else max(0.0, reading.t_ns / 1e9 - last)


@compiled
def rounded_ns(seconds: float) -> int:
    """Return a time in whole nanoseconds."""
    return int(np.rint(seconds * 1e9))


class Operation(Modifier):
    """A modifier that compiled code carries out.

    Attributes:
        rows: an OPERATION for each field that it changes; their `memory` counts from the begin of `numbers`.
        numbers: the memory as numbers, as long as the modifier is not in a world.
        columns: columns of the stream.
    """

    def __init__(
        self,
        code: int,
        stream: Stream,
        field: int = -1,
        parameters: Sequence[float] = (),
        memory: Memory = NOTHING,
        *,
        more: Sequence[int] = (),
    ) -> None:
        """Make the operations of a modifier.

        Args:
            code: code of the kind.
            stream: whose readings it changes.
            field: position of the field that it changes; -1 for none.
            parameters: parameters of the compiled function of the kind.
            memory: at the start.
            more: positions of further fields; their operations share the memory.
        """
        super().__init__(stream)
        self._kind = type(memory)
        self.columns = columns_of(stream.fields)
        self.numbers: FloatArray = np.array(_flat(memory))
        targets = [field, *more]
        self.rows = np.zeros(len(targets), OPERATION)
        self.rows["code"], self.rows["key"] = code, stream.key
        self.rows["p"][:, : len(parameters)] = parameters
        for row, target in zip(self.rows, targets, strict=True):
            row["first"] = self.columns.first[target] if target >= 0 else 0
            row["count"] = stream.fields[target].size if target >= 0 else 0
        # Number of components of each field of the memory; -1 for a single number.
        self._lengths = [len(v) if isinstance(v, tuple) else -1 for v in structs.astuple(memory)]

    @property
    def memory(self) -> Memory:
        """The memory as a record."""
        return self.record(self.numbers)

    @memory.setter
    def memory(self, record: Memory) -> None:
        self.numbers[:] = _flat(record)

    def record(self, numbers: FloatArray) -> Memory:
        """Return the memory that numbers stand for.

        Raises:
            ValueError: a number is outside the limits of its type.
        """
        rest, values = iter(numbers.tolist()), {}
        for name, length in zip(self._kind.__struct_fields__, self._lengths, strict=True):
            values[name] = next(rest) if length < 0 else tuple([next(rest) for _ in range(length)])
        return convert(values, self._kind)

    def apply(self, reading: Measurement) -> None:
        """Change a reading in place. In a world, compiled code does this for all modifiers of a stream (`chain.disturb`)."""
        row, header = np.empty(max(1, self.columns.width)), np.zeros(1, READING)
        self.columns.pack(reading.values, row)
        for name in READING.names or ():
            header[name] = getattr(reading, name)
        _DISTURB_ALONE.made()(self.rows, self.numbers, row, header, self.stream.dt)
        reading.values[:] = self.columns.unpack(row[: self.columns.width], self.columns.loose_of(reading.values))
        changed = header[0]
        reading.delay_ns, reading.stamp_ns = int(changed["delay_ns"]), int(changed["stamp_ns"])
        reading.valid, reading.dropped = bool(changed["valid"]), bool(changed["dropped"])


def _flat(record: Memory) -> list[float]:
    """Return all numbers of a record in their order."""
    parts = [value if isinstance(value, tuple) else (value,) for value in structs.astuple(record)]
    return list(chain.from_iterable(parts))
