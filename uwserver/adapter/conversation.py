"""The commands and calls of one peer, each with one answer, within limits, until the peer leaves.

An adapter that begins all commands and calls of a peer through a `Conversation` need not keep track of them. When the peer leaves, its
long-running calls are cancelled. A call that takes too long is cancelled, and the peer is told so. No peer can make the server remember more
than a limit.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from uwserver.adapter.contract import AdapterContext
from uwserver.ports import Fault, Progress, Refused, Reply
from uwserver.ports.crossing import is_stop

UNANSWERED = 1024
"""Commands and calls that may wait for the world."""
STOPS = 16
"""Further calls that may wait if they stop something."""

OnAnswer = Callable[[Reply], None]
"""Gets the one answer on the loop."""
OnProgress = Callable[[Progress], None]


class InFlightLimit:
    """Counts the commands and calls that wait for the world, of one conversation or of several that share a limit.

    Attributes:
        limit: how many may wait.
        count: how many wait.
    """

    def __init__(self, limit: int = UNANSWERED) -> None:
        self.limit = limit
        self.count = 0

    def add(self, is_stop: bool = False) -> None:
        """Count one more. For calls that stop something the limit is higher by `STOPS`.

        Raises:
            Refused: too many wait already.
        """
        if self.count >= self.limit + (STOPS if is_stop else 0):
            raise Refused("overload", f"{self.count} commands and calls wait for their answer: wait for some of them")
        self.count += 1


class Conversation:
    """The commands and calls of one peer. Loop thread.

    Args:
        context: the context of the adapter.
        source: name of the peer among the peers of this adapter, for the world.
        in_flight: counts what waits; by default the conversation has a limit of its own.
        queue: name of the queue in which its commands and calls wait for their tick, for several conversations that share a source.

    Attributes:
        source: the given name; it may be changed when the peer has said its own name.
        client: name with which the peer joined the lockstep barrier; "" before.
        in_flight: the count of what waits.
        is_closed: whether the peer has left; then nothing is answered any more.
    """

    def __init__(
        self, context: AdapterContext, source: str, in_flight: InFlightLimit | None = None, queue: str = ""
    ) -> None:
        self.source = source
        self.client = ""
        self.in_flight = in_flight or InFlightLimit()
        self.is_closed = False
        self._context = context
        self._queue = queue
        self._is_half_closed = False
        self._leave: Callable[[], None] | None = None
        self._running: dict[object, list[_Running]] = {}

    def command(self, port: str, value: Mapping[str, object], answer: OnAnswer | None = None, source: str = "") -> None:
        """Command an actuator.

        Args:
            port: path of the actuator.
            value: for each field name a number or a (nested) list.
            answer: gets the Reply; None if the protocol has no acknowledgement.
            source: name of the sender, if one conversation carries several senders.

        Raises:
            Refused: see `AdapterContext.command`; also if too many wait. Then `answer` is not called.
        """
        in_flight = self.in_flight
        self._context.stats.commands += 1
        in_flight.add()

        def on_reply(outcome: Reply | Progress) -> None:
            in_flight.count -= 1
            if answer is not None and not self.is_closed and isinstance(outcome, Reply):
                answer(outcome)

        try:
            self._context.command(port, value, source or self.source, on_reply, self._queue)
        except BaseException:
            in_flight.count -= 1
            raise

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        answer: OnAnswer,
        *,
        key: object = None,
        progress: OnProgress | None = None,
        timeout_s: float | None = None,
        advice: str = "give a longer timeout_s",
        source: str = "",
    ) -> None:
        """Call a service.

        Args:
            service: path of the service.
            args: value for each argument name.
            answer: gets the Reply. If the service only reads, it is called before this returns.
            key: key by which the call can be cancelled; None if it cannot.
            progress: gets the progress of the call.
            timeout_s: wall time after which the call is cancelled and answered with the fault `timeout`; None for no limit.
            advice: what the peer should do in that case; the end of the fault's text.
            source: name of the sender, if one conversation carries several senders.

        Raises:
            Refused: see `AdapterContext.call`; also if too many wait. Then `answer` is not called.
        """
        context, running = self._context, _Running(self, key, answer, progress)
        context.stats.calls += 1
        self.in_flight.add(is_stop(service))
        self._running.setdefault(running.key, []).append(running)
        try:
            running.cancel = context.call(
                service, args, source or self.source, running.on_reply, self.client, self._queue
            )
        except BaseException:
            if not running.is_done:
                running.end()
            raise
        if not running.is_done:
            running.is_long = context.services[service].long_running
            if running.is_long and self._is_half_closed:
                running.cancel()
            elif timeout_s is not None:
                text = f"not done within {timeout_s:g} s and therefore cancelled: {advice}"
                running.limit(timeout_s, Fault("timeout", text, service))

    def call_all(
        self, calls: Sequence[tuple[str, Mapping[str, object]]], answer: Callable[[Sequence[Reply]], None]
    ) -> None:
        """Call several services, and pass on their Replies in the order of the calls once all are here.

        Args:
            calls: path and arguments of each service.
            answer: gets the Replies. A call that is refused at once counts as a Reply with that fault.
        """
        replies: dict[int, Reply] = {}

        def take(k: int, reply: Reply) -> None:
            replies[k] = reply
            if len(replies) == len(calls):
                answer([replies[k] for k in range(len(calls))])

        if not calls:
            answer(())
        for k, (service, args) in enumerate(calls):
            try:
                self.call(service, args, partial(take, k))
            except Refused as refused:
                take(k, Reply(0, 0, fault=refused.fault))

    def ended(self, running: _Running) -> None:
        """Forget a call that has ended."""
        self.in_flight.count -= 1
        alike = self._running[running.key]
        alike.remove(running)
        if not alike:
            del self._running[running.key]

    def is_running(self, key: object) -> bool:
        """Tell whether a call with this key waits for its answer."""
        return key in self._running

    def cancel(self, key: object) -> bool:
        """Cancel all calls with a key; return True if one was still running, whose answer is then `preempted`."""
        # A list, because `any` of a generator would stop at the first call that was still running.
        cancelled = [running.cancel() for running in list(self._running.get(key, ()))]
        return any(cancelled)

    def join(self, client: str) -> None:
        """Let the peer take part in the lockstep barrier under this name.

        Raises:
            Refused: the barrier does not know the name, or it is taken.
        """
        self.leave()
        self._leave = self._context.join(client)
        self.client = client

    def leave(self) -> None:
        """Take the peer out of the lockstep barrier, so that others do not wait for it."""
        leave, self._leave = self._leave, None
        if leave is not None:
            leave()

    def end_calls(self) -> None:
        """Cancel the peer's long-running calls, for which nobody waits any more. Its commands stand."""
        for running in [running for alike in self._running.values() for running in alike]:
            running.unlimit()
            if running.is_long:
                running.cancel()

    def half_close(self) -> None:
        """End long-running calls, also later ones: the peer sends nothing more, and on TCP a peer that has gone looks just like that."""
        self._is_half_closed = True
        self.end_calls()

    def close(self) -> None:
        """End the conversation when the peer has left."""
        self.is_closed = True
        self.leave()
        self.end_calls()


class _Running:
    """A call that has not been answered, or that was given up before its answer came."""

    __slots__ = ("_answer", "_asked", "_overdue", "_progress", "_timer", "cancel", "is_done", "is_long", "key")

    def __init__(self, asked: Conversation, key: object, answer: OnAnswer, progress: OnProgress | None) -> None:
        self.key = self if key is None else key
        # Until the world has taken the call, there is nothing to cancel.
        self.cancel: Callable[[], bool] = lambda: False
        self.is_done = self.is_long = False
        self._asked = asked
        self._answer = answer
        self._progress = progress
        self._overdue: Fault | None = None
        self._timer: asyncio.TimerHandle | None = None

    def limit(self, timeout_s: float, overdue: Fault) -> None:
        """Cancel the call after this wall time, and answer it with this fault."""
        self._timer = asyncio.get_running_loop().call_later(timeout_s, self._give_up, overdue)

    def _give_up(self, overdue: Fault) -> None:
        self._overdue = overdue
        if not self.cancel():
            # The call cannot be cancelled any more. Nobody will wait for its real answer.
            self.on_reply(Reply(0, 0, fault=overdue))

    def unlimit(self) -> None:
        """Remove the limit of time."""
        if self._timer is not None:
            self._timer.cancel()

    def on_reply(self, outcome: Reply | Progress) -> None:
        """Take in progress, or the answer of the world."""
        if self.is_done:
            return
        if isinstance(outcome, Progress):
            if self._progress is not None and not self._asked.is_closed:
                self._progress(outcome)
            return
        self.end()
        if outcome.fault is not None and self._overdue is not None:
            outcome = Reply(outcome.tick, outcome.t_ns, fault=self._overdue)
        if not self._asked.is_closed:
            self._answer(outcome)

    def end(self) -> None:
        """Stop waiting for the answer."""
        self.is_done = True
        self.unlimit()
        self._asked.ended(self)
