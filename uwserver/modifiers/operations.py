"""Modifiers as operations on rows of numbers: what compiled code needs of each, and how one stands alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from msgspec import convert, structs

from uwserver.modifiers.base import NOTHING, Measurement, Memory, Modifier, Stream
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import Elsewhere, compiled

PARAMETERS = 4
OPERATION = np.dtype(
    [
        ("code", "i8"),  # which kind, as in `chain`
        ("first", "i8"),  # its first component in the row of the stream
        ("count", "i8"),  # how many components
        ("memory", "i8"),  # its first number among those that operations remember
        ("key", "u8"),  # of its random numbers
        ("p", "f8", (PARAMETERS,)),  # as its kind has them
    ]
)
"""One change of a stream."""

READING = np.dtype(
    [
        ("t_ns", "i8"),  # when it was true
        ("number", "i8"),  # how many the sensor has made before
        ("delay_ns", "i8"),  # from then to its delivery
        ("stamp_ns", "i8"),  # error of the time that stands on it
        ("valid", "i8"),
        ("dropped", "i8"),
    ]
)
"""What a reading is besides its values, as `base.Measurement`."""


_DISTURB_ALONE = Elsewhere("uwserver.modifiers.chain", "disturb_alone")
"""By its name: the chain knows all kinds, and these know this module."""


@compiled
def since(reading: Any, last: float, dt: float) -> float:
    """As `base.Measurement.since`."""
    return dt if last < 0.0 else max(0.0, reading.t_ns / 1e9 - last)


@compiled
def rounded_ns(seconds: float) -> int:
    """Whole nanoseconds."""
    return int(np.rint(seconds * 1e9))


class Operation(Modifier):
    """A modifier that compiled code carries out. Kinds give the code and the parameters; `memory` lies in numbers of a world.

    Attributes:
        code: of the kind.
        row: one OPERATION; its `memory` counts from `numbers`.
        numbers: what it remembers.
    """

    code: ClassVar[int]

    def __init__(
        self,
        stream: Stream,
        field: int = -1,
        parameters: Sequence[float] = (),
        memory: Memory = NOTHING,
        *,
        more: Sequence[int] = (),
    ) -> None:
        """Args:
        stream: whose readings it changes.
        field: position of the field that it changes; -1 for none.
        parameters: as the kind's compiled function has them.
        memory: at the start.
        more: positions of further fields, whose operations remember the same.
        """
        super().__init__(stream)
        self._kind = type(memory)
        self.columns = columns_of(stream.fields)
        self.numbers: FloatArray = np.array([number for value in structs.astuple(memory) for number in _parts(value)])
        targets = [field, *more]
        self.rows = np.zeros(len(targets), OPERATION)
        self.rows["code"], self.rows["key"] = self.code, stream.key
        self.rows["p"][:, : len(parameters)] = parameters
        for row, target in zip(self.rows, targets, strict=True):
            row["first"] = self.columns.first[target] if target >= 0 else 0
            row["count"] = stream.fields[target].size if target >= 0 else 0
        self._lengths = [len(v) if isinstance(v, tuple) else -1 for v in structs.astuple(memory)]

    @property
    def memory(self) -> Memory:
        """What it remembers, as a record."""
        return self.record(self.numbers)

    @memory.setter
    def memory(self, record: Memory) -> None:
        self.numbers[:] = [number for value in structs.astuple(record) for number in _parts(value)]

    def record(self, numbers: FloatArray) -> Memory:
        """Numbers of such an operation as a record.

        Raises:
            ValueError: outside the limits of its type.
        """
        if not self._lengths:
            return NOTHING
        rest, values = iter(numbers.tolist()), {}
        for name, length in zip(self._kind.__struct_fields__, self._lengths, strict=True):
            values[name] = next(rest) if length < 0 else tuple([next(rest) for _ in range(length)])
        return convert(values, self._kind)

    def apply(self, reading: Measurement) -> None:
        """Change a reading in place, outside a world."""
        row, header = np.empty(max(1, self.columns.width)), np.zeros(1, READING)
        self.columns.pack(reading.values, row)
        for name in READING.names or ():
            header[name] = getattr(reading, name)
        _DISTURB_ALONE.made()(self.rows, self.numbers, row, header, self.stream.dt)
        loose = [reading.values[k] for k in self.columns.loose]
        reading.values[:] = self.columns.unpack(row[: self.columns.width], loose)
        told = header[0]
        reading.delay_ns, reading.stamp_ns = int(told["delay_ns"]), int(told["stamp_ns"])
        reading.valid, reading.dropped = bool(told["valid"]), bool(told["dropped"])


def _parts(value: Any) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


__all__ = ["OPERATION", "READING", "Array", "Operation", "rounded_ns", "since"]
