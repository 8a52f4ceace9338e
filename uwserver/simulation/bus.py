"""Carries the output of ticks from the simulation thread to the asyncio loop, with one wake-up of the loop for each tick. Everything that
both threads share is immutable.

Besides the bus, this module has what readers get from it: the subscriptions of all of them together, and the newest sample of each port.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Container, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, Protocol, TypeVar

from uwserver.ports import Event, OnReply, Port, Progress, Reply, Sample
from uwserver.ports.crossing import TickOutput, has_same_fields
from uwserver.ports.decimation import EVERY_SAMPLE, Decimation, Decimations
from uwserver.ports.sample_batch import SampleBatch, SampleLog
from uwserver.simulation.clock import SystemTime, Time
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)

T = TypeVar("T")

MAX_TICKS = 1024
"""Most ticks whose samples wait for the loop. If there are more, old samples are dropped and counted; replies and events never are."""

AHEAD_NS = NANOSECONDS // 100
"""A world that nothing paces may be ahead of the loop by so much of the loop's work, in wall time. So no request waits longer than that."""

SLICE_NS = NANOSECONDS // 200
"""After so much wall time of delivery the loop looks at its sockets."""

TOGETHER = 512
"""Samples of several ticks that are delivered together: one or two milliseconds of work for the loop."""

_LEAST_AHEAD, _MOST_AHEAD = 2, MAX_TICKS - MAX_TICKS // 8
"""At least two ticks, so that one is made while another is delivered; and so few that none is dropped."""

_NEWEST = 0.25
"""Weight of the newest measurement in the mean time that the loop needs for a tick."""


class Sink(Protocol):
    """Takes samples and events of the world on the loop; must not block. It may have `subscriptions`, `decimations` and `send_samples`, as
    `uwserver.adapter.Subscriber`, and `put_batch`."""

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Take the samples delivered in one tick."""

    def put_event(self, event: Event) -> None:
        """Take an event."""


class Bus:
    """Carries the output of ticks to the loop, and gives it to the sinks.

    Attributes:
        dropped: samples that were dropped because the loop was too slow.
        last: newest delivered sample of each port that a sink reads. Loop thread.
        subscriptions: the ports of which samples are made; None for all. Replaced on the loop, never changed. The simulation thread reads it
            before each tick, so that what was subscribed before a step was requested is made in that step.
        asked: how often readers have set their subscriptions, also without a change. Any thread may read it.
        ports: ports of the newest delivered tick. The ports of the world may be newer, but samples always fit these ports. None before the first
            tick. Loop thread.
        ahead: ticks that may wait for the loop if nothing paces them: as many as it delivers in `AHEAD_NS`, as measured.
    """

    def __init__(self, wake_loop: Callable[[Callable[[], None]], object], time: Time | None = None) -> None:
        """Begin without sinks.

        Args:
            wake_loop: lets the loop call a function, from any thread.
            time: measures the loop; default: the machine's clock.
        """
        self._wake_loop = wake_loop
        self._time, self._tick_ns = time or SystemTime(), 0.0
        self._began = self._ended = self._called = self._delivered = 0
        self.ahead = _MOST_AHEAD
        self._crossing: deque[TickOutput | Callable[[], None]] = deque()
        self._waiting_ticks = 0
        self._awake = False
        self._lock = threading.Lock()
        self._sinks: list[Sink] = []
        self._sample_sinks: list[Sink] = []
        self._batch_puts: list[Callable[[SampleBatch], None]] = []
        self._others: list[Sink] = []
        self._readers: list[object] = []
        self._paths: Collection[str] | None = frozenset()
        self._decimations = EVERY_SAMPLE
        self._known: Mapping[str, Port] = {}
        self._jumps = 0
        self.subscriptions: Subscriptions | None = Subscriptions((), ())
        self.asked = 0
        self.dropped = 0
        self.last = Newest()
        self.ports: Mapping[str, Port] | None = None

    # -- readers --------------------------------------------------------------------------------------------------------------------

    def attach(self, sink: Sink) -> Callable[[], None]:
        """Begin to deliver to a sink. The returned function ends it. Loop thread."""
        self._sinks.append(sink)
        end = self.add_reader(sink)

        def detach() -> None:
            self._sinks.remove(sink)
            end()

        return detach

    def add_reader(self, reader: object) -> Callable[[], None]:
        """Make the samples that a reader subscribes to, also if it is no sink: a driver gets samples in their tick. The returned function
        ends it. Loop thread."""
        self._readers.append(reader)
        self.subscriptions_changed()

        def end() -> None:
            self._readers.remove(reader)
            self.subscriptions_changed()

        return end

    def expect(self, ports: Mapping[str, Port], jumps: int = 0) -> None:
        """Set the ports of the world and its number of jumps, which readers know of. Called before the simulation runs, and when readers
        have heard of a change."""
        self._known, self._jumps = ports, jumps
        self.subscriptions_changed()

    def subscriptions_changed(self) -> None:
        """Take over changed subscriptions of readers, from the next tick on. Loop thread."""
        self.asked += 1
        self._sample_sinks = [sink for sink in self._sinks if subscribes_any(sink)]
        batch_puts = [getattr(sink, "put_batch", None) for sink in self._sample_sinks]
        self._batch_puts = [put for put in batch_puts if put is not None]
        self._others = [sink for sink, put in zip(self._sample_sinks, batch_puts, strict=True) if put is None]
        before, paths, less, decimations = self._paths, merged(self._readers), self._decimations, EVERY_SAMPLE
        if paths is not None:
            decimations = merged_decimations(self._readers, paths)
        subscriptions = self.subscriptions
        is_known = subscriptions is None or (
            subscriptions.known is self._known and (subscriptions.jumps == self._jumps or not decimations)
        )
        if paths == before and decimations == less and is_known:
            return  # A new object would make the world mark all its streams again.
        self._paths, self._decimations = paths, decimations
        self.subscriptions = None if paths is None else Subscriptions(paths, self._known, self._jumps, decimations)
        if (
            paths != before or decimations.keys() != less.keys()
        ):  # A sample of a port that was not read for a while is not the newest one.
            self.last.keep(
                lambda path: (
                    _is_in(path, paths) and _is_in(path, before) and path not in less and path not in decimations
                )
            )

    # -- the crossing ---------------------------------------------------------------------------------------------------------------

    def publish(self, output: TickOutput, wake: bool = True) -> None:
        """Hand a tick over. It never waits for the loop. If `wake` is false and there are only samples, they may wait for the next wake-up,
        or a `flush`. Simulation thread."""
        if not (output.batch or output.made or output.replies or output.events):
            if wake and self._crossing:
                self.flush()
            return
        with self._lock:
            if self._waiting_ticks >= MAX_TICKS:
                self.dropped += output.drop_samples()
                if not (output.replies or output.events):
                    return
            self._waiting_ticks += output.batch.ticks if output.batch is not None else 1
            if not self._append_to_newest(output):
                self._crossing.append(output)
            # Early enough that a world that nothing paces need not wait.
            is_much = self._waiting_ticks > self.ahead - self.ahead // 4
            if wake or is_much or output.replies or output.events:
                self._wake()

    def _append_to_newest(self, output: TickOutput) -> bool:
        """Append this tick to the newest tick that waits, if all readers take several ticks at once. Returns whether it was appended."""
        if not (self._batch_puts and self._crossing) or self._others:
            return False
        newest = self._crossing[-1]
        return isinstance(newest, TickOutput) and len(newest.batch or ()) < TOGETHER and newest.goes_on_in(output)

    def flush(self) -> None:
        """Wake the loop if something waits for it. Simulation thread."""
        with self._lock:
            if self._crossing:
                self._wake()

    def reply(self, on_reply: OnReply, reply: Reply | Progress) -> None:
        """Hand one answer over. Simulation thread."""
        self.hand_over(partial(on_reply, reply))

    def hand_over(self, call: Callable[[], None]) -> None:
        """Let the loop call a function after everything that was published before. Simulation thread."""
        with self._lock:
            self._crossing.append(call)
            self._wake()

    def say(self, event: Event) -> None:
        """Hand one event over. Simulation thread."""
        self.hand_over(partial(self._put_event, event))

    def backlog(self) -> int:
        """Return how many ticks wait for the loop, or are being delivered."""
        return self._waiting_ticks

    def _wake(self) -> None:
        if not self._awake:
            self._awake, self._called = True, self._time.now_ns()
            self._wake_loop(self.dispatch)

    def dispatch(self) -> None:
        """Deliver what waits. After `SLICE_NS`, the rest waits until the loop has looked at its sockets. Loop thread."""
        now = self._time.now_ns()
        self._measure(now)
        is_left = self._deliver_until(now + SLICE_NS)
        self._ended = self._time.now_ns()
        if is_left:
            self._called = self._ended
            self._wake_loop(self.dispatch)

    def drain(self) -> None:
        """Deliver everything that waits, at the end. Loop thread."""
        self._deliver_until(None)

    def _measure(self, now: int) -> None:
        """Measure the work of the last delivery: its duration, and by how much the loop is late for the next one, as it still processes the
        samples. Idle time until the next wake-up does not count."""
        if self._delivered:
            busy_ns = self._ended - self._began + max(0, now - max(self._ended, self._called))
            tick_ns = min(busy_ns / self._delivered, AHEAD_NS)
            self._tick_ns += _NEWEST * (tick_ns - self._tick_ns)
            self.ahead = max(_LEAST_AHEAD, min(_MOST_AHEAD, int(AHEAD_NS / max(1.0, self._tick_ns))))
        self._began, self._delivered = now, 0

    def _deliver_until(self, end: int | None) -> bool:
        """Deliver until a time, ns, or until nothing waits (None). Returns whether something is left."""
        is_left = self._deliver_waiting(end)
        for send in [getattr(sink, "send_samples", None) for sink in self._sinks]:
            if send is not None:
                call_safely(send)
        return is_left

    def _deliver_waiting(self, end: int | None) -> bool:
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
                ticks = item.batch.ticks if item.batch is not None else 1
                self._delivered += ticks if item.batch or item.made else 0  # replies without samples are no tick
                self._deliver(item)
                with self._lock:
                    self._waiting_ticks -= ticks
            else:
                call_safely(item)
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
                self.last.clear()  # Its samples are of another time.
            self._put_event(event)
        if output.ports is not None and (changed or output.jumps != self._jumps):  # All sinks have had the event.
            self.expect(output.ports, output.jumps)
        for on_reply, reply in output.replies:
            call_safely(partial(on_reply, reply))
        batch = output.batch
        if batch is None or batch.ticks == 1 or output.made or not self._others:
            self._give_samples(batch, output.made)
            return
        for tick in (
            batch.by_tick()
        ):  # Several ticks that were made in one call, or appended while all readers could take several at once.
            self._give_samples(tick, output.made)

    def _give_samples(self, batch: SampleBatch | None, made: list[Sample]) -> None:
        hearers = self._sample_sinks
        if batch and self._batch_puts and not made:
            hearers = self._others
            for put in self._batch_puts:
                call_safely(partial(put, batch))
        # A single sink makes sample objects of the rows as it needs them; for several sinks they are made once.
        samples: Sequence[Sample] = batch if batch and not made and len(hearers) < 2 else [*(batch or ()), *made]
        if samples:
            self.last.put(samples)
            for sink in tuple(hearers):
                call_safely(partial(sink.put_samples, samples))

    def _put_event(self, event: Event) -> None:
        for sink in tuple(self._sinks):
            call_safely(partial(sink.put_event, event))


def call_safely(call: Callable[[], None]) -> None:
    """Call a receiver. Its errors are logged and go no further."""
    try:
        call()
    except (KeyboardInterrupt, SystemExit):
        raise
    except (
        BaseException
    ):  # A fault of one receiver must not reach the others. The panic of a library in Rust is no Exception.
        log.exception("a receiver of samples, events or replies failed; it misses what it was given now")


def _is_in(path: str, paths: Collection[str] | None) -> bool:
    return paths is None or path in paths


class Subscriptions:
    """The ports of which samples are made: those that a reader subscribes to, and those that the readers do not know of yet.

    So no sample of a new body is lost while readers hear of its ports. Never changed, as the simulation thread reads it.

    Attributes:
        known: all ports that the readers know of.
        jumps: how often the time was set, as far as the readers know.
        decimations: ports of which not all samples are needed; valid while ports and times are those that the readers know of.
    """

    def __init__(
        self, paths: Collection[str], known: Container[str], jumps: int = 0, decimations: Decimations = EVERY_SAMPLE
    ) -> None:
        """Take the paths that readers subscribe to."""
        self._paths, self.known, self.jumps, self.decimations = paths, known, jumps, decimations

    def __contains__(self, path: object) -> bool:
        return path in self._paths or path not in self.known


def merged(readers: Sequence[object]) -> frozenset[str] | None:
    """Return the paths that readers subscribe to; None for all, as a reader without `subscriptions` reads all."""
    subscriptions = [_subscriptions_of(reader) for reader in readers]
    some = [paths for paths in subscriptions if paths is not None]
    return frozenset().union(*some) if len(some) == len(subscriptions) else None


def subscribes_any(reader: object) -> bool:
    """Return whether a reader subscribes to any samples."""
    return _subscriptions_of(reader) != frozenset()


def merged_decimations(readers: Sequence[object], paths: Collection[str]) -> Decimations:
    """Return the ports of which no reader needs all samples, with their decimations."""
    decimations: dict[str, frozenset[Decimation]] = {}
    whole: set[str] = set()
    for reader in readers:
        subscriptions, less = (
            _subscriptions_of(reader) or frozenset(),
            _attribute(reader, "decimations", dict[str, Collection[Decimation]]) or EVERY_SAMPLE,
        )
        whole |= subscriptions - less.keys()
        for path in subscriptions & less.keys():
            decimations[path] = decimations.get(path, frozenset()).union(less[path])
    return {path: some for path, some in decimations.items() if some and path in paths and path not in whole}


def _subscriptions_of(reader: object) -> frozenset[str] | None:
    return _attribute(reader, "subscriptions", frozenset[str])


def _attribute(reader: object, name: str, kind: Callable[[Any], T]) -> T | None:
    """Return an attribute of a reader as another kind of collection; None if it has none, or if it cannot be read."""
    try:
        value = getattr(reader, name, None)
        return None if value is None else kind(value)
    except Exception:  # A fault of one reader must not reach the others.
        log.exception('"%s" of a reader cannot be read: it gets all samples', name)
        return None


class Newest(Mapping[str, Sample]):
    """The newest samples by path of the port."""

    def __init__(self) -> None:
        self._places: dict[str, Sample | SampleBatch] = {}
        self._log: SampleLog | None = None

    def put(self, samples: Sequence[Sample]) -> None:
        """Take samples that were delivered, in this order."""
        if isinstance(samples, SampleBatch):
            if samples.log is not self._log:
                self._leave(samples.log)
            self._places.update(dict.fromkeys(samples.ports, samples))
        else:
            self._places.update(zip(map(attrgetter("port"), samples), samples, strict=True))

    def _leave(self, log: SampleLog) -> None:
        """Begin to use another log. Samples that are still the newest from the log before the last one are copied, so that they do not keep
        that log alive."""
        for path, place in self._places.items():
            if isinstance(place, SampleBatch) and place.log is not self._log:
                self._places[path] = place.newest(path)
        self._log = log

    def keep(self, holds: Callable[[str], bool]) -> None:
        """Forget the samples of ports for which `holds` returns false."""
        self._places = {path: place for path, place in self._places.items() if holds(path)}

    def clear(self) -> None:
        """Forget all samples."""
        self._places.clear()

    def __getitem__(self, path: str) -> Sample:
        place = self._places[path]
        return place.newest(path) if isinstance(place, SampleBatch) else place

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
