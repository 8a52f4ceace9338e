"""Records a run while it goes on. See `uwserver.recording.format` for the file, `uwserver.recording.replay` for what can be done with it.

Three threads meet in one queue: the loop brings samples and events (a sink of the bus), the simulation thread brings requests and states (an
observer), and the thread "recorder" turns them into JSON and writes the file. Neither of the first two ever touches the file.

In real time samples are dropped and counted when the writer cannot keep up; in other modes the tick waits for it, so that nothing is lost.
Requests and states are never dropped: a replay needs all of them. A file that cannot be written any more ends the recording, not the world.
"""

from __future__ import annotations

import contextlib
import logging
import secrets
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from uwserver.ports import Call, Command, Event, Json, Port, Refused, Sample
from uwserver.recording.format import Request, StateHash, metadata
from uwserver.recording.foxglove import FoxgloveChannels
from uwserver.recording.looker import Looker
from uwserver.recording.opening import new_file, there_already, unwritable
from uwserver.recording.parts import FIRST_PART, ONE_FILE, PART, RUN, Rotation, later_parts, part_path
from uwserver.recording.states import Presence, Seen
from uwserver.recording.writer import RecordingWriter, TooManyChannels
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
NOTHING: Mapping[str, str] = {}
_DRAIN_S = 0.1
_BACKPRESSURE_S = 0.002


@dataclass(frozen=True)
class _State:
    """A state whose hash the writer computes: it is too slow for the tick."""

    index: int
    t_ns: int
    snapshot: Snapshot
    is_last: bool = False


@dataclass(frozen=True)
class _Ports:
    """Ports that there are from here on. Those of samples that still wait may be gone from the world when they are written."""

    ports: Mapping[str, Port]


_Item = tuple[Sample, ...] | Request | _State | _Ports | Presence | Seen | Event


class Recorder:
    """Writes one run to one file. A `Sink` on the loop, an `Observer` on the simulation thread.

    Args:
        path: a file that does not exist yet.
        world: as built, before its first tick.
        resolved: what it was built from.
        rotation: when it goes on in another file.
        foxglove: whether channels for Foxglove, Lichtblick and rerun are written beside our own.
    """

    def __init__(
        self, path: Path, world: World, resolved: Resolved, rotation: Rotation = ONE_FILE, *, foxglove: bool = True
    ) -> None:
        self._path, self._rotation = path, rotation
        self._foxglove = FoxgloveChannels(world, resolved) if foxglove else None
        self._world, self._resolved = world, resolved
        self._simulation: Simulation | None = None
        self._queue: deque[_Item] = deque()
        self._open = self._finished = False
        self._ending = threading.Event()
        self._error = ""
        self._looker = Looker(world, resolved)
        self._second = max(1, round(world.rate_hz))
        self._seen, self._known = world.ports, dict(world.ports)
        # Each counter has one thread that writes it: loop, simulation, recorder.
        self._samples_put = self._dropped = 0
        self._index = self._requests_put = 0
        self._samples_taken = self._requests_taken = self._samples = self._bytes = 0
        # Of the recorder's thread alone.
        self._head: dict[str, str] = {}
        self._part, self._part_ns, self._finished_bytes = FIRST_PART, world.t_ns, 0
        self._file: IO[bytes]
        self._writer: RecordingWriter

    @contextlib.contextmanager
    def running(self, simulation: Simulation, bus: Bus) -> Iterator[None]:
        """Record while the context is open. Enter it before the simulation runs, leave it when its thread has ended.

        Raises:
            OSError: the file exists already or cannot be written; the text names it and says what to do.
        """
        self._start(simulation.timing)
        thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._simulation = simulation
        simulation.observe(self)
        detach = bus.attach(self)
        self._open = True
        thread.start()
        log.info("recording to %s", self._path)
        try:
            yield
        except BaseException:
            # A server that could not even start leaves no file that its second try would refuse to overwrite.
            if self._index == 0 and self._samples_put == 0:
                self._error = "nothing was recorded"
                self._path.unlink(missing_ok=True)
            raise
        finally:
            detach()
            self._close(thread)

    @contextlib.contextmanager
    def stepped(self, timing: Timing, about: Mapping[str, str] = NOTHING) -> Iterator[None]:
        """Record a world that the caller steps, as a replay does, without a thread: `drain` after each tick writes it. All is written.

        Args:
            timing: what the head says of it.
            about: further keys of the metadata record: where the run comes from.

        Raises:
            OSError: as `running`; `drain`, too, when the file cannot be written any more.
        """
        self._start(timing, about)
        self._open = True
        with self._file:
            yield
            self._open = False
            self._look()
            self._queue.append(self._last_state())
            self.drain()
            self._writer.finish()
        self._finished = True

    def drain(self) -> None:
        """Write what waits; of a world that is `stepped`."""
        while self._queue:
            self._write_item(self._queue.popleft())

    @property
    def is_complete(self) -> bool:
        """Whether all was written that a replay needs, to the very end. Known after `running`."""
        return self._finished

    def abandon(self, reason: str) -> None:
        """Give the recording up: what was written stays, and the last state is not added."""
        self._fail(reason)

    def status(self) -> dict[str, Json]:
        """For ``world/status``: file, whether it is still written, what is in it, what is missing, and why it ended early."""
        return {
            "path": str(self._path),
            "recording": self._open and not self._error,
            "samples": self._samples,
            "requests": self._requests_taken,
            "bytes": self._bytes,
            "parts": self._part,
            "dropped": self._dropped,
            "error": self._error,
        }

    # -- loop -----------------------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Queue the samples of one tick."""
        if self._error:
            return
        if self._full(MAX_SAMPLES) and not self._may_wait():
            self._dropped += len(samples)
            return
        self._samples_put += len(samples)
        self._queue.append(tuple(samples))

    def put_event(self, event: Event) -> None:
        """Queue an event."""
        if not self._error:
            self._queue.append(event)

    # -- simulation thread ----------------------------------------------------------------------------------------------------------

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        """Queue a request."""
        if not self._open or self._error:
            return
        if self._requests_put - self._requests_taken >= MAX_REQUESTS:
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
            self._queue.append(_State(self._next_index(), world.t_ns, snapshot.take(world)))
        while self._may_wait() and self._full(MAX_SAMPLES // 2) and self._open and not self._error:
            self._ending.wait(_BACKPRESSURE_S)

    def _follow_ports(self) -> None:
        if self._world.ports is not self._seen:
            self._seen = self._world.ports
            self._queue.append(_Ports(self._seen))

    def _last_state(self) -> _State:
        return _State(self._next_index(), self._world.t_ns, snapshot.take(self._world), is_last=True)

    def _look(self) -> None:
        self._queue.extend(self._looker.look())

    def _next_index(self) -> int:
        index, self._index = self._index, self._index + 1
        return index

    # -- any thread -----------------------------------------------------------------------------------------------------------------

    def _full(self, limit: int) -> bool:
        return self._samples_put - self._samples_taken >= limit

    def _may_wait(self) -> bool:
        """Whether ticks are not paced by the wall clock: another mode, or steps of a paused world."""
        simulation = self._simulation
        return simulation is not None and (simulation.timing.mode != "realtime" or simulation.paused)

    def _fail(self, text: str) -> None:
        if not self._error:
            self._error = text
            log.error("recording to %s ended: %s; the world goes on without it", self._path, text)

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
            # After a full disk the last flush fails once more.
            with contextlib.suppress(OSError):
                self._file.close()

    def _write(self) -> None:
        time = SystemTime()
        flushed = time.now_ns()
        while not self._error:
            # Asked before draining: what was queued before the end is still written.
            ending = self._ending.is_set()
            while self._queue and not self._error:
                self._write_item(self._queue.popleft())
                now = time.now_ns()
                if now - flushed >= CHUNK_NS:
                    self._flush()
                    flushed = now
            if ending:
                self._writer.finish()
                self._file.flush()
                self._bytes = self._finished_bytes + self._file.tell()
                self._file.close()  # which may tell only now that the disk is full
                self._finished = not self._error
                return
            if time.now_ns() - flushed >= CHUNK_NS:
                self._flush()
                flushed = time.now_ns()
            self._ending.wait(_DRAIN_S)

    def _flush(self) -> None:
        self._writer.flush()
        self._bytes = self._finished_bytes + self._file.tell()

    def _turn_over(self, state: _State) -> None:
        """Go on in the next part, which begins with this state."""
        path = part_path(self._path, self._part + 1)
        data = snapshot.to_bytes(self._world, state.snapshot)
        file = path.open("xb")
        try:
            writer = RecordingWriter(file, {**self._head, PART: str(self._part + 1)}, self._known, self._foxglove)
            writer.begin_at(data)
            writer.follow(self._writer, state.snapshot.tick, state.t_ns)
            self._writer.finish()
            self._finished_bytes += self._file.tell()
            self._file.close()
        except BaseException:
            with contextlib.suppress(OSError):
                file.close()
            raise
        self._file, self._writer = file, writer
        self._part, self._part_ns = self._part + 1, state.t_ns
        log.info("recording to %s", path)

    def _write_item(self, item: _Item) -> None:
        writer = self._writer
        if isinstance(item, tuple):
            for sample in item:
                writer.sample(sample, self._known)
            self._samples += len(item)
            self._samples_taken += len(item)
        elif isinstance(item, Request):
            writer.request(item, self._world.ticks.time_of(item.tick), self._known)
            self._requests_taken += 1
        elif isinstance(item, _State):
            writer.hash(StateHash(item.index, item.snapshot.tick, item.snapshot.hash()), item.t_ns)
            if self._rotation and not item.is_last:
                self._flush()
                seconds = abs(item.t_ns - self._part_ns) / NANOSECONDS  # a reset sets the time back
                if self._rotation.is_due(self._file.tell(), seconds):
                    self._turn_over(item)
        elif isinstance(item, _Ports):
            writer.know(port for path, port in item.ports.items() if self._known.get(path) is not port)
            self._known |= item.ports
        elif isinstance(item, Presence):
            writer.presence(item)
        elif isinstance(item, Seen):
            writer.state(item)
        else:
            writer.event(item)

    # -- start and end ------------------------------------------------------------------------------------------------------------

    def _start(self, timing: Timing, about: Mapping[str, str] = NOTHING) -> None:
        """A new file with its head. An old recording is never overwritten: it may be the only one of its run."""
        self._head = {**metadata(self._resolved, self._world.seed, timing), **about}
        if self._rotation:
            self._head |= {RUN: secrets.token_hex(8), PART: str(FIRST_PART)}
            self._world.identity()  # now, as later it would cost the recorder's thread a moment
            try:
                for other in later_parts(self._path).values():
                    raise there_already(other)
            except FileNotFoundError as error:
                raise unwritable(self._path, error) from error
        file = new_file(self._path)
        try:
            self._file, self._writer = file, RecordingWriter(file, self._head, self._world.ports, self._foxglove)
        except OSError as error:
            with contextlib.suppress(OSError):
                file.close()
            self._path.unlink(missing_ok=True)
            raise unwritable(self._path, error) from error

    def _close(self, thread: threading.Thread) -> None:
        self._open = False
        if not self._error:
            self._look()
            self._queue.append(self._last_state())
        self._ending.set()
        written = -1
        while thread.is_alive() and written != (written := self._samples_taken + self._requests_taken):
            thread.join(CLOSE_TIMEOUT_S)
        if thread.is_alive():
            log.warning("%s is incomplete: the disk does not answer; it can be read up to its last chunk", self._path)
        if self._dropped:
            total = self._dropped + self._samples
            log.warning(
                "%d of %d samples are missing in %s: it was written too slowly; a replay is not affected",
                self._dropped, total, self._path,
            )  # fmt: skip
