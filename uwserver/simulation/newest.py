"""The newest delivered sample of each port, made when somebody asks for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter

from uwserver.ports import Sample
from uwserver.ports.told import Log, Told

_port = attrgetter("port")


class Newest(Mapping[str, Sample]):
    """By path of the port."""

    def __init__(self) -> None:
        self._places: dict[str, Sample | Told] = {}
        self._log: Log | None = None

    def put(self, samples: Sequence[Sample]) -> None:
        """These were delivered, in this order."""
        if isinstance(samples, Told):
            if samples.log is not self._log:
                self._leave(samples.log)
            self._places.update(dict.fromkeys(samples.ports, samples))
        else:
            self._places.update(zip(map(_port, samples), samples, strict=True))

    def _leave(self, log: Log) -> None:
        """Another log begins: what is still the newest of the one before the last must not keep all of that."""
        for path, place in self._places.items():
            if isinstance(place, Told) and place.log is not self._log:
                self._places[path] = place.newest(path)
        self._log = log

    def keep(self, holds: Callable[[str], bool]) -> None:
        """Forget the others than those of ports for which this holds."""
        self._places = {path: place for path, place in self._places.items() if holds(path)}

    def clear(self) -> None:
        """Forget all."""
        self._places.clear()

    def __getitem__(self, path: str) -> Sample:
        place = self._places[path]
        return place.newest(path) if isinstance(place, Told) else place

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
