"""The newest delivered sample of each port, made on access."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter

from uwserver.ports import Sample
from uwserver.ports.sample_batch import SampleBatch, SampleLog

_port = attrgetter("port")


class Newest(Mapping[str, Sample]):
    """The newest samples by path of the port."""

    def __init__(self) -> None:
        self._places: dict[str, Sample | SampleBatch] = {}
        self._log: SampleLog | None = None

    def put(self, samples: Sequence[Sample]) -> None:
        """Take samples that were delivered, in this order."""
        if isinstance(samples, SampleBatch):
            if samples.log is not self._log:
                self._leave(samples.log)
            self._places.update(dict.fromkeys(samples.ports, samples))
        else:
            self._places.update(zip(map(_port, samples), samples, strict=True))

    def _leave(self, log: SampleLog) -> None:
        """Begin to use another log. Samples that are still the newest from the log before the last one are copied, so that they do not keep
        that log alive."""
        for path, place in self._places.items():
            if isinstance(place, SampleBatch) and place.log is not self._log:
                self._places[path] = place.newest(path)
        self._log = log

    def keep(self, holds: Callable[[str], bool]) -> None:
        """Forget the samples of ports for which `holds` returns false."""
        self._places = {path: place for path, place in self._places.items() if holds(path)}

    def clear(self) -> None:
        """Forget all samples."""
        self._places.clear()

    def __getitem__(self, path: str) -> Sample:
        place = self._places[path]
        return place.newest(path) if isinstance(place, SampleBatch) else place

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
