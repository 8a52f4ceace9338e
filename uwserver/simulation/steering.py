"""What is wanted of the clock, carried out between two ticks: each client in turn, and a pause before all that its client asked."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

from uwserver.ports import OnReply
from uwserver.simulation.mailbox import client_of
from uwserver.simulation.turns import Turns


class Steered(NamedTuple):
    """An action that waits; `on_reply` is of the request that a pause withdraws, None where it must be carried out."""

    action: Callable[[], None]
    on_reply: OnReply | None = None


class Steering(Turns[Steered]):
    """Actions that wait for the simulation thread, which takes them. Thread-safe.

    Args:
        wake: set with each.
    """

    def __init__(self, wake: threading.Event) -> None:
        super().__init__()
        self._wake = wake

    def add(
        self, action: Callable[[], None], source: str = "", on_reply: OnReply | None = None, *, always: bool = False
    ) -> None:
        """Let an action wait.

        Args:
            action: to be carried out.
            source: who wants it.
            on_reply: of a request that a later pause withdraws.
            always: as for `Turns.put`, whose `Refused` may be raised.
        """
        self.put(client_of(source), Steered(action, on_reply), always=always)
        self._wake.set()

    def stop(self, action: Callable[[], None], source: str, on_reply: OnReply) -> list[OnReply]:
        """Let a pause wait, before all that its client asked. May raise as `Turns.overtake`.

        Returns who must be told that his request was withdrawn.
        """
        older = self.overtake(client_of(source), Steered(action, on_reply), lambda each: each.on_reply is not None)
        self._wake.set()
        return [each.on_reply for each in older if each.on_reply is not None]
