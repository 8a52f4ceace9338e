"""The two crossings between the simulation thread and the asyncio loop. Nothing else is shared but immutable values.

loop -> simulation: `Mailbox`, drained at the start of a tick
simulation -> loop: `Bus.publish`, one wake-up of the loop a tick
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from uwserver.ports import Call, Command, Event, OnReply, Progress, Refused, Reply, Sample
from uwserver.ports.crossing import Posted, TickOutput

log = logging.getLogger(__name__)

MAX_POSTED = 4096
"""Commands and calls that may wait for one tick."""

MAX_TICKS = 1024
"""Ticks of samples that may wait for the loop; older samples are dropped and counted, replies and events never."""


class Sink(Protocol):
    """Something that takes in what the world says; called on the loop, must not block."""

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """The samples delivered in one tick."""

    def put_event(self, event: Event) -> None:
        """An event."""


class Mailbox:
    """What the loop posts for the simulation. `wake` is set with each post, for a simulation that waits."""

    def __init__(self) -> None:
        self._posted: deque[Posted] = deque()
        self.wake = threading.Event()

    def post(self, item: Command | Call, on_reply: OnReply | None, *, always: bool = False) -> None:
        """Queue for the next tick.

        Args:
            item, on_reply: what is asked, and who gets the answer.
            always: never refused; for what who asks bounds, as one cancel for each call.

        Raises:
            Refused: `overload` when too many wait already.
        """
        if len(self._posted) >= MAX_POSTED and not always:
            raise Refused(
                "overload",
                f"{MAX_POSTED} requests wait for the next tick already: send fewer, or wait for their replies",
            )
        self._posted.append(Posted(item, on_reply))
        self.wake.set()

    def take(self) -> list[Posted]:
        """Everything posted so far, in order. Simulation thread."""
        taken = []
        while self._posted:
            taken.append(self._posted.popleft())
        return taken


class Bus:
    """Carries the output of ticks to the loop and hands it to the sinks.

    Attributes:
        dropped: samples that the loop was too slow to take.
        last: newest delivered sample of each port. Loop thread.
    """

    def __init__(self, wake_loop: Callable[[Callable[[], None]], object]) -> None:
        self._wake_loop = wake_loop
        self._crossing: deque[TickOutput | tuple[OnReply, Reply | Progress] | Event] = deque()
        self._waiting_ticks = 0
        self._awake = False
        self._lock = threading.Lock()
        self._sinks: list[Sink] = []
        self.dropped = 0
        self.last: dict[str, Sample] = {}

    def attach(self, sink: Sink) -> Callable[[], None]:
        """Begin to deliver to a sink; the returned function ends it. Loop thread."""
        self._sinks.append(sink)
        return lambda: self._sinks.remove(sink)

    def publish(self, output: TickOutput, wake: bool = True) -> None:
        """Hand a tick over. Simulation thread; never waits for the loop. Samples alone may wait there for the next wake-up, or a `flush`."""
        if not (output.samples or output.replies or output.events):
            return
        with self._lock:
            if self._waiting_ticks >= MAX_TICKS:
                self.dropped += len(output.samples)
                output.samples = []
                if not (output.replies or output.events):
                    return
            self._waiting_ticks += 1
            self._crossing.append(output)
            if wake or output.replies or output.events:
                self._wake()

    def flush(self) -> None:
        """Wake the loop if something waits for it. Simulation thread."""
        with self._lock:
            if self._crossing:
                self._wake()

    def reply(self, on_reply: OnReply, answer: Reply | Progress) -> None:
        """Hand one answer over. Simulation thread."""
        with self._lock:
            self._crossing.append((on_reply, answer))
            self._wake()

    def say(self, event: Event) -> None:
        """Hand one event over. Simulation thread."""
        with self._lock:
            self._crossing.append(event)
            self._wake()

    def backlog(self) -> int:
        """Ticks that wait for the loop."""
        return self._waiting_ticks

    def _wake(self) -> None:
        if not self._awake:
            self._awake = True
            self._wake_loop(self.dispatch)

    def dispatch(self) -> None:
        """Deliver everything that waits. Loop thread."""
        with self._lock:
            taken, self._crossing = self._crossing, deque()
            self._waiting_ticks = 0
            self._awake = False
        for item in taken:
            if isinstance(item, TickOutput):
                self._deliver(item)
            elif isinstance(item, Event):
                self._each(lambda sink, event=item: sink.put_event(event))  # type: ignore[misc]
            else:
                answer(*item)

    def _deliver(self, output: TickOutput) -> None:
        for event in output.events:
            if event.event == "reset":
                self.last.clear()  # what was read at another time
            self._each(lambda sink, event=event: sink.put_event(event))  # type: ignore[misc]
        for on_reply, reply in output.replies:
            answer(on_reply, reply)
        if output.samples:
            for sample in output.samples:
                self.last[sample.port] = sample
            self._each(lambda sink: sink.put_samples(output.samples))

    def _each(self, deliver: Callable[[Sink], None]) -> None:
        for sink in tuple(self._sinks):
            try:
                deliver(sink)
            except Exception:  # one sink's fault must not reach the others
                log.exception("a sink failed; it misses this tick")


def answer(on_reply: OnReply, reply: Reply | Progress) -> None:
    """Call back; a fault of the receiver is logged and stays with it."""
    try:
        on_reply(reply)
    except Exception:  # the asker's fault must not reach the others
        log.exception("the receiver of a reply failed")
