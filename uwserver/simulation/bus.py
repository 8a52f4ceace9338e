"""The two crossings between the simulation thread and the asyncio loop. Nothing else is shared but immutable values.

loop -> simulation: `mailbox.Mailbox`, from which the simulation takes at the start of a tick
simulation -> loop: `Bus.publish`, one wake-up of the loop a tick
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Protocol

from uwserver.ports import Event, OnReply, Port, Progress, Reply, Sample
from uwserver.ports.crossing import TickOutput, has_same_fields
from uwserver.ports.thinning import WHOLE
from uwserver.ports.told import Told
from uwserver.simulation.clock import SystemTime, Time
from uwserver.simulation.newest import Newest
from uwserver.simulation.wants import Wanted, thinned_together, together, wants_any
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)

MAX_TICKS = 1024
"""Ticks of samples that may wait for the loop; older samples are dropped and counted, replies and events never."""

AHEAD_NS = NANOSECONDS // 100
"""Work for the loop, in wall time, by which a world that nothing paces may be ahead of it: whoever asks waits no longer than that."""

SLICE_NS = NANOSECONDS // 200
"""Wall time after which the loop looks at its sockets before it delivers on."""

TOGETHER = 512
"""Samples of some ticks that are delivered as one: one or two milliseconds of work for the loop."""

_LEAST_AHEAD, _MOST_AHEAD = 2, MAX_TICKS - MAX_TICKS // 8
"""So that one tick is made while another is delivered; and none is dropped."""

_NEWEST = 0.25
"""Weight of the newest measurement in the mean time that the loop needs for a tick."""


class Sink(Protocol):
    """Something that takes in what the world says; called on the loop, must not block. It may have `wanted`, `thinned` and `send_samples`, as
    `uwserver.adapter.Subscriber`; and `put_told`."""

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """The samples delivered in one tick."""

    def put_event(self, event: Event) -> None:
        """An event."""


class Bus:
    """Carries the output of ticks to the loop and hands it to the sinks.

    Attributes:
        dropped: samples that the loop was too slow to take.
        last: newest delivered sample of each port that a sink wants. Loop thread.
        wanted: what is to be made; None for all. Replaced on the loop, never changed; the simulation thread looks at it before each tick, so that
            what was wanted before a step was asked for is made in this step.
        asked: how often readers have said what they want, also if that was wanted already. Any thread may look.
        ports: of the newest delivered tick, which those of the world may be ahead of: whoever understands samples by them is never wrong. None
            before the first. Loop thread.
        ahead: ticks that may wait for the loop where nothing paces them: what it works off in `AHEAD_NS`, as measured.
    """

    def __init__(self, wake_loop: Callable[[Callable[[], None]], object], time: Time | None = None) -> None:
        """Of a loop.

        Args:
            wake_loop: lets the loop call a function, from any thread.
            time: measures the loop; default: the machine's.
        """
        self._wake_loop = wake_loop
        self._time, self._tick_ns = time or SystemTime(), 0.0
        self._began = self._ended = self._called = self._delivered = 0
        self.ahead = _MOST_AHEAD
        self._crossing: deque[TickOutput | Callable[[], None] | Event] = deque()
        self._waiting_ticks = 0
        self._awake = False
        self._lock = threading.Lock()
        self._sinks: list[Sink] = []
        self._sends: list[Callable[[], None]] = []
        self._hearers: list[Sink] = []
        self._puts_told: list[Callable[[Told], None]] = []
        self._others: list[Sink] = []
        self._readers: list[object] = []
        self._paths: Collection[str] | None = frozenset()
        self._thinned = WHOLE
        self._known: Mapping[str, Port] = {}
        self._jumps = 0
        self.wanted: Wanted | None = Wanted((), ())
        self.asked = 0
        self.dropped = 0
        self.last = Newest()
        self.ports: Mapping[str, Port] | None = None

    # -- readers --------------------------------------------------------------------------------------------------------------------

    def attach(self, sink: Sink) -> Callable[[], None]:
        """Begin to deliver to a sink; the returned function ends it. Loop thread."""
        self._sinks.append(sink)
        send: Callable[[], None] | None = getattr(sink, "send_samples", None)
        if send is not None:
            self._sends.append(send)
        end = self.heed(sink)

        def detach() -> None:
            self._sinks.remove(sink)
            if send is not None:
                self._sends.remove(send)
            end()

        return detach

    def heed(self, reader: object) -> Callable[[], None]:
        """Let what a reader wants be made, who may be no sink: a driver sees samples in their tick. The returned function ends it. Loop thread."""
        self._readers.append(reader)
        self.follow_wants()

        def end() -> None:
            self._readers.remove(reader)
            self.follow_wants()

        return end

    def expect(self, ports: Mapping[str, Port], jumps: int = 0) -> None:
        """The world has these ports before its first tick, after its time was set so often, and readers know it. Before the simulation runs."""
        self._known, self._jumps = ports, jumps
        self.follow_wants()

    def follow_wants(self) -> None:
        """What somebody wants has changed: it holds from the next tick on. Loop thread."""
        self.asked += 1
        self._hearers = [sink for sink in self._sinks if wants_any(sink)]
        puts_told = [getattr(sink, "put_told", None) for sink in self._hearers]
        self._puts_told = [put for put in puts_told if put is not None]
        self._others = [sink for sink, put in zip(self._hearers, puts_told, strict=True) if put is None]
        before, paths, less, thinned = self._paths, together(self._readers), self._thinned, WHOLE
        if paths is not None:
            thinned = thinned_together(self._readers, paths)
        wanted = self.wanted
        is_known = wanted is None or (wanted.known is self._known and (wanted.jumps == self._jumps or not thinned))
        if paths == before and thinned == less and is_known:
            return  # the world marks all its streams anew for another object
        self._paths, self._thinned = paths, thinned
        self.wanted = None if paths is None else Wanted(paths, self._known, self._jumps, thinned)
        if paths != before or thinned.keys() != less.keys():  # what was not wanted meanwhile is not the newest any more
            self.last.keep(
                lambda path: _is_in(path, paths) and _is_in(path, before) and path not in less and path not in thinned
            )

    # -- the crossing ---------------------------------------------------------------------------------------------------------------

    def publish(self, output: TickOutput, wake: bool = True) -> None:
        """Hand a tick over. Simulation thread; never waits for the loop. Samples alone may wait there for the next wake-up, or a `flush`."""
        if not (output.told or output.made or output.replies or output.events):
            if wake and self._crossing:
                self.flush()
            return
        with self._lock:
            if self._waiting_ticks >= MAX_TICKS:
                self.dropped += output.drop_samples()
                if not (output.replies or output.events):
                    return
            self._waiting_ticks += output.told.ticks if output.told is not None else 1
            if not self._goes_on_in(output):
                self._crossing.append(output)
            # Before a world that nothing paces would have to wait.
            is_much = self._waiting_ticks > self.ahead - self.ahead // 4
            if wake or is_much or output.replies or output.events:
                self._wake()

    def _goes_on_in(self, output: TickOutput) -> bool:
        """Let the newest tick that waits take in what this one gives, where all who read take some as one. Returns whether it did."""
        if not (self._puts_told and self._crossing) or self._others:
            return False
        newest = self._crossing[-1]
        return isinstance(newest, TickOutput) and len(newest.told or ()) < TOGETHER and newest.goes_on_in(output)

    def flush(self) -> None:
        """Wake the loop if something waits for it. Simulation thread."""
        with self._lock:
            if self._crossing:
                self._wake()

    def reply(self, on_reply: OnReply, reply: Reply | Progress) -> None:
        """Hand one answer over. Simulation thread."""
        self.hand_over(partial(on_reply, reply))

    def hand_over(self, call: Callable[[], None]) -> None:
        """Let the loop do something after all that was published before. Simulation thread."""
        with self._lock:
            self._crossing.append(call)
            self._wake()

    def say(self, event: Event) -> None:
        """Hand one event over. Simulation thread."""
        with self._lock:
            self._crossing.append(event)
            self._wake()

    def backlog(self) -> int:
        """Ticks that wait for the loop, or are being delivered."""
        return self._waiting_ticks

    def _wake(self) -> None:
        if not self._awake:
            self._awake, self._called = True, self._time.now_ns()
            self._wake_loop(self.dispatch)

    def dispatch(self) -> None:
        """Deliver what waits; after `SLICE_NS` the rest waits until the loop has looked at its sockets. Loop thread."""
        now = self._time.now_ns()
        self._measure(now)
        is_left = self._deliver_until(now + SLICE_NS)
        self._ended = self._time.now_ns()
        if is_left:
            self._called = self._ended
            self._wake_loop(self.dispatch)

    def drain(self) -> None:
        """Deliver everything that waits, for the end. Loop thread."""
        self._deliver_until(None)

    def _measure(self, now: int) -> None:
        """What the last delivery took, and by how much the loop comes late to the next, as it still does what follows from the samples. What it
        has time for until it is called is no work that somebody waits for."""
        if self._delivered:
            busy_ns = self._ended - self._began + max(0, now - max(self._ended, self._called))
            tick_ns = min(busy_ns / self._delivered, AHEAD_NS)
            self._tick_ns += _NEWEST * (tick_ns - self._tick_ns)
            self.ahead = max(_LEAST_AHEAD, min(_MOST_AHEAD, int(AHEAD_NS / max(1.0, self._tick_ns))))
        self._began, self._delivered = now, 0

    def _deliver_until(self, end: int | None) -> bool:
        """Returns whether something is left."""
        is_left = self._hand_out(end)
        for send in tuple(self._sends):
            answer(send)
        return is_left

    def _hand_out(self, end: int | None) -> bool:
        is_over = False
        while True:
            with self._lock:
                if not self._crossing:
                    self._awake = False
                    return False
                if is_over:
                    return True
                item = self._crossing.popleft()
            if isinstance(item, TickOutput):
                ticks = item.told.ticks if item.told is not None else 1
                self._delivered += ticks if item.told or item.made else 0  # answers by themselves are no tick
                self._deliver(item)
                with self._lock:
                    self._waiting_ticks -= ticks
            elif isinstance(item, Event):
                self._each(lambda sink, event=item: sink.put_event(event), self._sinks)  # type: ignore[misc]
            else:
                answer(item)
            is_over = end is not None and self._time.now_ns() >= end

    def _follow_ports(self, ports: Mapping[str, Port]) -> None:
        before, self.ports = self.ports, ports
        if before is not None:
            self.last.keep(lambda path: has_same_fields(path, before, ports))

    def _deliver(self, output: TickOutput) -> None:
        changed = output.ports is not None and output.ports is not self.ports
        if output.ports is not None and changed:
            self._follow_ports(output.ports)
        for event in output.events:
            if event.event == "reset":
                self.last.clear()  # what was read at another time
            self._each(lambda sink, event=event: sink.put_event(event), self._sinks)  # type: ignore[misc]
        if output.ports is not None and (changed or output.jumps != self._jumps):  # and all have heard of it
            self.expect(output.ports, output.jumps)
        for on_reply, reply in output.replies:
            answer(partial(on_reply, reply))
        told = output.told
        if told is None or told.ticks == 1 or output.made or not self._others:
            self._give(told, output.made)
            return
        for tick in told.by_tick():  # made in one go, or put together while nobody took them one by one
            self._give(tick, output.made)

    def _give(self, told: Told | None, made: list[Sample]) -> None:
        hearers = self._hearers
        if told and self._puts_told and not made:
            hearers = self._others
            for put in self._puts_told:
                answer(partial(put, told))
        # Who is alone makes of the rows what it needs; for several they are made once.
        samples: Sequence[Sample] = told if told and not made and len(hearers) < 2 else [*(told or ()), *made]
        if samples:
            self.last.put(samples)
            self._each(lambda sink: sink.put_samples(samples), hearers)

    def _each(self, deliver: Callable[[Sink], None], sinks: Sequence[Sink]) -> None:
        for sink in tuple(sinks):
            try:
                deliver(sink)
            except Exception:  # one sink's fault must not reach the others
                log.exception("a sink failed; it misses this tick")


def answer(call: Callable[[], None]) -> None:
    """Call back; a fault of the receiver is logged and stays with it."""
    try:
        call()
    except Exception:  # the asker's fault must not reach the others
        log.exception("the receiver of a reply, or of samples, failed")


def _is_in(path: str, paths: Collection[str] | None) -> bool:
    return paths is None or path in paths
