"""The subscriptions of all readers together."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Container, Sequence
from typing import Any, TypeVar

from uwserver.ports.decimation import EVERY_SAMPLE, Decimation, Decimations

log = logging.getLogger(__name__)

T = TypeVar("T")


class Subscriptions:
    """The ports of which samples are made: those that a reader subscribes to, and those that the readers do not know of yet.

    So no sample of a new body is lost while readers hear of its ports. Never changed, as the simulation thread reads it.

    Attributes:
        known: all ports that the readers know of.
        jumps: how often the time was set, as far as the readers know.
        decimations: ports of which not all samples are needed; valid while ports and times are those that the readers know of.
    """

    def __init__(
        self, paths: Collection[str], known: Container[str], jumps: int = 0, decimations: Decimations = EVERY_SAMPLE
    ) -> None:
        """Take the paths that readers subscribe to."""
        self._paths, self.known, self.jumps, self.decimations = paths, known, jumps, decimations

    def __contains__(self, path: object) -> bool:
        return path in self._paths or path not in self.known


def merged(readers: Sequence[object]) -> frozenset[str] | None:
    """Return the paths that readers subscribe to; None for all, as a reader without `subscriptions` reads all."""
    subscriptions = [_subscriptions_of(reader) for reader in readers]
    some = [paths for paths in subscriptions if paths is not None]
    return frozenset().union(*some) if len(some) == len(subscriptions) else None


def subscribes_any(reader: object) -> bool:
    """Return whether a reader subscribes to any samples."""
    return _subscriptions_of(reader) != frozenset()


def merged_decimations(readers: Sequence[object], paths: Collection[str]) -> Decimations:
    """Return the ports of which no reader needs all samples, with their decimations."""
    decimations: dict[str, frozenset[Decimation]] = {}
    whole: set[str] = set()
    for reader in readers:
        subscriptions, less = (
            _subscriptions_of(reader) or frozenset(),
            _attribute(reader, "decimations", dict[str, Collection[Decimation]]) or EVERY_SAMPLE,
        )
        whole |= subscriptions - less.keys()
        for path in subscriptions & less.keys():
            decimations[path] = decimations.get(path, frozenset()).union(less[path])
    return {path: some for path, some in decimations.items() if some and path in paths and path not in whole}


def _subscriptions_of(reader: object) -> frozenset[str] | None:
    return _attribute(reader, "subscriptions", frozenset[str])


def _attribute(reader: object, name: str, kind: Callable[[Any], T]) -> T | None:
    """Return an attribute of a reader as another kind of collection; None if it has none, or if it cannot be read."""
    try:
        value = getattr(reader, name, None)
        return None if value is None else kind(value)
    except Exception:  # A fault of one reader must not reach the others.
        log.exception('"%s" of a reader cannot be read: it gets all samples', name)
        return None
