"""The subscriptions of all readers together."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Container, Sequence
from typing import Any, TypeVar

from uwserver.ports.thinning import WHOLE, Thinned, Thinning

log = logging.getLogger(__name__)

T = TypeVar("T")


class Wanted:
    """The ports of which samples are made: those that a reader subscribes to, and those that the readers do not know of yet.

    So no sample of a new body is lost while readers hear of its ports. Never changed, as the simulation thread reads it.

    Attributes:
        known: all ports that the readers know of.
        jumps: how often the time was set, as far as the readers know.
        thinned: ports of which not all samples are needed; valid while ports and times are those that the readers know of.
    """

    def __init__(self, paths: Collection[str], known: Container[str], jumps: int = 0, thinned: Thinned = WHOLE) -> None:
        """Take the paths that readers subscribe to."""
        self._paths, self.known, self.jumps, self.thinned = paths, known, jumps, thinned

    def __contains__(self, path: object) -> bool:
        return path in self._paths or path not in self.known


def together(readers: Sequence[object]) -> frozenset[str] | None:
    """Return the paths that readers subscribe to; None for all, as a reader without `wanted` reads all."""
    wanted = [_wanted_by(reader) for reader in readers]
    some = [paths for paths in wanted if paths is not None]
    return frozenset().union(*some) if len(some) == len(wanted) else None


def wants_any(reader: object) -> bool:
    """Return whether a reader subscribes to any samples."""
    return _wanted_by(reader) != frozenset()


def thinned_together(readers: Sequence[object], paths: Collection[str]) -> Thinned:
    """Return the ports of which no reader needs all samples, with their decimations."""
    thinned: dict[str, frozenset[Thinning]] = {}
    whole: set[str] = set()
    for reader in readers:
        wanted, less = (
            _wanted_by(reader) or frozenset(),
            _attribute(reader, "thinned", dict[str, Collection[Thinning]]) or WHOLE,
        )
        whole |= wanted - less.keys()
        for path in wanted & less.keys():
            thinned[path] = thinned.get(path, frozenset()).union(less[path])
    return {path: some for path, some in thinned.items() if some and path in paths and path not in whole}


def _wanted_by(reader: object) -> frozenset[str] | None:
    return _attribute(reader, "wanted", frozenset[str])


def _attribute(reader: object, name: str, kind: Callable[[Any], T]) -> T | None:
    """Return an attribute of a reader as another kind of collection; None if it has none, or if it cannot be read."""
    try:
        value = getattr(reader, name, None)
        return None if value is None else kind(value)
    except Exception:  # A fault of one reader must not reach the others.
        log.exception('"%s" of a reader cannot be read: it gets all samples', name)
        return None
