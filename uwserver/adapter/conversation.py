"""What one peer asked of the world and is owed: commands and calls, each with one answer, within limits, until it leaves.

An adapter that begins all commands and calls of a peer here need not mind who is still waiting: a peer that goes has its long-running calls
ended, a call that takes too long is cancelled and told so, and nobody can make the server remember more than a limit.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from uwserver.adapter.contract import AdapterContext
from uwserver.ports import Fault, Progress, Refused, Reply

UNANSWERED = 1024
"""Commands and calls that may wait for the world."""

OnAnswer = Callable[[Reply], None]
"""Gets the one answer, on the loop."""


class Owed:
    """How many commands and calls wait for the world: those of one conversation, or of several that share it.

    Attributes:
        most: that may wait.
        count: that wait.
    """

    def __init__(self, most: int = UNANSWERED) -> None:
        self.most = most
        self.count = 0

    def add(self) -> None:
        """One more.

        Raises:
            Refused: too many wait already.
        """
        if self.count >= self.most:
            raise Refused("overload", f"{self.count} commands and calls wait for their answer: wait for some of them")
        self.count += 1


class _Running:
    """A call under way."""

    __slots__ = ("cancel", "is_done", "is_late", "is_long", "overdue")

    def __init__(self) -> None:
        self.cancel: Callable[[], bool] = _too_late
        self.overdue: asyncio.TimerHandle | None = None
        self.is_long = self.is_late = self.is_done = False


class Conversation:
    """One peer. Loop thread.

    Args:
        context: the world.
        source: who it is among the peers of this adapter, for the world.
        owed: counts what waits; default: a limit of its own.

    Attributes:
        source: as given; may be changed when the peer has said its name.
        client: the name with which it joined the lockstep barrier; "" before.
        owed: as given.
        is_closed: it has left; nothing is answered any more.
    """

    def __init__(self, context: AdapterContext, source: str, owed: Owed | None = None) -> None:
        self.source = source
        self.client = ""
        self.owed = owed or Owed()
        self.is_closed = False
        self._context = context
        self._leave: Callable[[], None] | None = None
        self._running: dict[object, list[_Running]] = {}

    def command(
        self, port: str, value: Mapping[str, object], answer: OnAnswer | None = None, source: str | None = None
    ) -> None:
        """Command an actuator.

        Args:
            port: its path.
            value: field name -> number or (nested) list.
            answer: gets the Reply; None where the protocol has no acknowledgement.
            source: who it is, where one conversation carries several senders.

        Raises:
            Refused: see `AdapterContext.command`; or too many wait. `answer` is not called then.
        """
        stats = self._context.stats
        stats.commands += 1
        self.owed.add()
        is_done = False

        def on_reply(outcome: Reply | Progress) -> None:
            nonlocal is_done
            if isinstance(outcome, Reply) and not is_done:
                is_done = True
                self.owed.count -= 1
                if answer is not None and not self.is_closed:
                    answer(outcome)

        try:
            self._context.command(port, value, self.source if source is None else source, on_reply)
        except BaseException:
            self.owed.count -= not is_done
            raise

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        answer: OnAnswer,
        *,
        key: object = None,
        progress: Callable[[Progress], None] | None = None,
        timeout_s: float | None = None,
        advice: str = "give a longer timeout_s",
        source: str | None = None,
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
        context, running = self._context, _Running()
        key = running if key is None else key
        context.stats.calls += 1
        self.owed.add()

        def on_reply(outcome: Reply | Progress) -> None:
            if running.is_done:
                return  # it was too late to cancel it: its caller has been told
            if isinstance(outcome, Progress):
                if progress is not None and not self.is_closed:
                    progress(outcome)
                return
            running.is_done = True
            self._forget(key, running)
            if running.overdue is not None:
                running.overdue.cancel()
            self.owed.count -= 1
            if running.is_late and outcome.fault is not None:
                text = f"not done within {timeout_s:g} s and therefore cancelled: {advice}"
                outcome = Reply(outcome.tick, outcome.t_ns, fault=Fault("timeout", text, service))
            if not self.is_closed:
                answer(outcome)

        def give_up() -> None:
            running.is_late = True
            if not running.cancel():
                on_reply(Reply(0, 0, fault=Fault("timeout", "", service)))

        try:
            running.cancel = context.call(
                service, args, self.source if source is None else source, on_reply, self.client
            )
        except BaseException:
            self.owed.count -= not running.is_done
            raise
        if not running.is_done:
            known = context.services.get(service)
            running.is_long = known is not None and known.long_running
            self._running.setdefault(key, []).append(running)
            if timeout_s is not None:
                running.overdue = asyncio.get_running_loop().call_later(timeout_s, give_up)

    def _forget(self, key: object, running: _Running) -> None:
        alike = self._running.get(key, [])
        if running in alike:
            alike.remove(running)
            if not alike:
                del self._running[key]

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
            if running.overdue is not None:
                running.overdue.cancel()
            if running.is_long:
                running.cancel()

    def close(self) -> None:
        """The peer has gone."""
        self.is_closed = True
        self.leave()
        self.end_calls()


def _too_late() -> bool:
    return False
