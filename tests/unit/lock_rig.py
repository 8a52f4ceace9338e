"""Locks that a test puts in the place of others, to see without luck whether they are taken."""

from __future__ import annotations

import threading


class Keeper:
    """A lock that keeps attributes of its owner: they are there only while it is held, so who touches them without it fails."""

    def __init__(self, owner: object, *names: str) -> None:
        self._owner = vars(owner)
        self._names = names
        self._kept: dict[str, object] = {}
        self.__exit__()

    def __enter__(self) -> None:
        assert self._kept, "it is held already"
        self._owner.update(self._kept)
        self._kept = {}

    def __exit__(self, *failure: object) -> None:
        self._kept = {name: self._owner.pop(name) for name in self._names}


class Door:
    """A lock that tells when somebody waits for it.

    Attributes:
        waited: set by whoever finds it taken.
    """

    def __init__(self) -> None:
        self.waited = threading.Event()
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            self.waited.set()
            self._lock.acquire()

    def __exit__(self, *failure: object) -> None:
        self._lock.release()
