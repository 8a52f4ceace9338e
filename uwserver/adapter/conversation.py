"""What one peer asked of the world and is owed: commands and calls, each with one answer, within limits, until it leaves.

An adapter that begins all commands and calls of a peer here need not mind who is still waiting: a peer that goes has its long-running calls
ended, a call that takes too long is cancelled and told so, and nobody can make the server remember more than a limit.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from uwserver.adapter.contract import AdapterContext
from uwserver.ports import Fault, Progress, Refused, Reply
from uwserver.ports.stops import is_stop

UNANSWERED = 1024
"""Commands and calls that may wait for the world."""
STOPS = 16
"""Calls that stop something which may wait besides."""

OnAnswer = Callable[[Reply], None]
"""Gets the one answer, on the loop."""
OnProgress = Callable[[Progress], None]


class Owed:
    """How many commands and calls wait for the world: those of one conversation, or of several that share it.

    Attributes:
        most: that may wait.
        count: that wait.
    """

    def __init__(self, most: int = UNANSWERED) -> None:
        self.most = most
        self.count = 0

    def add(self, is_stop: bool = False) -> None:
        """One more; for those that stop something there are further `STOPS`.

        Raises:
            Refused: too many wait already.
        """
        if self.count >= self.most + (STOPS if is_stop else 0):
            raise Refused("overload", f"{self.count} commands and calls wait for their answer: wait for some of them")
        self.count += 1


class Conversation:
    """One peer. Loop thread.

    Args:
        context: the world.
        source: who it is among the peers of this adapter, for the world.
        owed: counts what waits; default: a limit of its own.
        queue: in which all that it asks waits for its tick, where several conversations share a source.

    Attributes:
        source: as given; may be changed when the peer has said its name.
        client: the name with which it joined the lockstep barrier; "" before.
        owed: as given.
        is_closed: it has left; nothing is answered any more.
    """

    def __init__(self, context: AdapterContext, source: str, owed: Owed | None = None, queue: str = "") -> None:
        self.source = source
        self.client = ""
        self.owed = owed or Owed()
        self.is_closed = False
        self._context = context
        self._queue = queue
        self._leave: Callable[[], None] | None = None
        self._running: dict[object, list[_Running]] = {}

    def command(self, port: str, value: Mapping[str, object], answer: OnAnswer | None = None, source: str = "") -> None:
        """Command an actuator.

        Args:
            port: its path.
            value: field name -> number or (nested) list.
            answer: gets the Reply; None where the protocol has no acknowledgement.
            source: who it is, where one conversation carries several senders.

        Raises:
            Refused: see `AdapterContext.command`; or too many wait. `answer` is not called then.
        """
        owed = self.owed
        self._context.stats.commands += 1
        owed.add()

        def on_reply(outcome: Reply | Progress) -> None:
            owed.count -= 1
            if answer is not None and not self.is_closed and isinstance(outcome, Reply):
                answer(outcome)

        try:
            self._context.command(port, value, source or self.source, on_reply, self._queue)
        except BaseException:
            owed.count -= 1
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
            service: its path.
            args: argument name -> value.
            answer: gets the Reply. What only reads is answered before this returns.
            key: under which it can be cancelled; None for a call that cannot.
            progress: hears how far it is.
            timeout_s: wall time after which it is cancelled and answered with a fault `timeout`; None for never.
            advice: what the peer should do then; ends the text of that fault.
            source: who it is, where one conversation carries several senders.

        Raises:
            Refused: see `AdapterContext.call`; or too many wait. `answer` is not called then.
        """
        context, running = self._context, _Running(self, key, answer, progress)
        context.stats.calls += 1
        self.owed.add(is_stop(service))
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
            if timeout_s is not None:
                text = f"not done within {timeout_s:g} s and therefore cancelled: {advice}"
                running.limit(timeout_s, Fault("timeout", text, service))

    def ended(self, running: _Running) -> None:
        """A call has ended: called by it."""
        self.owed.count -= 1
        alike = self._running[running.key]
        alike.remove(running)
        if not alike:
            del self._running[running.key]

    def is_running(self, key: object) -> bool:
        """Whether a call of this key waits for its answer."""
        return key in self._running

    def cancel(self, key: object) -> bool:
        """Cancel the calls of a key; True when one was still under way (its answer then says `preempted`)."""
        cancelled = [running.cancel() for running in list(self._running.get(key, ()))]  # all of them
        return any(cancelled)

    def join(self, client: str) -> None:
        """The peer takes part in a lockstep barrier under this name.

        Raises:
            Refused: the barrier does not take it.
        """
        self.leave()
        self._leave = self._context.join(client)
        self.client = client

    def leave(self) -> None:
        """The peer can grant no further tick: others must not wait for it."""
        leave, self._leave = self._leave, None
        if leave is not None:
            leave()

    def end_calls(self) -> None:
        """Nobody waits for its long-running calls any more: cancel them. What it commanded stands."""
        for running in [running for alike in self._running.values() for running in alike]:
            running.unlimit()
            if running.is_long:
                running.cancel()

    def close(self) -> None:
        """The peer has gone."""
        self.is_closed = True
        self.leave()
        self.end_calls()


class _Running:
    """A call under way: its one answer, also when that comes too late."""

    __slots__ = ("_answer", "_asked", "_overdue", "_progress", "_timer", "cancel", "is_done", "is_long", "key")

    def __init__(self, asked: Conversation, key: object, answer: OnAnswer, progress: OnProgress | None) -> None:
        self.key = self if key is None else key
        self.cancel: Callable[[], bool] = _too_late
        self.is_done = self.is_long = False
        self._asked = asked
        self._answer = answer
        self._progress = progress
        self._overdue: Fault | None = None
        self._timer: asyncio.TimerHandle | None = None

    def limit(self, timeout_s: float, overdue: Fault) -> None:
        """Cancel it after this wall time, and say so."""
        self._timer = asyncio.get_running_loop().call_later(timeout_s, self._give_up, overdue)

    def _give_up(self, overdue: Fault) -> None:
        self._overdue = overdue
        if not self.cancel():
            # It cannot be taken back; its answer, when it comes, has nobody who waits for it.
            self.on_reply(Reply(0, 0, fault=overdue))

    def unlimit(self) -> None:
        """It may take as long as it takes."""
        if self._timer is not None:
            self._timer.cancel()

    def on_reply(self, outcome: Reply | Progress) -> None:
        """What the world says."""
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
        """It is not waited for any more."""
        self.is_done = True
        self.unlimit()
        self._asked.ended(self)


def _too_late() -> bool:
    return False
