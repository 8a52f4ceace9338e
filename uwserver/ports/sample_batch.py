"""Samples as a world delivers them: rows of arrays, from which `Sample` objects are made only when they are read."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, overload

import numpy as np

from uwserver.ports.values import Sample, Value

Unpack = Callable[[list[float], Any, int, Sequence[Value]], tuple[Value, ...]]
"""Makes the values of a sample. Its arguments are the numbers of the sample, the same array as int64, the place of the first number in it, and the
values that are not numbers."""


class Origin(NamedTuple):
    """How to read the samples of one stream.

    Attributes:
        path: path of the port.
        width: number of numbers in a sample.
        unpack: makes the values of a sample.
        texts: possible sets of values that are not numbers; `SampleLog.entries` says which of them a sample has, if any.
    """

    path: str
    width: int
    unpack: Unpack
    texts: Sequence[tuple[Value, ...]] = ()


class SampleLog:
    """A log of samples, one after the other. The simulation appends to it. Readers read only the part that they were told of, which is never
    written again; so no lock is needed.

    Attributes:
        entries: (n) records of int64: t_sent_ns, number of its set in `Origin.texts` (from 1; 0 for none), stream, seq, t_ns, valid, and place of
            its first number.
        numbers: (m) float64, the numbers of all samples one after the other.
        loose: values that are not numbers, for samples that have others than `Origin.texts`, by place.
    """

    __slots__ = ("entries", "loose", "numbers", "table", "whole")

    def __init__(self, entries: Any, numbers: Any) -> None:
        """Make a log of two arrays, as described above."""
        self.entries, self.numbers = entries, numbers
        self.loose: dict[int, Sequence[Value]] = {}
        self.table = entries.view(np.int64).reshape(-1, entries.itemsize // 8)  # quicker to read than records
        self.whole = numbers.view(np.int64)


class SampleBatch(Sequence[Sample]):
    """Samples of one tick, or of several consecutive ticks, as a range of a log.

    `Sample` objects are made each time they are read, and not kept. So samples that nobody reads cost nothing, and one that is encoded at once is
    still in the cache of the processor.

    Attributes:
        origins: by number of the stream.
        log: that holds them.
        ticks: number of ticks.
    """

    __slots__ = ("_end", "_ends", "_first", "log", "origins", "ticks")

    def __init__(
        self,
        origins: Mapping[int, Origin],
        log: SampleLog,
        first: int,
        end: int,
        ticks: int = 1,
        ends: tuple[int, ...] = (),
    ) -> None:
        """Take the samples of a log from place `first` to before `end`; `ends` has the end of each tick but the last, for `by_tick`."""
        self.origins, self.log, self._first, self._end, self.ticks, self._ends = origins, log, first, end, ticks, ends

    def __len__(self) -> int:
        return self._end - self._first

    def followed_by(self, other: SampleBatch) -> SampleBatch | None:
        """Return both together; None unless the other begins where this ends."""
        if other.log is not self.log or other._first != self._end or other.origins is not self.origins:
            return None
        ends = (*self._ends, self._end, *other._ends)
        return SampleBatch(self.origins, self.log, self._first, other._end, self.ticks + other.ticks, ends)

    def by_tick(self) -> Iterator[SampleBatch]:
        """Yield the samples of each tick."""
        first = self._first
        for end in (*self._ends, self._end):
            yield SampleBatch(self.origins, self.log, first, end)
            first = end

    def parts(self, most: int) -> Iterator[SampleBatch]:
        """Yield the samples in pieces of at most `most`."""
        for first in range(self._first, self._end, most):
            yield SampleBatch(self.origins, self.log, first, min(first + most, self._end), self.ticks)

    @property
    def first(self) -> int:
        """Place of the first sample in the log."""
        return self._first

    def at(self, place: int) -> SampleBatch:
        """Return the sample at a place of the log."""
        return SampleBatch(self.origins, self.log, place, place + 1, self.ticks)

    @property
    def streams(self) -> list[int]:
        """Number of the stream of each sample."""
        return self.log.table[self._first : self._end, 2].tolist()  # type: ignore[no-any-return]  # numpy's

    def entries(self) -> list[list[int]]:
        """Return the entry of each sample, as `SampleLog.entries` has it."""
        return self.log.table[self._first : self._end].tolist()  # type: ignore[no-any-return]  # numpy's

    def loose(self, place: int, texts: int, stream: int) -> Sequence[Value]:
        """Return the values that are not numbers of a sample at a place of the log; `texts` and `stream` are from its entry."""
        return self.origins[stream].texts[texts - 1] if texts else self.log.loose.get(place, ())

    def values(self, entries: Sequence[Sequence[int]]) -> Iterator[tuple[Value, ...]]:
        """Yield the values of each of some consecutive entries, which begin with the first sample."""
        if not entries:
            return
        origins, log, place = self.origins, self.log, self._first
        base, last = entries[0][6], entries[-1]
        numbers, whole = log.numbers[base : last[6] + origins[last[2]].width].tolist(), log.whole
        for _, texts, stream, _, _, _, at in entries:
            _, width, unpack, _ = origins[stream]
            yield unpack(numbers[at - base : at - base + width], whole, at, self.loose(place, texts, stream))
            place += 1

    def __iter__(self) -> Iterator[Sample]:
        origins, entries = self.origins, self.entries()
        for (t_sent_ns, _, stream, seq, t_ns, valid, _), values in zip(entries, self.values(entries), strict=True):
            yield Sample(origins[stream].path, seq, t_ns, t_sent_ns, valid != 0, values)

    @overload
    def __getitem__(self, place: int) -> Sample: ...

    @overload
    def __getitem__(self, place: slice) -> list[Sample]: ...

    def __getitem__(self, place: int | slice) -> Sample | list[Sample]:
        places = range(self._first, self._end)[place]
        if isinstance(places, range):
            return [self[i - self._first] for i in places]
        return next(iter(SampleBatch(self.origins, self.log, places, places + 1)))

    @property
    def ports(self) -> list[str]:
        """Path of the port of each sample."""
        origins = self.origins
        return [origins[stream].path for stream in self.streams]

    def newest(self, port: str) -> Sample:
        """Return the last sample of a port, which must have one here."""
        return self[len(self) - 1 - self.ports[::-1].index(port)]


_SHOWN = 5
"""Samples that are shown one by one at a prompt; of more, only how many there are."""
_ALONE = 3
"""A sample that is made alone takes as long as so many that are made one after the other."""


class Samples(Sequence[Sample]):
    """Samples of several ticks, in their order. It behaves like a list, but makes its samples, all at once, only when they are first read."""

    __slots__ = ("_count", "_made", "_pieces")

    def __init__(self) -> None:
        self._pieces: list[Sequence[Sample]] = []
        self._made: list[Sample] = []
        self._count = 0

    def add(self, piece: Sequence[Sample]) -> None:
        """Append samples."""
        if piece:
            self._pieces.append(piece)
            self._count += len(piece)

    def join(self, later: Samples) -> None:
        """Append those of a later step, which is not used any more."""
        if later._made:
            self.add(later._made)
        self._pieces += later._pieces
        self._count += sum(map(len, later._pieces))

    def of(self, ports: Container[str]) -> Iterator[Sample]:
        """Yield the samples of some ports, by path. The others are not made, unless it is quicker to make all of a piece."""
        yield from (sample for sample in self._made if sample.port in ports)
        for piece in self._pieces:
            if isinstance(piece, SampleBatch):
                places = [k for k, port in enumerate(piece.ports) if port in ports]
                if _ALONE * len(places) <= len(piece):
                    yield from (piece[k] for k in places)
                    continue
            yield from (sample for sample in piece if sample.port in ports)

    def _all(self) -> list[Sample]:
        if self._pieces:
            self._made = [*self._made, *(sample for piece in self._pieces for sample in piece)]
            self._pieces = []
        return self._made

    def __reduce__(self) -> tuple[type[list[Sample]], tuple[list[Sample]]]:
        return list, (self._all(),)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Sample]:
        return iter(self._all())

    @overload
    def __getitem__(self, place: int) -> Sample: ...

    @overload
    def __getitem__(self, place: slice) -> list[Sample]: ...

    def __getitem__(self, place: int | slice) -> Sample | list[Sample]:
        return self._all()[place]

    def __add__(self, others: Sequence[Sample]) -> list[Sample]:
        return [*self, *others]

    def __radd__(self, others: Sequence[Sample]) -> list[Sample]:
        return [*others, *self]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, list | Samples) and self._all() == [*other]

    __hash__ = None  # type: ignore[assignment]  # as a list

    def __repr__(self) -> str:
        samples = self._all()
        if len(samples) <= _SHOWN:
            return repr(samples)
        ports = len({sample.port for sample in samples})
        times = [sample.t_ns / 1e9 for sample in samples]
        return f"<{len(samples)} samples of {ports} sensors, measured from {min(times):.3f} to {max(times):.3f} s>"
