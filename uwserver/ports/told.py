"""Samples as a world delivers them: rows of arrays, of which objects are made where somebody looks at them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, overload

from uwserver.ports.values import Sample, Value


class Origin(NamedTuple):
    """Where samples of a stream come from.

    Attributes:
        path: of the port.
        width: numbers of a sample.
        unpack: makes its values, of those and of the values that are no numbers.
    """

    path: str
    width: int
    unpack: Callable[[Any, Sequence[Value]], tuple[Value, ...]]


class Told(Sequence[Sample]):
    """Samples of one tick.

    They are made anew whenever somebody looks at them, and not kept: who encodes each at once has it in the nearest memory of the processor, and
    neither the thread that simulates nor the one that sends pays for what nobody looks at.
    """

    __slots__ = ("_entries", "_loose", "_origins", "_rows")

    def __init__(
        self, origins: Mapping[int, Origin], entries: Any, rows: Any, loose: Mapping[int, Sequence[Value]]
    ) -> None:
        """Of arrays that nobody writes to any more.

        Args:
            origins: by number of a stream.
            entries: (n,) records of int64: t_sent_ns, order, stream, seq, t_ns, valid, and what is of no account here.
            rows: (n, w) float64 of each; the first ones are its numbers.
            loose: by place from 0, of samples that have such: the values that are no numbers.
        """
        self._origins, self._entries, self._rows, self._loose = origins, entries, rows, loose

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[Sample]:
        origins, loose = self._origins, self._loose
        for i, (entry, row) in enumerate(zip(self._entries.tolist(), self._rows, strict=True)):
            t_sent_ns, _, stream, seq, t_ns, valid, _ = entry
            path, width, unpack = origins[stream]
            yield Sample(path, seq, t_ns, t_sent_ns, valid != 0, unpack(row[:width], loose.get(i, ())))

    @overload
    def __getitem__(self, place: int) -> Sample: ...

    @overload
    def __getitem__(self, place: slice) -> list[Sample]: ...

    def __getitem__(self, place: int | slice) -> Sample | list[Sample]:
        places = range(len(self))[place]
        if isinstance(places, range):
            return [self[i] for i in places]
        t_sent_ns, _, stream, seq, t_ns, valid, _ = self._entries[places].item()
        path, width, unpack = self._origins[stream]
        values = unpack(self._rows[places, :width], self._loose.get(places, ()))
        return Sample(path, seq, t_ns, t_sent_ns, valid != 0, values)

    @property
    def ports(self) -> list[str]:
        """Paths of the ports, of each sample."""
        origins = self._origins
        return [origins[stream].path for stream in self._entries["stream"].tolist()]

    def newest(self, port: str) -> Sample:
        """The last one of a port that has some."""
        return self[len(self) - 1 - self.ports[::-1].index(port)]
