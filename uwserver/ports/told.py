"""Samples as a world delivers them: rows of arrays, of which objects are made where somebody looks at them."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, overload

import numpy as np

from uwserver.ports.values import Sample, Value

Unpack = Callable[[list[float], Any, int, Sequence[Value]], tuple[Value, ...]]
"""Makes the values of a sample, of its numbers; of the same as they lie in an array of int64, and the place of the first there; and of the values
that are no numbers."""


class Origin(NamedTuple):
    """Where samples of a stream come from.

    Attributes:
        path: of the port.
        width: numbers of a sample.
        unpack: makes its values.
        texts: what the values that are no numbers may be; `Log.entries` says which of them a sample has, if any.
    """

    path: str
    width: int
    unpack: Unpack
    texts: Sequence[tuple[Value, ...]] = ()


class Log:
    """Samples one behind the other. Who simulates appends to it, others read of it what they were told is there: that is never written again.

    Attributes:
        entries: (n) records of int64: t_sent_ns, which of the texts of its origin it has, from 1, or 0 for none, stream, seq, t_ns, valid, and the
            place of its first number.
        numbers: (m) float64 of one after the other.
        loose: by place, of samples that have others: the values that are no numbers.
    """

    __slots__ = ("entries", "loose", "numbers", "table", "whole")

    def __init__(self, entries: Any, numbers: Any) -> None:
        """Of arrays, as they are described above."""
        self.entries, self.numbers = entries, numbers
        self.loose: dict[int, Sequence[Value]] = {}
        self.table = entries.view(np.int64).reshape(-1, entries.itemsize // 8)  # quicker to look at than records
        self.whole = numbers.view(np.int64)


class Told(Sequence[Sample]):
    """Samples of one tick, or of some that follow each other.

    They are made anew whenever somebody looks at them, and not kept: who encodes each at once has it in the nearest memory of the processor, and
    neither the thread that simulates nor the one that sends pays for what nobody looks at.

    Attributes:
        origins: by number of a stream.
        log: where they stand.
        ticks: of how many they are.
    """

    __slots__ = ("_end", "_ends", "_first", "log", "origins", "ticks")

    def __init__(
        self, origins: Mapping[int, Origin], log: Log, first: int, end: int, ticks: int = 1, ends: tuple[int, ...] = ()
    ) -> None:
        """Those of a log from place `first` to before `end`; `ends`: the same of each tick but the last, where they are to come apart again."""
        self.origins, self.log, self._first, self._end, self.ticks, self._ends = origins, log, first, end, ticks, ends

    def __len__(self) -> int:
        return self._end - self._first

    def followed_by(self, other: Told) -> Told | None:
        """Both together, where the other begins where this ends."""
        if other.log is not self.log or other._first != self._end or other.origins is not self.origins:
            return None
        ends = (*self._ends, self._end, *other._ends)
        return Told(self.origins, self.log, self._first, other._end, self.ticks + other.ticks, ends)

    def by_tick(self) -> Iterator[Told]:
        """The same, each tick by itself."""
        first = self._first
        for end in (*self._ends, self._end):
            yield Told(self.origins, self.log, first, end)
            first = end

    def parts(self, most: int) -> Iterator[Told]:
        """The same in pieces of at most so many."""
        for first in range(self._first, self._end, most):
            yield Told(self.origins, self.log, first, min(first + most, self._end), self.ticks)

    @property
    def first(self) -> int:
        """Place of the first one in the log."""
        return self._first

    def at(self, place: int) -> Told:
        """The one in a place of the log."""
        return Told(self.origins, self.log, place, place + 1, self.ticks)

    @property
    def streams(self) -> list[int]:
        """Numbers of the streams, of each sample."""
        return self.log.table[self._first : self._end, 2].tolist()  # type: ignore[no-any-return]  # numpy's

    def entries(self) -> list[list[int]]:
        """Of each, as `Log.entries` has it."""
        return self.log.table[self._first : self._end].tolist()  # type: ignore[no-any-return]  # numpy's

    def loose(self, place: int, texts: int, stream: int) -> Sequence[Value]:
        """The values that are no numbers, of a sample in this place of the log, by its entry."""
        return self.origins[stream].texts[texts - 1] if texts else self.log.loose.get(place, ())

    def values(self, entries: Sequence[Sequence[int]]) -> Iterator[tuple[Value, ...]]:
        """Of each of these entries, which follow each other."""
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
        return next(iter(Told(self.origins, self.log, places, places + 1)))

    @property
    def ports(self) -> list[str]:
        """Paths of the ports, of each sample."""
        origins = self.origins
        return [origins[stream].path for stream in self.streams]

    def newest(self, port: str) -> Sample:
        """The last one of a port that has some."""
        return self[len(self) - 1 - self.ports[::-1].index(port)]


class Samples(Sequence[Sample]):
    """Samples of some ticks, in their order: as a list, but none is made before somebody looks, and then all are, once."""

    __slots__ = ("_count", "_made", "_pieces")

    def __init__(self) -> None:
        self._pieces: list[Sequence[Sample]] = []
        self._made: list[Sample] = []
        self._count = 0

    def add(self, piece: Sequence[Sample]) -> None:
        """Some more behind them."""
        if piece:
            self._pieces.append(piece)
            self._count += len(piece)

    def of(self, ports: Container[str]) -> Iterator[Sample]:
        """Those of some ports, by path; the others are not made."""
        yield from (sample for sample in self._made if sample.port in ports)
        for piece in self._pieces:
            if isinstance(piece, Told):
                yield from (piece[k] for k, port in enumerate(piece.ports) if port in ports)
            else:
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
        return repr(self._all())
