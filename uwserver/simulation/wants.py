"""What all who read samples want together."""

from __future__ import annotations

import logging
from collections.abc import Collection, Container, Sequence

from uwserver.ports.thinning import WHOLE, Thinned, Thinning

log = logging.getLogger(__name__)


class Wanted:
    """Ports of which samples are made: those that somebody reads, and those of which the readers have not heard yet.

    So nothing of a body that just came is lost while they find out about it. Never changed: the simulation thread looks at it.

    Attributes:
        known: all that the readers have heard of.
        jumps: how often they have heard that the time was set.
        thinned: ports of which not all samples are read; while the ports and the times are those that the readers have heard of.
    """

    def __init__(self, paths: Collection[str], known: Container[str], jumps: int = 0, thinned: Thinned = WHOLE) -> None:
        """paths: of those that are read."""
        self._paths, self.known, self.jumps, self.thinned = paths, known, jumps, thinned

    def __contains__(self, path: object) -> bool:
        return path in self._paths or path not in self.known


def together(readers: Sequence[object]) -> frozenset[str] | None:
    """What they want; None for all, as one wants who does not say."""
    wanted = [_wanted_by(reader) for reader in readers]
    some = [paths for paths in wanted if paths is not None]
    return frozenset().union(*some) if len(some) == len(wanted) else None


def wants_any(reader: object) -> bool:
    """Whether it wants samples at all."""
    return _wanted_by(reader) != frozenset()


def thinned_together(readers: Sequence[object], paths: Collection[str]) -> Thinned:
    """Of which of these nobody wants all samples."""
    thinned: dict[str, frozenset[Thinning]] = {}
    whole: set[str] = set()
    for reader in readers:
        wanted, less = _wanted_by(reader) or frozenset(), _thinned_by(reader)
        whole |= wanted - less.keys()
        for path in wanted & less.keys():
            thinned[path] = thinned.get(path, frozenset()).union(less[path])
    return {path: some for path, some in thinned.items() if some and path in paths and path not in whole}


def _thinned_by(reader: object) -> Thinned:
    try:
        return dict(getattr(reader, "thinned", WHOLE))
    except Exception:  # one reader's fault must not reach the others
        log.exception("what is enough for a reader cannot be told; it gets all")
        return WHOLE


def _wanted_by(reader: object) -> frozenset[str] | None:
    try:
        wanted: Collection[str] | None = getattr(reader, "wanted", None)
        return None if wanted is None else frozenset(wanted)
    except Exception:  # one reader's fault must not reach the others
        log.exception("what a reader wants cannot be told; it gets all")
        return None
