"""How an adapter says no: to a scenario that it cannot serve, and to peers, once a minute and cause in the log, and counted in the status."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from uwserver.adapter.contract import AdapterStats
from uwserver.ports import Json
from uwserver.ports.checks import LONGEST_WORD, suggestion

log = logging.getLogger(__name__)

WORD_LIMIT = LONGEST_WORD
"""Longest name that is looked for, characters."""
TELL_S = 60.0
"""Wall time for which a cause that was logged is only counted."""
CAUSES = 256
"""Causes that are told apart; all further ones are "other"."""


class CannotServe(Exception):
    """Raised by `Adapter.run` where the adapter's table, the world and this machine do not fit; the text says what to change."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`` (did you mean "x"?)`` or nothing."""
    return suggestion(word, known)


class Refusals:
    """Counts what was refused by cause; each cause is logged once a minute at most, with the count since it last was.

    Args:
        name: of the adapter, for the log.
        stats: ``details["refused"]`` maps each cause to its count.
        steady: a clock that never jumps, s (that of the loop).
    """

    def __init__(self, name: str, stats: AdapterStats, steady: Callable[[], float]) -> None:
        self._name = name
        self._stats = stats
        self._steady = steady
        self._counts: dict[str, Json] = {}
        self._told: dict[str, tuple[float, int]] = {}

    def note(self, cause: str, text: str) -> bool:
        """One more. `cause` is one of few fixed texts, never what a peer said. Returns whether it was logged now."""
        if cause not in self._counts and len(self._counts) >= CAUSES:
            cause = "other"
        known = self._counts.get(cause, 0)
        assert isinstance(known, int)
        self._counts[cause] = known + 1
        self._stats.details["refused"] = self._counts
        now = self._steady()
        told_at, told = self._told.get(cause, (now - TELL_S, 0))
        is_told = now - told_at >= TELL_S
        if is_told:
            self._told[cause] = (now, known + 1)
            more = f" ({known - told} more since the last such line)" if known > told else ""
            text = f"{text[:500]}{more}"
            log.warning(
                "%s refused (%s): %s. It is told once a minute and counted in world/status", self._name, cause, text
            )
        return is_told
