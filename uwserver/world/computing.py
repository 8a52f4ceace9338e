"""Readings under computation: the thread of a world that makes them, who waits for them, and those that are dropped in real time.

The thread begins with the first job and ends with the world. A world always waits for a reading that is due, so that its run does not depend on the
machine. Who paces it asks `late` before each tick, and posts the calls that this gives: what they drop nobody waits for.
"""

from __future__ import annotations

import logging
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from heapq import heappop, heappush
from itertools import count
from queue import Empty, SimpleQueue

from uwserver.ports import Argument, Call, Service, Value
from uwserver.sensors.job import Job, whole

log = logging.getLogger(__name__)

DROP = Service(
    "world/drop_reading",
    "Lose a reading of a sensor that takes time (camera, imaging sonar): one under computation, or one that begins in this tick. "
    "A world in real time calls it by itself where the machine is too slow.",
    (
        Argument("port", "str", "of the sensor"),
        Argument("number", "int", "of the reading, as in `seq` of its sample", minimum=0, maximum=2**62),
    ),
)
CLOCK = "clock"
"""Source of its own calls."""


class Work:
    """A job and what came of it: the thread computes it, or whoever needs it first.

    Attributes:
        error: why it failed; "" where it did not, or not yet.
        is_begun: the thread has it.
        is_told: its failure was.
        is_cancelled: the thread need not compute it, as nobody waits for it now.
    """

    __slots__ = ("_blank", "_is_running", "_job", "_values", "error", "is_begun", "is_cancelled", "is_told")

    def __init__(self, job: Job, blank: tuple[Value, ...], is_running: threading.RLock) -> None:
        """A job; `blank`: its values where it fails; `is_running`: held by the thread that runs one, of all of a world."""
        self._job: Job | None = job
        self._blank, self._is_running = blank, is_running
        self._values: tuple[Value, ...] | None = None
        self.error = ""
        self.is_begun = self.is_cancelled = self.is_told = False

    @property
    def is_done(self) -> bool:
        """Whether nobody would wait for `result`."""
        return self._values is not None

    def result(self) -> tuple[Value, ...]:
        """What the job gave; waits for it, or runs it."""
        if self._values is None:
            self.run()
        assert self._values is not None
        return self._values

    @property
    def shared(self) -> object:
        """Of its job, see there; None once it is done."""
        return None if self._job is None else self._job.shared

    def run(self, between: Callable[[], None] | None = None) -> None:
        """Run the job, if nobody has; `between` its pieces, do what cannot wait."""
        with self._is_running:
            if self._job is None:
                return
            try:
                values = tuple(whole(self._job.pieces(), between))
                if len(values) != len(self._blank):
                    raise ValueError(f"its job gave {len(values)} values, not {len(self._blank)}")
            except Exception as error:  # a fault of one sensor must not end the simulation
                log.debug("a job failed", exc_info=True)
                self.error, values = f"{type(error).__name__}: {error}", self._blank
            self._values, self._job = values, None


Loose = tuple[Value, ...] | Work
"""Values of a reading that are no numbers, or who makes them."""


def settled(loose: Loose) -> tuple[Value, ...]:
    """The values; waits for them."""
    return loose.result() if isinstance(loose, Work) else loose


Waiting = tuple[int, int, Work]
"""When it is due (ns), its number, and itself."""


class Computing:
    """The thread of a world that computes readings.

    Attributes:
        dropped: readings lost in real time, by port.
        failed: readings that could not be computed, by port.
    """

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}
        self.failed: dict[str, int] = {}
        self._is_running = threading.RLock()
        self._numbers = count()
        # Those that wait, by when they are due, and a token for each in the queue: one that keeps an order of its own could not be put into by a
        # collector of garbage, which may come while this thread holds its lock.
        self._waiting: list[Waiting] = []
        self._queue: SimpleQueue[bool] = SimpleQueue()
        self._thread: threading.Thread | None = None
        # A world that nobody ends lets its thread go too.
        weakref.finalize(self, self._queue.put, False)

    def work(self, job: Job, blank: tuple[Value, ...]) -> Work:
        """A job that nobody computes yet."""
        return Work(job, blank, self._is_running)

    def begin(self, work: Work, due_ns: int) -> None:
        """Compute it, after those that are due before, and the piece that is in work of one that is not."""
        if self._thread is None:
            self._thread = threading.Thread(
                target=_compute, args=(self._queue, self._waiting), name="uwserver-computing", daemon=True
            )
            self._thread.start()
        work.is_begun = True
        heappush(self._waiting, (due_ns, next(self._numbers), work))
        self._queue.put(True)

    def end(self) -> None:
        """Let the thread end, after the job that it is at; who needs another computes it."""
        if self._thread is None:
            return
        with suppress(Empty):
            while True:
                self._queue.get_nowait()
        self._waiting.clear()
        self._queue.put(False)
        self._thread.join()
        self._waiting.clear()  # it may have put one back
        self._thread = None

    def count_drop(self, port: str, number: int) -> None:
        """A reading is lost."""
        self.dropped[port] = self.dropped.get(port, 0) + 1
        if self.dropped[port] == 1:
            log.warning(
                '"%s": reading %d was not computed in time and is lost; more are counted in world/status. Fewer beams or pixels, a lower '
                "rate_hz of all that take time, more time for each (read_out_s of a camera, processing_s of a sonar), or "
                '[world.clock] mode = "freerun" help',
                port, number,
            )  # fmt: skip

    def count_failure(self, port: str, number: int, error: str) -> None:
        """A reading could not be computed."""
        self.failed[port] = self.failed.get(port, 0) + 1
        if self.failed[port] == 1:
            log.error('"%s": reading %d could not be computed, and is invalid: %s', port, number, error)


def _compute(queue: SimpleQueue[bool], waiting: list[Waiting]) -> None:
    while queue.get():
        with suppress(IndexError):  # it ran between the pieces of another, or the world has ended meanwhile
            _run(heappop(waiting), waiting, ())


def _run(first: Waiting, waiting: list[Waiting], under_way: tuple[object, ...]) -> None:
    """Run a job, and between its pieces those that wait and are due before it; not what shares arrays with one that is `under_way`."""
    due_ns, _, work = first
    if work.is_cancelled:
        return
    shared = (*under_way, work.shared)

    def between() -> None:
        with suppress(IndexError):
            while waiting[0][0] < due_ns:
                # Taken before it is looked at: meanwhile another can come to the front.
                other = heappop(waiting)
                if other[0] >= due_ns or (other[2].shared is not None and other[2].shared in shared):
                    heappush(waiting, other)
                    return
                _run(other, waiting, shared)

    work.run(between)


def drop_call(port: str, number: int) -> Call:
    """The call by which a world in real time drops a reading."""
    return Call(DROP.path, {"port": port, "number": number}, CLOCK)
