"""What one client said and is owed. Knows neither socket nor encoding: requests in, answers into the outbox."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

from uwserver.ports import Fault, Progress, Refused, Reply
from uwserver_adapters.sockets.codec import Codec
from uwserver_adapters.sockets.encoding import RequestId
from uwserver_adapters.sockets.fanout import Fanout, Subscription
from uwserver_adapters.sockets.outbox import Outgoing
from uwserver_adapters.sockets.requests import Request

_log = logging.getLogger(__name__)

UNANSWERED = 1024
SUBSCRIPTIONS = 256


class Allowance(NamedTuple):
    """What one client may hold.

    Attributes:
        subscriptions: at a time.
        unanswered: commands and calls that wait for the world.
    """

    subscriptions: int = SUBSCRIPTIONS
    unanswered: int = UNANSWERED


class Unfinished(NamedTuple):
    """A call under way. `cancel` ends it, True when it was not too late."""

    cancel: Callable[[], bool]
    long_running: bool


class Session:
    """One client, from its first bytes on.

    Args:
        serial: counts the clients of this adapter.
        codec, outbox, fanout: what it speaks, where its answers wait, where its samples come from.
        allowance: what it may hold.
        wake: said after an answer that came later than its request.

    Attributes:
        name: as the client called itself.
        source: who it is among the clients of this adapter.
        admitted: it may ask for more than `hello`.
        subscriptions: by serial.
        leave: takes it out of the lockstep barrier.
        unfinished: calls under way, by the id of their request (or an object of its own where that had none).
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
        self.name = ""
        self.source = str(serial)
        self.admitted = False
        self.greeted = False
        self.subscriptions: dict[int, Subscription] = {}
        self.subscribed = 0
        self.leave: Callable[[], None] | None = None
        self.unfinished: dict[object, Unfinished] = {}
        self.unanswered = 0
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
            self.leave = self.context.join(name)
            self.name = name
            self.source = f"{self.serial} ({name})"
        self.greeted = True
        if not self.admitted:
            self.admit()

    @property
    def is_owed(self) -> bool:
        """Whether anything may still come for it without a further request."""
        return self.unanswered > 0 or bool(self.subscriptions)

    # -- answers --------------------------------------------------------------------------------------------------------------------

    def reply(self, request: RequestId, result: object) -> None:
        """Answer a request; a notification gets none."""
        if request is None or self.closed:
            return
        try:
            message = self.codec.reply(request, result)
        except (TypeError, ValueError, OverflowError) as error:
            _log.exception("a result has no %s encoding", self.codec.encoding.name)
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

    def expect(self, request: Request, shape: Callable[[Reply], object]) -> Callable[[Reply | Progress], None]:
        """Take note that the world owes an answer; the function returned receives it. `shape` makes the result of a Reply.

        Raises:
            Refused: too many are unanswered already.
        """
        if self.unanswered >= self.allowance.unanswered:
            raise Refused(
                "overload", f"{self.unanswered} commands and calls wait for their answer: wait for some of them"
            )
        self.unanswered += 1

        def answer(outcome: Reply | Progress) -> None:
            if isinstance(outcome, Progress):
                if request.id is not None and not self.closed:
                    self.outbox.put_reply(self.codec.progress(request.id, outcome))
            else:
                self.unanswered -= 1
                if outcome.fault is not None:
                    self.refuse(request.id, outcome.fault)
                else:
                    self.reply(request.id, shape(outcome))
            self._wake()

        return answer

    def close(self) -> None:
        """The client is gone. What it commanded stands; nobody waits for its long-running calls any more, so they end."""
        self.closed = True
        self.fanout.dismiss(self)
        self.step_back()
        for call in list(self.unfinished.values()):
            if call.long_running:
                call.cancel()

    def step_back(self) -> None:
        """The client can grant no further tick: others must not wait for it."""
        if self.leave is not None:
            self.leave()
            self.leave = None
