"""Computes readings that take time, in a thread of the world.

The thread begins with the first job and ends with the world. A world always waits for a reading that is due, so its run does not depend on
the speed of the machine. In real time, the simulation calls `PendingJobs.late` before each tick and posts the calls that it returns. These
calls drop readings, so that the world need not wait for them.
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
    "Drop a reading of a sensor that takes time (camera, imaging sonar): one under computation, or one that begins in this tick. "
    "A world in real time calls it by itself if the machine is too slow.",
    (
        Argument("port", "str", "port of the sensor"),
        Argument("number", "int", "number of the reading, as in `seq` of its sample", minimum=0, maximum=2**62),
    ),
)
CLOCK = "clock"
"""Source of the calls that a world in real time makes itself."""


class Work:
    """A job and its result. The thread computes it, or the first caller that needs the result does.

    Attributes:
        error: why the job failed; "" if it has not failed.
        is_begun: the thread has taken the job.
        is_told: the failure was reported.
        is_cancelled: the result is no longer needed, so the thread need not compute it.
    """

    __slots__ = ("_blank", "_is_running", "_job", "_values", "error", "is_begun", "is_cancelled", "is_told")

    def __init__(self, job: Job, blank: tuple[Value, ...], is_running: threading.RLock) -> None:
        """Take a job. `blank` has the values for the case that it fails. The thread that runs a job of the world holds the lock
        `is_running`."""
        self._job: Job | None = job
        self._blank, self._is_running = blank, is_running
        self._values: tuple[Value, ...] | None = None
        self.error = ""
        self.is_begun = self.is_cancelled = self.is_told = False

    @property
    def is_done(self) -> bool:
        """Whether `result` returns at once."""
        return self._values is not None

    def result(self) -> tuple[Value, ...]:
        """Return the result of the job. Waits for it, or computes it here."""
        if self._values is None:
            self.run()
        assert self._values is not None
        return self._values

    @property
    def shared(self) -> object:
        """`Job.shared` of the job; None once it is done."""
        return None if self._job is None else self._job.shared

    def run(self, between: Callable[[], None] | None = None) -> None:
        """Run the job, if it has not run yet. `between` is called between its pieces, for work that cannot wait."""
        with self._is_running:
            if self._job is None:
                return
            try:
                values = tuple(whole(self._job.pieces(), between))
                if len(values) != len(self._blank):
                    raise ValueError(f"the job gave {len(values)} values, not {len(self._blank)}")
            except Exception as error:  # A fault of one sensor must not end the simulation.
                log.debug("a job failed", exc_info=True)
                self.error, values = f"{type(error).__name__}: {error}", self._blank
            self._values, self._job = values, None


Loose = tuple[Value, ...] | Work
"""The values of a reading that are no numbers, or the job that makes them."""


def wait_for_values(loose: Loose) -> tuple[Value, ...]:
    """Return the values. Waits for them if they are under computation."""
    return loose.result() if isinstance(loose, Work) else loose


Waiting = tuple[int, int, Work]
"""The time at which a job is due (ns), its number, and the job."""


class Computing:
    """The thread of a world that computes readings.

    Attributes:
        dropped: number of readings lost in real time, by port.
        failed: number of readings that could not be computed, by port.
    """

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}
        self.failed: dict[str, int] = {}
        self._is_running = threading.RLock()
        self._numbers = count()
        # The jobs are in a heap, and the queue has only one token for each of them. A `PriorityQueue` would not do: the garbage collector
        # may put an item into the queue (see `finalize` below) while this thread holds the lock of the queue. `SimpleQueue.put` is safe
        # there.
        self._waiting: list[Waiting] = []
        self._queue: SimpleQueue[bool] = SimpleQueue()
        self._thread: threading.Thread | None = None
        # A world that is dropped without `end` also ends its thread.
        weakref.finalize(self, self._queue.put, False)

    def work(self, job: Job, blank: tuple[Value, ...]) -> Work:
        """Return a job that is not computed yet."""
        return Work(job, blank, self._is_running)

    def begin(self, work: Work, due_ns: int) -> None:
        """Let the thread compute a job. Jobs that are due earlier come first; so does the present piece of a job that is due later."""
        if self._thread is None:
            self._thread = threading.Thread(
                target=_compute, args=(self._queue, self._waiting), name="uwserver-computing", daemon=True
            )
            self._thread.start()
        work.is_begun = True
        heappush(self._waiting, (due_ns, next(self._numbers), work))
        self._queue.put(True)

    def end(self) -> None:
        """End the thread after its present job. Jobs that still wait are computed by the callers that need them."""
        if self._thread is None:
            return
        with suppress(Empty):
            while True:
                self._queue.get_nowait()
        self._waiting.clear()
        self._queue.put(False)
        self._thread.join()
        self._waiting.clear()  # The thread may have put one back.
        self._thread = None

    def count_drop(self, port: str, number: int) -> None:
        """Count a lost reading; the first one of a port is logged."""
        self.dropped[port] = self.dropped.get(port, 0) + 1
        if self.dropped[port] == 1:
            log.warning(
                '"%s": reading %d was not computed in time and is lost; world/status counts all of them. To avoid this, use fewer beams or '
                "pixels, a lower rate_hz for all such sensors, more time for each reading (read_out_s of a camera, processing_s of a sonar), or "
                '[world.clock] mode = "freerun"',
                port, number,
            )  # fmt: skip

    def count_failure(self, port: str, number: int, error: str) -> None:
        """Count a reading that could not be computed; the first one of a port is logged."""
        self.failed[port] = self.failed.get(port, 0) + 1
        if self.failed[port] == 1:
            log.error('"%s": reading %d could not be computed, and is invalid: %s', port, number, error)


def _compute(queue: SimpleQueue[bool], waiting: list[Waiting]) -> None:
    while queue.get():
        with suppress(IndexError):  # The job ran between the pieces of another one, or the world has ended meanwhile.
            _run(heappop(waiting), waiting, ())


def _run(first: Waiting, waiting: list[Waiting], under_way: tuple[object, ...]) -> None:
    """Run a job, and between its pieces the jobs that wait and are due earlier. A job that shares arrays with one of `under_way` is not run
    there."""
    due_ns, _, work = first
    if work.is_cancelled:
        return
    shared = (*under_way, work.shared)

    def between() -> None:
        with suppress(IndexError):
            while waiting[0][0] < due_ns:
                # Taken out before it is examined, as another job may come to the front meanwhile.
                other = heappop(waiting)
                if other[0] >= due_ns or (other[2].shared is not None and other[2].shared in shared):
                    heappush(waiting, other)
                    return
                _run(other, waiting, shared)

    work.run(between)


def drop_call(port: str, number: int) -> Call:
    """Return the call by which a world in real time drops a reading."""
    return Call(DROP.path, {"port": port, "number": number}, CLOCK)
