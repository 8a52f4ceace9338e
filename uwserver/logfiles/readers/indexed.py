"""A `Log` over an index of all entries of a file, for the formats that have no index of their own."""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwserver.logfiles.log import Datum, Kind, LogError, LogField, Topic, foreign
from uwserver.logfiles.timebase import Timebase, gaps, shortened

Decode = Callable[[int], Mapping[str, object] | None]
"""Maps the place of an entry to its fields, or to None when it cannot be read. May raise any error of a parser."""


class LogTopic(NamedTuple):
    """One topic of an indexed log: its name, the name of its type, its fields, and the function that reads an entry."""

    name: str
    schema: str
    fields: tuple[LogField, ...]
    decode: Decode


class Entries(NamedTuple):
    """All entries in the order of the file: (n,) the index of the source, and (n,) the place that `LogTopic.decode` takes."""

    sources: NDArray[np.int32]
    places: NDArray[np.int64]


def mapped(path: Path) -> mmap.mmap:
    """Map the bytes of a file into memory for random access.

    Raises:
        OSError: the file cannot be opened.
        LogError: the file is empty.
    """
    with path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            raise LogError(f"{path}: the file is empty")
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def line_blocks(data: mmap.mmap, at: int, block_bytes: int) -> Iterator[tuple[int, list[bytes]]]:
    """Yield the lines of a text in blocks of about `block_bytes`: the place of the first line, and the lines without their line feeds.

    A line that is longer than a block comes whole, as the first of a block of its own.
    """
    while at < len(data):
        end = data.rfind(b"\n", at, at + block_bytes) + 1
        if end <= at:  # the last line, or a line that is longer than a block
            end = data.find(b"\n", at) + 1 or len(data)
        yield at, data[at:end].split(b"\n")
        at = end


class IndexedLog:
    """A `Log` over an index.

    Args:
        path, kind: as in `Log`.
        sources: the topics.
        entries: all entries of the file.
        base: the time base of the entries.
        remarks: remarks of the reader that made the index; remarks about the time base and gaps are added to them.
        close: closes the file.
    """

    def __init__(
        self,
        path: Path,
        kind: Kind,
        sources: Sequence[LogTopic],
        entries: Entries,
        base: Timebase,
        *,
        remarks: Sequence[str] = (),
        close: Callable[[], None] = lambda: None,
    ) -> None:
        order = base.order
        self.path = path
        self.kind: Kind = kind
        self._sources = tuple(sources)
        self._t_ns = base.t_ns[order]
        self._numbers = entries.sources[order]
        self._places = entries.places[order]
        self._close = close
        self.start_ns = int(self._t_ns[0]) if len(order) else 0
        self.end_ns = int(self._t_ns[-1]) if len(order) else 0
        self.epoch_ns = base.epoch_ns
        self.topics: Mapping[str, Topic] = {}
        silences: list[str] = []
        by_source = np.argsort(self._numbers, kind="stable")
        bounds = np.searchsorted(self._numbers[by_source], np.arange(len(self._sources) + 1))
        for k, source in enumerate(self._sources):
            times = self._t_ns[by_source[bounds[k] : bounds[k + 1]]]
            ends = (int(times[0]), int(times[-1])) if len(times) else (None, None)
            self.topics[source.name] = Topic(source.name, source.schema, source.fields, len(times), *ends)
            silences += gaps(source.name, times)
        self.remarks = (*remarks, *base.remarks, *shortened(silences))

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Yield data, as `Log.read`."""
        first = 0 if start_ns is None else int(np.searchsorted(self._t_ns, start_ns, "left"))
        last = len(self._t_ns) if end_ns is None else int(np.searchsorted(self._t_ns, end_ns, "right"))
        numbers, places, times = (a[first:last] for a in (self._numbers, self._places, self._t_ns))
        if topics is not None:
            wanted = np.array([source.name in topics for source in self._sources], bool)
            chosen = np.flatnonzero(wanted[numbers]) if len(numbers) else np.zeros(0, np.intp)
            numbers, places, times = numbers[chosen], places[chosen], times[chosen]
        return self._read(numbers, places, times)

    def _read(self, numbers: Any, places: Any, times: Any) -> Iterator[Datum]:
        names = [source.name for source in self._sources]
        decoders = [source.decode for source in self._sources]
        step = 1 << 16
        make = tuple.__new__  # calling Datum(...) takes twice as long
        with foreign(self.path, "an entry cannot be read"):
            for k in range(0, len(numbers), step):
                # One block at a time becomes Python integers, which take several times the memory of the arrays.
                block = (each[k : k + step].tolist() for each in (numbers, places, times))
                for number, place, t_ns in zip(*block, strict=True):
                    value = decoders[number](place)
                    if value is not None:
                        yield make(Datum, (t_ns, names[number], value))

    def close(self) -> None:
        """Close the file, as `Log.close`."""
        self._close()
