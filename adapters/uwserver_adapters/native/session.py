"""What one client said and is owed. Knows neither socket nor encoding: requests in, answers into the outbox."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

from uwserver.adapter import UNANSWERED, Conversation, Owed
from uwserver.ports import Fault, Json, Progress, Reply
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import RequestId
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.shares import Subscription

log = logging.getLogger(__name__)

SUBSCRIPTIONS = 256


class Allowance(NamedTuple):
    """What one client may hold.

    Attributes:
        subscriptions: at a time.
        unanswered: commands and calls that wait for the world.
    """

    subscriptions: int = SUBSCRIPTIONS
    unanswered: int = UNANSWERED


class Session:
    """One client, from its first bytes on.

    Args:
        serial: counts the clients of this adapter.
        codec, outbox, fanout: what it speaks, where its answers wait, where its samples come from.
        allowance: what it may hold.
        wake: said after an answer that came later than its request.

    Attributes:
        conversation: what it asked of the world.
        admitted: it may ask for more than `hello`.
        subscriptions: by serial.
    """

    def __init__(
        self,
        serial: int,
        codec: Codec,
        outbox: Outgoing,
        fanout: Fanout,
        wake: Callable[[], None],
        allowance: Allowance = Allowance(),  # noqa: B008
    ) -> None:
        self.serial = serial
        self.codec = codec
        self.outbox = outbox
        self.fanout = fanout
        self.allowance = allowance
        self.context = fanout.context
        self.conversation = Conversation(self.context, str(serial), Owed(allowance.unanswered))
        self.admitted = False
        self.greeted = False
        self.subscriptions: dict[int, Subscription] = {}
        self.subscribed = 0
        self.closed = False
        self._wake = wake

    def admit(self) -> None:
        """Let it take part in what the world says."""
        self.admitted = True
        self.fanout.admit(self)

    def greet(self, name: str | None) -> None:
        """The client's valid `hello`.

        Raises:
            Refused: the barrier does not take that name.
        """
        if name is not None:
            self.conversation.join(name)
            self.conversation.source = f"{self.serial} ({name})"
        self.greeted = True
        if not self.admitted:
            self.admit()

    @property
    def is_owed(self) -> bool:
        """Whether anything may still come for it without a further request."""
        return self.conversation.owed.count > 0 or bool(self.subscriptions)

    # -- answers --------------------------------------------------------------------------------------------------------------------

    def reply(self, request: RequestId, result: object) -> None:
        """Answer a request; a notification gets none."""
        if request is None or self.closed:
            return
        try:
            message = self.codec.reply(request, result)
        except (TypeError, ValueError, OverflowError) as error:
            log.exception("a result has no %s encoding", self.codec.encoding.name)
            fault = Fault(
                "internal", f"the result has no {self.codec.encoding.name} encoding ({error}): please report this"
            )
            self.refuse(request, fault)
            return
        largest = self.outbox.largest
        if largest is not None and len(message) > largest:
            text = f"the answer has {len(message)} bytes, a datagram holds {largest}: ask for less (a narrower pattern), or ask by TCP"
            self.refuse(request, Fault("too_large", text))
            return
        self.outbox.put_reply(message)

    def refuse(self, request: RequestId, fault: Fault) -> None:
        """Tell a failure, also that of a notification."""
        if not self.closed:
            self.context.stats.errors += 1
            self.outbox.put_reply(self.codec.error(request, fault))

    def answer(self, request: RequestId, reply: Reply, result: dict[str, Json]) -> None:
        """Tell what the world says to a request, some time after it came."""
        if reply.fault is not None:
            self.refuse(request, reply.fault)
        else:
            self.reply(request, result)
        self._wake()

    def progress(self, request: RequestId, progress: Progress) -> None:
        """Tell how far a call is."""
        if request is not None:
            self.outbox.put_reply(self.codec.progress(request, progress))
        self._wake()

    def close(self) -> None:
        """The client is gone. What it commanded stands; nobody waits for its long-running calls any more, so they end."""
        self.closed = True
        self.fanout.dismiss(self)
        self.conversation.close()

    def step_back(self) -> None:
        """The client can grant no further tick: others must not wait for it."""
        self.conversation.leave()
