"""Records a run while it goes on. See `uwserver.recording.format` for the file, `uwserver.recording.replay` for what can be done with it.

Three threads meet in one queue: the loop brings samples and events (a sink of the bus), the simulation thread brings requests and states (an
observer), and the thread "recorder" turns them into JSON and writes the file. Neither of the first two ever touches the file.

In real time samples are dropped and counted when the writer cannot keep up; in other modes the tick waits for it, so that nothing is lost.
Requests and states are never dropped: a replay needs all of them. A file that cannot be written any more ends the recording, not the world.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from uwserver.ports import Call, Command, Event, Json, Refused, Sample
from uwserver.ports.told import Told
from uwserver.recording.format import Request
from uwserver.recording.looker import Looker
from uwserver.recording.output import NOTHING, Item, Output, Ports, State
from uwserver.recording.parts import ONE_FILE, Rotation
from uwserver.recording.writer import TooManyChannels
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.intake import BEGIN
from uwserver.simulation.thread import Simulation
from uwserver.units import NANOSECONDS
from uwserver.world import snapshot
from uwserver.world.snapshot import Snapshot
from uwserver.world.world import World

log = logging.getLogger(__name__)

MAX_SAMPLES = 32_768
"""Samples that may wait for the writer."""

MAX_REQUESTS = 50_000
"""Requests that may wait for the writer, half a second of its work when the server ends; beyond that the recording ends,
because without them it could not be replayed."""

CHUNK_NS = NANOSECONDS // 2
"""A chunk is written at the latest after this wall time: that much a killed server loses."""

CLOSE_TIMEOUT_S = 5.0
"""Wall time in which the writer must proceed at the end, however much is left to write."""
_DRAIN_S = 0.1
_BACKPRESSURE_S = 0.002


class Recorder:
    """Writes one run to one file. A `Sink` on the loop, an `Observer` on the simulation thread.

    Who records a run from its start takes `running`, or `stepped`. Who begins and ends while it goes on calls, in this order: `open`, `begin`,
    `write_from`, `end`, `close`; from `begin` to `end` it is fed as an observer, and in the same time as a sink.

    Args:
        path: a file that does not exist yet.
        world: as built, before its first tick; or later, for `begin`.
        resolved: what it was built from.
        rotation: when it goes on in another file.
        foxglove: whether channels for Foxglove, Lichtblick and rerun are written beside our own.
    """

    def __init__(
        self, path: Path, world: World, resolved: Resolved, rotation: Rotation = ONE_FILE, *, foxglove: bool = True
    ) -> None:
        self.path = path
        self._seen = world.ports  # before the file knows them: of those that come meanwhile it is told
        self._output = Output(path, world, resolved, rotation, foxglove=foxglove)
        self._world = world
        self._simulation: Simulation | None = None
        self._queue: deque[Item] = deque()
        self._open = self._finished = False
        self._ending = threading.Event()
        self._error = ""
        self._looker = Looker(world, resolved)
        self._second = max(1, round(world.rate_hz))
        # Each counter has one thread that writes it: loop, simulation.
        self._samples_put = self._dropped = 0
        self._index = self._requests_put = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    @contextlib.contextmanager
    def running(self, simulation: Simulation, bus: Bus) -> Iterator[None]:
        """Record while the context is open. Enter it before the simulation runs, leave it when its thread has ended.

        Raises:
            OSError: the file exists already or cannot be written; the text names it and says what to do.
        """
        self._output.open(simulation.timing)
        self._simulation = simulation
        simulation.observe(self)
        detach = bus.attach(self)
        self._open = True
        self._thread.start()
        log.info("recording to %s", self.path)
        try:
            yield
        except BaseException:
            # A server that could not even start leaves no file that its second try would refuse to overwrite.
            if self._index == 0 and self._samples_put == 0:
                self._error = "nothing was recorded"
                self.path.unlink(missing_ok=True)
            raise
        finally:
            detach()
            self.end()
            self.close()

    @contextlib.contextmanager
    def stepped(self, timing: Timing, about: Mapping[str, str] = NOTHING) -> Iterator[None]:
        """Record a world that the caller steps, as a replay does, without a thread: `drain` after each tick writes it. All is written.

        Args:
            timing: what the head says of it.
            about: further keys of the metadata record: where the run comes from.

        Raises:
            OSError: as `running`; `drain`, too, when the file cannot be written any more.
        """
        self._output.open(timing, about)
        self._open = True
        try:
            yield
            self.end()
            self.drain()
            self._output.finish()
        finally:
            self._output.close()
        self._finished = True

    def drain(self) -> None:
        """Write what waits; of a world that is `stepped`."""
        while self._queue:
            self._output.write(self._queue.popleft())

    # -- of a run that goes on ------------------------------------------------------------------------------------------------------

    def open(self, timing: Timing) -> None:
        """Make the file. Any thread. Raises OSError as `running`."""
        self._output.open(timing, is_midway=True)

    def begin(self, simulation: Simulation) -> Snapshot:
        """Follow a run from here on, and give the state with which the recording begins. Simulation thread, between two ticks."""
        self._simulation = simulation
        state = snapshot.take(self._world)
        self._open = True
        self._follow_ports()
        self._look()
        simulation.observe(self)
        return state

    def write_from(self, state: Snapshot) -> None:
        """Write the state with which it begins, and from now on what was queued behind it. Any thread, which waits for the disk.

        Raises:
            OSError: the file cannot be written.
            Refused: the state is too large to be loaded again.
        """
        self._output.begin_at(state)
        self._thread.start()
        log.info("recording to %s", self.path)

    def end(self) -> None:
        """Follow no more; the state is the last of the recording. Simulation thread between two ticks, or when that has ended."""
        if not self._open:
            return
        self._open = False
        if self._simulation is not None:
            self._simulation.observe(None)
        if not self._error:
            self._look()
            self._queue.append(State(self._next_index(), self._world.t_ns, snapshot.take(self._world), is_last=True))

    def close(self) -> None:
        """Write what waits, and the end of the file. After `end`; any thread, which waits for the disk."""
        self._ending.set()
        if self._thread.ident is None:  # it could not even begin
            self._output.close()
            return
        written = -1
        while self._thread.is_alive() and written != (written := self._output.samples + self._output.requests):
            self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            log.warning("%s is incomplete: the disk does not answer; it can be read up to its last chunk", self.path)
        if self._dropped:
            total = self._dropped + self._output.samples
            log.warning(
                "%d of %d samples are missing in %s: it was written too slowly; a replay is not affected",
                self._dropped, total, self.path,
            )  # fmt: skip

    # -- how it stands --------------------------------------------------------------------------------------------------------------

    @property
    def is_complete(self) -> bool:
        """Whether all was written that a replay needs, to the very end. Known after `running`, or `close`."""
        return self._finished

    def abandon(self, reason: str) -> None:
        """Give the recording up: what was written stays, and the last state is not added."""
        self._fail(reason)

    def status(self) -> dict[str, Json]:
        """For ``world/status``: file, whether it is still written, since when, what is in it, what is missing, and why it ended early."""
        output = self._output
        return {
            "path": str(self.path),
            "recording": self._open and not self._error,
            "since_ns": output.since_ns,
            "samples": output.samples,
            "requests": output.requests,
            "bytes": output.bytes,
            "parts": output.part,
            "dropped": self._dropped,
            "error": self._error,
        }

    # -- loop -----------------------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Queue the samples of one tick."""
        if self._has_room(len(samples)):
            self._queue.append(tuple(samples))

    def put_told(self, told: Told) -> None:
        """Queue those of some ticks, as rows: nobody makes them before they are written."""
        if self._has_room(len(told)):
            self._queue.append(told)

    def _has_room(self, count: int) -> bool:
        """Whether so many samples can wait; they are counted."""
        if self._error:
            return False
        if self._full(MAX_SAMPLES) and not self._may_wait():
            self._dropped += count
            return False
        self._samples_put += count
        return True

    def put_event(self, event: Event) -> None:
        """Queue an event."""
        if not self._error:
            self._queue.append(event)

    # -- simulation thread ----------------------------------------------------------------------------------------------------------

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        """Queue a request."""
        if not self._open or self._error:
            return
        if self._requests_put - self._output.requests >= MAX_REQUESTS:
            self._fail(
                f"{MAX_REQUESTS} commands and calls wait to be written: they come faster than the recorder can write"
            )
            return
        self._requests_put += 1
        if item.source != BEGIN:  # of a saved state from which a run begins nobody hears
            self._looker.begin()
        self._follow_ports()
        self._queue.append(Request.of(item, self._next_index(), batch, tick))

    def ticked(self, world: World) -> None:
        """Queue the state each simulated second; wait for the writer where nobody waits for the tick."""
        if not self._open or self._error:
            return
        self._follow_ports()  # before the loop has any sample of this tick
        self._look()
        if world.tick % self._second == 0:
            self._queue.append(State(self._next_index(), world.t_ns, snapshot.take(world)))
        while self._may_wait() and self._full(MAX_SAMPLES // 2) and self._open and not self._error:
            self._ending.wait(_BACKPRESSURE_S)

    def next_tick(self, tick: int) -> int:
        """The next one of which it keeps a state, or where bodies are."""
        return min(tick + self._second - tick % self._second, self._looker.next_tick(tick))

    def _follow_ports(self) -> None:
        if self._world.ports is not self._seen:
            self._seen = self._world.ports
            self._queue.append(Ports(self._seen))

    def _look(self) -> None:
        self._queue.extend(self._looker.look())

    def _next_index(self) -> int:
        index, self._index = self._index, self._index + 1
        return index

    # -- any thread -----------------------------------------------------------------------------------------------------------------

    def _full(self, limit: int) -> bool:
        return self._samples_put - self._output.samples >= limit

    def _may_wait(self) -> bool:
        """Whether ticks are not paced by the wall clock: another mode, or steps of a paused world."""
        simulation = self._simulation
        return simulation is not None and (simulation.timing.mode != "realtime" or simulation.paused)

    def _fail(self, text: str) -> None:
        if not self._error:
            self._error = text
            log.error("recording to %s ended: %s; the world goes on without it", self.path, text)

    # -- the recorder's thread ------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._write()
        except OSError as error:
            self._fail(error.strerror or str(error))
        except (TooManyChannels, Refused) as error:
            self._fail(str(error))
        except Exception as error:
            self._fail(f"internal fault: {error}")
            log.exception("the recorder failed")
        finally:
            self._queue.clear()
            self._output.close()

    def _next(self) -> Item:
        """What waits longest; rows of samples with those that follow them, which are written in one go."""
        item = self._queue.popleft()
        while isinstance(item, Told) and self._queue and isinstance(later := self._queue[0], Told):
            together = item.followed_by(later)
            if together is None:
                break
            self._queue.popleft()
            item = together
        return item

    def _write(self) -> None:
        time = SystemTime()
        flushed = time.now_ns()
        while not self._error:
            # Asked before draining: what was queued before the end is still written.
            ending = self._ending.is_set()
            while self._queue and not self._error:
                self._output.write(self._next())
                now = time.now_ns()
                if now - flushed >= CHUNK_NS:
                    self._output.flush()
                    flushed = now
            if ending:
                self._output.finish()
                self._finished = not self._error
                return
            if time.now_ns() - flushed >= CHUNK_NS:
                self._output.flush()
                flushed = time.now_ns()
            self._ending.wait(_DRAIN_S)
