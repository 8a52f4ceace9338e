"""What every adapter has: its table, its context, and its refusals.

An adapter refuses scenarios that it cannot serve, and peers. Refused peers are counted in the status, and logged once a minute per cause.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Generic, TypeVar

from uwserver.adapter.contract import AdapterContext, AdapterStats, AdapterTable
from uwserver.ports import Json
from uwserver.ports.checks import LONGEST_WORD, find, suggestion

log = logging.getLogger(__name__)

WORD_LIMIT = LONGEST_WORD
"""Longest name for which a similar one is looked up, characters."""
TELL_S = 60.0
"""Wall time for which a cause that was logged is only counted."""
CAUSES = 256
"""Causes that are counted separately; further causes are "other"."""
check_path = find
"""Refuses an unknown port or service path with a text that says what there is."""
did_you_mean = suggestion
"""Returns `` (did you mean "x"?)`` for a word that is like a known one, or ""."""

C = TypeVar("C", bound=AdapterTable)


class CannotServe(Exception):
    """Raised by `Adapter.run` if the adapter's table, the world and this machine do not fit; the text says what to change."""


class Refusals:
    """Counts refusals by cause. Each cause is logged once a minute at most, with the count since the last line.

    Args:
        name: name of the adapter, for the log.
        stats: counters of the adapter; ``details["refused"]`` maps each cause to its count.
        steady: a clock that never jumps, s, such as that of the loop.
    """

    def __init__(self, name: str, stats: AdapterStats, steady: Callable[[], float]) -> None:
        self._name = name
        self._stats = stats
        self._steady = steady
        self._counts: dict[str, Json] = {}
        self._logged: dict[str, tuple[float, int]] = {}

    def note(self, cause: str, text: str) -> bool:
        """Count a refusal; return whether it was logged now. `cause` is one of a few fixed texts, never a text of a peer."""
        if cause not in self._counts and len(self._counts) >= CAUSES:
            cause = "other"
        known = self._counts.get(cause, 0)
        assert isinstance(known, int)
        self._counts[cause] = known + 1
        self._stats.details["refused"] = self._counts
        now = self._steady()
        logged_at, logged = self._logged.get(cause, (now - TELL_S, 0))
        if now - logged_at < TELL_S:
            return False
        self._logged[cause] = (now, known + 1)
        more = f" ({known - logged} more since the last such line)" if known > logged else ""
        text = f"{text[:500]}{more}"
        log.warning(
            "%s refused (%s): %s. It is logged once a minute and counted in world/status", self._name, cause, text
        )
        return True

    def note_error(self, cause: str, text: str) -> bool:
        """Count a refusal that is an error of the adapter too; otherwise like `note`."""
        self._stats.count_error(text)
        return self.note(cause, text)


class AdapterBase(Generic[C]):
    """Keeps what an adapter is constructed with. An adapter need not derive from this class; the contract is `Adapter`.

    Args:
        config: the adapter's table.
        context: what it may use of the server.

    Attributes:
        config, context: as given.
        refusals: counts and logs what the adapter refuses.
    """

    def __init__(self, config: C, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
