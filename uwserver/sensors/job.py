"""Readings that take time: a tick begins them, a thread of the world computes them, and they are delivered when the device would have them.

Such a sensor sets `takes_time`, and its `sense` returns a `PendingMeasurement`. This takes microseconds. A `PendingMeasurement` has the numbers of
the reading, which are known at once; the delay until the delivery (at least one tick); and a `Job`, which has everything that it needs of that
instant. Because the world goes on, a job keeps `Scope.still`, a seed drawn from the sensor's `rng`, and the settings, and never looks at the sensor
again. Its result is the values that are no numbers (buffers, texts: `Columns.loose`), in the order of the fields. In the `PendingMeasurement` they
are None.

In free-run, in lock-step and in-process, the tick in which a reading is due waits for it, so the bits are the same in all these modes. In real
time no tick waits: a reading is dropped if it is not ready when it is due, or if the reading before it is still being computed when it begins. The
drop is a call of ``world/drop_reading``, so that a recording repeats it.

The jobs of a world run one at a time. The one that is due first runs first, and a job that a tick waits for goes before all others. A job runs only
if somebody reads the port or the sensor `learns`. A long job is cut into pieces; between two pieces other jobs run that are due earlier, so that no
ping is lost behind a picture. If a job raises, its reading is invalid.

A table may have the property `cores`, the part of a core that its readings take in real time, about; `uwserver check` reports it. With
`computing_s` (processor time of a reading), `given_s` (time from its begin to its delivery) and, if there are pieces, `piece_s`, the command also
reports whether a reading may be late.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import TypeVar, cast

from uwserver.modifiers import Measurement
from uwserver.modifiers.columns import columns_of
from uwserver.ports import Field, Value

T = TypeVar("T")
Pieces = Generator[None, None, T]
"""Work that can be interrupted wherever it yields, and that returns a result."""


def whole(pieces: Pieces[T], between: Callable[[], None] | None = None) -> T:
    """Do all pieces one after the other, call `between` after each of them, and return the result."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            return cast("T", end.value)
        if between is not None:
            between()


class Job(ABC):
    """The rest of the work for a reading. It may use arrays that all jobs of a sensor share, as only one of them runs at a time.

    Attributes:
        shared: the owner of these arrays; None if the job shares nothing. A job in pieces must set it.
    """

    shared: object = None

    @abstractmethod
    def run(self) -> tuple[Value, ...]:
        """Return the values of the fields that are no numbers, in order. It is a pure function of the job, called at most once, in another thread."""

    def pieces(self) -> Pieces[tuple[Value, ...]]:
        """Do the same as `run`, in pieces of some milliseconds. By default there is one piece."""
        yield from ()
        return self.run()


class _Nothing(Job):
    def run(self) -> tuple[Value, ...]:
        return ()


@dataclass(slots=True)
class PendingMeasurement(Measurement):
    """A reading that is being computed.

    Attributes:
        job: computes the rest of its values.
    """

    job: Job = field(default_factory=_Nothing, compare=False)


def finished(reading: Measurement, fields: tuple[Field, ...]) -> Measurement:
    """Return the complete reading. If it was only begun, it is computed now; for sensors that are used outside a world."""
    if not isinstance(reading, PendingMeasurement):
        return reading
    values = list(reading.values)
    for k, value in zip(columns_of(fields).loose, reading.job.run(), strict=True):
        values[k] = value
    return replace(reading, values=values, job=_Nothing())
