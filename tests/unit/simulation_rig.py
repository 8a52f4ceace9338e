"""A running simulation and a loop of its own, for tests of the simulation thread."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator

from uwserver.ports import Event, Progress, Reply
from uwserver.scenario.build.world import build
from uwserver.server.profiling import Profiling
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation

PATIENCE_S = 120.0
FREE = Timing(mode="freerun")


class Rig:
    """A running simulation, and a loop of its own that dispatches the bus."""

    def __init__(self, resolved, timing: Timing) -> None:
        self.resolved = resolved
        self._work: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self.samples: list = []
        self.events: queue.Queue[Event] = queue.Queue()
        self.bus = Bus(self._work.put)
        self.bus.attach(self)
        self.mailbox = Mailbox()
        self.simulation = Simulation(build(resolved), timing, SystemTime(), self.bus, self.mailbox)
        self._loop = threading.Thread(target=self._dispatch)
        self._thread = threading.Thread(target=self.simulation.run)

    @property
    def world(self):
        return self.simulation.world

    def soon(self, work: Callable[[], None]) -> None:
        """Let the loop do something."""
        self._work.put(work)

    def put_samples(self, samples) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None:
        self.events.put(event)

    def _dispatch(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    def start(self) -> None:
        self._loop.start()
        self._thread.start()

    def end(self) -> None:
        self.simulation.stop()
        self._thread.join(PATIENCE_S)
        self._work.put(None)
        self._loop.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def begin(self, service: str, client: str = "me", **args):
        """Start a service of the clock: (queue of answers, cancel function)."""
        answers: queue.Queue[Reply | Progress] = queue.Queue()
        return answers, self.simulation.call(service, args, client, answers.put)

    def call(self, service: str, **args) -> Reply:
        return self.final(self.begin(service, **args)[0])

    def post(self, item) -> Reply:
        answers: queue.Queue[Reply | Progress] = queue.Queue()
        self.mailbox.post(item, answers.put)
        return self.final(answers)

    @staticmethod
    def final(answers: queue.Queue[Reply | Progress]) -> Reply:
        while True:
            answer = answers.get(timeout=PATIENCE_S)
            if isinstance(answer, Reply):
                return answer

    def event(self, name: str) -> Event:
        while True:
            event = self.events.get(timeout=PATIENCE_S)
            if event.event == name:
                return event


@contextlib.contextmanager
def running(resolved, timing: Timing = FREE) -> Iterator[Rig]:
    rig = Rig(resolved, timing)
    rig.start()
    try:
        yield rig
    finally:
        rig.end()


def profiling_of(
    rig: Rig, later: Callable[[float, Callable[[], None]], object] = lambda seconds, then: None
) -> Profiling:
    """Measurements of a rig; `later` decides when their seconds are over, at first never."""
    return Profiling(rig.simulation, SystemTime().now_ns, rig.soon, later)
