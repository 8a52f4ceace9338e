"""A log whose every entry was found once: what most formats need, as they have no index of their own."""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Datum, Kind, LogError, LogField, Topic
from uwserver.logfiles.timebase import Timebase, gaps, shortened

Decode = Callable[[int], Mapping[str, object] | None]
"""Where an entry stands -> its fields; None when it cannot be read. May raise any error of a parser."""


class Source(NamedTuple):
    """One topic of an indexed log: its name, the name of its type, its fields, and what reads an entry."""

    name: str
    schema: str
    fields: tuple[LogField, ...]
    decode: Decode


class Entries(NamedTuple):
    """All entries in the order of the file: number of the source, and where it stands."""

    sources: NDArray[np.int32]
    places: NDArray[np.int64]


def mapped(path: Path) -> mmap.mmap:
    """The bytes of a file, to be looked at in any order.

    Raises:
        OSError: it cannot be opened.
        LogError: it is empty.
    """
    with path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            raise LogError(f"{path}: the file is empty")
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


class IndexedLog:
    """A `Log` made of an index.

    Args:
        path, kind: as in `Log`.
        sources: the topics.
        entries: what is in the file.
        base: the time base of the entries.
        remarks: of whoever made the index; those about time are added.
        close: closes the file.
    """

    def __init__(
        self,
        path: Path,
        kind: Kind,
        sources: Sequence[Source],
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
        silent: list[str] = []
        by_source = np.argsort(self._numbers, kind="stable")
        bounds = np.searchsorted(self._numbers[by_source], np.arange(len(self._sources) + 1))
        for k, source in enumerate(self._sources):
            times = self._t_ns[by_source[bounds[k] : bounds[k + 1]]]
            ends = (int(times[0]), int(times[-1])) if len(times) else (None, None)
            self.topics[source.name] = Topic(source.name, source.schema, source.fields, len(times), *ends)
            silent += gaps(source.name, times)
        self.remarks = (*remarks, *base.remarks, *shortened(silent))

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """As in `Log`."""
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
        make = tuple.__new__  # Datum(...) itself takes twice as long
        with foreign(self.path, "an entry cannot be read"):
            for k in range(0, len(numbers), step):
                part = slice(k, k + step)
                piece = zip(numbers[part].tolist(), places[part].tolist(), times[part].tolist(), strict=True)
                for number, place, t_ns in piece:
                    value = decoders[number](place)
                    if value is not None:
                        yield make(Datum, (t_ns, names[number], value))

    def close(self) -> None:
        """As in `Log`."""
        self._close()
