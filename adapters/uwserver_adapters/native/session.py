"""One client: its subscriptions, its unanswered requests, and its answers. Knows neither socket nor encoding."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable
from typing import NamedTuple

from uwserver.adapter import UNANSWERED, Conversation, InFlightLimit
from uwserver.ports import Fault, Json, Progress, Reply
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.native.messages import Notice, RequestId, ResultMessage, error_message
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.shares import Subscription

log = logging.getLogger(__name__)

SUBSCRIPTIONS = 256


class Allowance(NamedTuple):
    """The limits of one client.

    Attributes:
        subscriptions: subscriptions at a time.
        unanswered: commands and calls that may wait for the world.
    """

    subscriptions: int = SUBSCRIPTIONS
    unanswered: int = UNANSWERED


class Session:
    """One client, from its first bytes on.

    Args:
        serial: number of the client among those of this adapter.
        codec: encodes its answers.
        outbox: where its answers wait.
        fanout: gives it samples and events.
        wake: called after an answer that comes later than its request.
        allowance: its limits.

    Attributes:
        conversation: its commands and calls.
        admitted: whether it may ask for more than `hello`.
        greeted: whether it has said a valid `hello`.
        subscriptions: its subscriptions, by serial number.
        serials: the serial numbers of its next subscriptions.
        closed: whether it has gone.
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
        self.conversation = Conversation(self.context, str(serial), InFlightLimit(allowance.unanswered))
        self.admitted = False
        self.greeted = False
        self.subscriptions: dict[int, Subscription] = {}
        self.serials = itertools.count(1)
        self.closed = False
        self._wake = wake

    def admit(self) -> None:
        """Let the client use all methods, and send it events."""
        self.admitted = True
        self.fanout.admit(self)

    def greet(self, name: str | None) -> None:
        """Take the client's valid `hello`.

        Raises:
            Refused: the lockstep barrier does not take this name.
        """
        if name is not None:
            self.conversation.join(name)
            self.conversation.source = f"{self.serial} ({name})"
        self.greeted = True
        if not self.admitted:
            self.admit()

    @property
    def has_pending_output(self) -> bool:
        """Whether the client may still get something without a further request."""
        return self.conversation.in_flight.count > 0 or bool(self.subscriptions)

    # -- answers --------------------------------------------------------------------------------------------------------------------

    def reply(self, request: RequestId, result: object) -> None:
        """Answer a request. A notification gets no answer."""
        if request is None or self.closed:
            return
        try:
            message = self.codec.message(ResultMessage(request, result))
        except (TypeError, ValueError, OverflowError) as error:
            log.exception("a result has no %s encoding", self.codec.encoding.name)
            text = f"the result has no {self.codec.encoding.name} encoding ({error}): please report this"
            self.refuse(request, Fault("internal", text))
            return
        largest = self.outbox.largest
        if largest is not None and len(message) > largest:
            text = f"the answer has {len(message)} bytes, a datagram holds {largest}: ask for less (a narrower pattern), or ask by TCP"
            self.refuse(request, Fault("too_large", text))
            return
        self.outbox.put_reply(message)

    def refuse(self, request: RequestId, fault: Fault) -> None:
        """Send an error, also for a notification."""
        if not self.closed:
            self.context.stats.errors += 1
            self.outbox.put_reply(self.codec.message(error_message(request, fault)))

    def answer(self, request: RequestId, reply: Reply, result: dict[str, Json]) -> None:
        """Answer a request with what the world replied, some time after the request came."""
        if reply.fault is not None:
            self.refuse(request, reply.fault)
        else:
            self.reply(request, result)
        self._wake()

    def progress(self, request: RequestId, progress: Progress) -> None:
        """Send the progress of a call."""
        if request is not None:
            params = {"id": request, "fraction": progress.fraction, "t_ns": progress.t_ns}
            self.outbox.put_reply(self.codec.message(Notice("progress", params)))
        self._wake()

    def close(self) -> None:
        """End the session when the client has gone. Its commands stand; its long-running calls end, because nobody waits for them."""
        self.closed = True
        self.fanout.dismiss(self)
        self.conversation.close()
