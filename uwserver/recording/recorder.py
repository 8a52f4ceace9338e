"""Records a run while it goes on. See `uwserver.recording.format` for the file, `uwserver.recording.replay` for what can be done with it.

Three threads meet in one queue: the loop brings samples and events (a sink of the bus), the simulation thread brings requests and states (an
observer), and the thread "recorder" turns them into JSON and writes the file. Neither of the first two ever touches the file.

In real time samples are dropped and counted when the writer cannot keep up; in other modes the tick waits for it, so that nothing is lost.
Requests and states are never dropped: a replay needs all of them. A file that cannot be written any more ends the recording, not the world.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from uwserver.ports import Call, Command, Event, Json, Port, Sample, SceneState
from uwserver.recording.format import RecordingWriter, Request, StateHash, TooManyChannels, metadata
from uwserver.recording.foxglove import FoxgloveChannels
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import water_view
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime
from uwserver.simulation.intake import BEGIN
from uwserver.simulation.thread import Simulation
from uwserver.units import NANOSECONDS
from uwserver.world import snapshot
from uwserver.world.lookout import Lookout
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


@dataclass(frozen=True)
class _State:
    """A state whose hash the writer computes: it is too slow for the tick."""

    index: int
    t_ns: int
    snapshot: Snapshot


@dataclass(frozen=True)
class _Ports:
    """Ports that there are from here on. Those of samples that still wait may be gone from the world when they are written."""

    ports: Mapping[str, Port]


class _Looker:
    """Sees who is in a world and where, at most `STATES_HZ` a second. Simulation thread."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved
        self._lookout = Lookout(world)
        self._every = max(1, math.ceil(world.rate_hz / STATES_HZ))
        self._seen: Presence | None = None
        self._current = world.water.current
        self._began: int | None = None
        self._jumps, self._is_blind = world.jumps, False

    def begin(self) -> None:
        """From here on whoever is told events hears of each jump."""
        if self._began is None:
            self._began = self._world.jumps

    def look(self) -> tuple[Presence | Seen, ...]:
        """Who is there, if that has changed, and where, if it is time to tell."""
        world, seen = self._world, self._seen
        self.begin()
        is_as_before = seen is not None and seen.ports is world.ports and seen.services is world.services
        if self._is_blind or (world.tick % self._every and world.jumps == self._jumps and is_as_before):
            return ()
        self._jumps = world.jumps
        try:
            state = self._lookout.state()
            found = Seen(self._since_began, state)
            presence = self._presence(state)
        except Exception:  # a fault of ours in what only viewers need must end neither world nor recording
            self._is_blind = True
            log.exception("where the bodies are cannot be told: the recording goes on without it")
            return ()
        return (found,) if presence is None else (presence, found)

    @property
    def _since_began(self) -> int:
        return self._world.jumps - (self._began or 0)

    def _presence(self, state: SceneState) -> Presence | None:
        world, seen = self._world, self._seen
        if seen and seen.cast is state.cast and seen.ports is world.ports and seen.services is world.services:
            return None
        models = {name: member.vehicle.model for name, member in world.members.items()}
        is_other_water = seen is None or self._current != state.current
        water = water_view(self._resolved, world) if is_other_water else None
        self._current = state.current
        self._seen = Presence(
            state.cast, self._since_began, world.tick, world.t_ns, world.ports, world.services, models, water
        )
        return self._seen


_Item = tuple[Sample, ...] | Request | _State | _Ports | Presence | Seen | Event


class Recorder:
    """Writes one run to one file. A `Sink` on the loop, an `Observer` on the simulation thread.

    Args:
        path: a file that does not exist yet.
        world: as built, before its first tick.
        resolved: what it was built from.
        foxglove: whether channels for Foxglove, Lichtblick and rerun are written beside our own.
    """

    def __init__(self, path: Path, world: World, resolved: Resolved, *, foxglove: bool = True) -> None:
        self._foxglove = FoxgloveChannels(world, resolved) if foxglove else None
        self._path = path
        self._world = world
        self._resolved = resolved
        self._simulation: Simulation | None = None
        self._queue: deque[_Item] = deque()
        self._open = self._finished = False
        self._ending = threading.Event()
        self._error = ""
        self._looker = _Looker(world, resolved)
        self._second = max(1, round(world.rate_hz))
        self._seen = world.ports
        self._known = dict(world.ports)
        # Each counter has one thread that writes it: loop, simulation, recorder.
        self._samples_put = self._dropped = 0
        self._index = self._requests_put = 0
        self._samples_taken = self._requests_taken = self._samples = self._bytes = 0

    @contextlib.contextmanager
    def running(self, simulation: Simulation, bus: Bus) -> Iterator[None]:
        """Record while the context is open. Enter it before the simulation runs, leave it when its thread has ended.

        Raises:
            OSError: the file exists already or cannot be written; the text names it and says what to do.
        """
        file, writer = self._started(simulation)
        thread = threading.Thread(target=self._run, args=(file, writer), name="recorder", daemon=True)
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

    def _run(self, file: IO[bytes], writer: RecordingWriter) -> None:
        try:
            self._write(writer, file)
        except OSError as error:
            self._fail(error.strerror or str(error))
        except TooManyChannels as error:
            self._fail(str(error))
        except Exception as error:
            self._fail(f"internal fault: {error}")
            log.exception("the recorder failed")
        finally:
            self._queue.clear()
            # After a full disk the last flush fails once more.
            with contextlib.suppress(OSError):
                file.close()

    def _write(self, writer: RecordingWriter, file: IO[bytes]) -> None:
        time = SystemTime()
        flushed = time.now_ns()
        while not self._error:
            # Asked before draining: what was queued before the end is still written.
            ending = self._ending.is_set()
            while self._queue and not self._error:
                self._write_item(writer, self._queue.popleft())
                now = time.now_ns()
                if now - flushed >= CHUNK_NS:
                    writer.flush()
                    flushed, self._bytes = now, file.tell()
            if ending:
                writer.finish()
                file.flush()
                self._bytes = file.tell()
                file.close()  # which may tell only now that the disk is full
                self._finished = not self._error
                return
            if time.now_ns() - flushed >= CHUNK_NS:
                writer.flush()
                flushed, self._bytes = time.now_ns(), file.tell()
            self._ending.wait(_DRAIN_S)

    def _write_item(self, writer: RecordingWriter, item: _Item) -> None:
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

    def _started(self, simulation: Simulation) -> tuple[IO[bytes], RecordingWriter]:
        """A new file with its head. An old recording is never overwritten: it may be the only one of its run."""
        head = metadata(self._resolved, self._world.seed, simulation.timing)
        try:
            file = self._path.open("xb")
        except FileExistsError:
            text = f"cannot record to {self._path}: it exists already; give --record another name, or remove it first"
            raise FileExistsError(text) from None
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            return file, RecordingWriter(file, head, self._world.ports, self._foxglove)
        except OSError as error:
            with contextlib.suppress(OSError):
                file.close()
            self._path.unlink(missing_ok=True)
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> OSError:
        reason = error.strerror or str(error)
        return OSError(f"cannot record to {self._path}: {reason}; give --record a place that can be written")

    def _close(self, thread: threading.Thread) -> None:
        self._open = False
        if not self._error:
            self._look()
            self._queue.append(_State(self._next_index(), self._world.t_ns, snapshot.take(self._world)))
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
