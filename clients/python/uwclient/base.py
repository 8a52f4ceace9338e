"""The part that both clients have in common: access to the state of the session."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping

from uwclient.errors import CallRefused
from uwclient.ports import Event, Port, Service
from uwclient.session import Session, Settings


class SessionView:
    """The part of a client that needs no input and output.

    Attributes:
        reconnects: how often a lost connection was renewed.
    """

    def __init__(self, settings: Settings) -> None:
        self.reconnects = 0
        self._session = Session(settings)
        self._timeout = settings.timeout
        self._closed = False

    @property
    def ports(self) -> Mapping[str, Port]:
        """Ports by path, from the last `describe`, which is also called on connecting and reconnecting."""
        return self._session.description.ports

    @property
    def services(self) -> Mapping[str, Service]:
        """Services by path, from the last `describe`."""
        return self._session.description.services

    @property
    def events(self) -> deque[Event]:
        """The last 256 events that were received, oldest first; take them out with popleft()."""
        return self._session.events

    @property
    def refusals(self) -> deque[CallRefused]:
        """The last 256 failures of `send_nowait`, oldest first; take them out with popleft()."""
        return self._session.refusals

    @property
    def dropped(self) -> int:
        """Number of samples that this client threw away because more than 4096 were unread."""
        return self._session.dropped

    def _limit(self, timeout: float | None) -> tuple[float, float]:
        """Return the time limit, wall s, and the resulting deadline on the monotonic clock."""
        limit = self._timeout if timeout is None else timeout
        return limit, time.monotonic() + limit
