"""Readings that take time: begun in a tick, computed in a thread of the world, delivered when the device would have them.

A sensor of this sort sets `takes_time` and gives a `Begun` from `sense`. That costs microseconds: the numbers of the reading, known at once; the
delay until its delivery (a delay shorter than a tick counts as one tick); and a `Job`, which knows all that it needs of that instant. What moves
goes on moving: a job keeps `Scope.still`, a seed that was drawn of the sensor's `rng`, and the settings, and never looks at the sensor again. Its
result are those values that are no numbers (buffers, texts: `Columns.loose`), in the order of the fields; in the `Begun` they are None.

Who waits: in free-run, lock-step and in-process the tick in which the reading is due; so the bits are the same in all modes. In real time nobody:
a reading that is not ready when it is due, or that would begin while the one before is still computed, is dropped whole; the drop is a call of
``world/drop_reading``, so that a recording repeats it. Jobs of a world run one at a time, first what is due first (one that is needed now before
those that are not), and only if somebody reads the port or the sensor `learns`. A long job comes in pieces, between which others run that are due
before it, so that no ping is lost behind a picture. A job that raises makes its reading invalid. A table
with a property `cores` (the part of one core that its readings take in real time, about) has `uwserver check` tell it; with `computing_s` (processor
time of a reading), `given_s` (from its begin to its delivery) and, where it has pieces, `piece_s` also whether a reading may be late.
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
"""Work that can wait wherever it yields, and what it gives in the end."""


def whole(pieces: Pieces[T], between: Callable[[], None] | None = None) -> T:
    """Do all pieces, one after the other, and something `between` them."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            return cast("T", end.value)
        if between is not None:
            between()


class Job(ABC):
    """What is left to do of a reading. It may use arrays that all jobs of a sensor share: no two jobs of a sensor are under way at once.

    Attributes:
        shared: who has these arrays; None where no job but this one uses its own. Jobs in pieces must tell.
    """

    shared: object = None

    @abstractmethod
    def run(self) -> tuple[Value, ...]:
        """The values of those fields that are no numbers, in their order. In another thread, at most once; a pure function of the job."""

    def pieces(self) -> Pieces[tuple[Value, ...]]:
        """As `run`, in pieces of some milliseconds; one for a job that does not say."""
        yield from ()
        return self.run()


class _Nothing(Job):
    def run(self) -> tuple[Value, ...]:
        return ()


@dataclass(slots=True)
class Begun(Measurement):
    """A reading under computation.

    Attributes:
        job: makes the rest of its values.
    """

    job: Job = field(default_factory=_Nothing, compare=False)


def finished(reading: Measurement, fields: tuple[Field, ...]) -> Measurement:
    """The whole reading, computed here and now where it was only begun; for who reads a sensor alone."""
    if not isinstance(reading, Begun):
        return reading
    values = list(reading.values)
    for k, value in zip(columns_of(fields).loose, reading.job.run(), strict=True):
        values[k] = value
    return replace(reading, values=values, job=_Nothing())
