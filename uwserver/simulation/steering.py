"""Actions on the clock that wait for the time between two ticks. Clients are served in turn; a pause comes before all other requests of its
client."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from uwserver.ports import OnReply
from uwserver.simulation.fair_queue import FairQueue
from uwserver.simulation.mailbox import client_of


class Steered(NamedTuple):
    """An action that waits. `on_reply` belongs to a request that a pause withdraws; it is None if the action must be carried out."""

    action: Callable[[], None]
    on_reply: OnReply | None = None


class Steering(FairQueue[Steered]):
    """Actions that wait for the simulation thread, which takes them. Thread-safe."""

    def add(
        self, action: Callable[[], None], source: str = "", on_reply: OnReply | None = None, *, always: bool = False
    ) -> None:
        """Queue an action.

        Args:
            action: to be carried out.
            source: the client.
            on_reply: of a request that a later pause withdraws.
            always: as for `FairQueue.put`, whose `Refused` may be raised.
        """
        self.put(client_of(source), Steered(action, on_reply), always=always)

    def stop(self, action: Callable[[], None], source: str, on_reply: OnReply) -> list[OnReply]:
        """Queue a pause before all requests of its client. May raise as `FairQueue.overtake`.

        Returns the reply functions of the requests that are withdrawn; the caller has to answer them.
        """
        older = self.overtake(client_of(source), Steered(action, on_reply), lambda each: each.on_reply is not None)
        return [each.on_reply for each in older if each.on_reply is not None]
