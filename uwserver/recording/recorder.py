"""Records a run while it is going on. `uwserver.recording.format` describes the file, `uwserver.recording.replay` runs it again.

Three threads share a queue. The loop adds samples and events (as a sink of the bus), the simulation thread adds requests and states (as an
observer), and the thread "recorder" encodes them as JSON and writes the file. The first two never touch the file. `SceneRecorder` observes the bodies
of the world and their poses, for playback.

In real time, samples are dropped and counted when the writer cannot keep up; in other modes the tick waits for the writer, so that nothing is lost.
Requests and states are never dropped, because a replay needs all of them. If the file cannot be written any more, the recording ends, but the
world continues.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from uwserver.ports import Call, Command, Event, Json, Refused, Sample, SceneState
from uwserver.ports.sample_batch import SampleBatch
from uwserver.recording.format import Request
from uwserver.recording.output import NOTHING, Item, Output, Ports, State
from uwserver.recording.parts import ONE_FILE, Rotation
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.recording.writer import TooManyChannels
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import water_view
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.intake import BEGIN
from uwserver.simulation.thread import Simulation
from uwserver.units import NANOSECONDS
from uwserver.world import snapshot
from uwserver.world.state.scene_probe import SceneProbe
from uwserver.world.state.snapshot import Snapshot
from uwserver.world.world import World

log = logging.getLogger(__name__)

MAX_SAMPLES = 32_768
"""Number of samples that may wait for the writer."""
MAX_REQUESTS = 50_000
"""Number of requests that may wait for the writer, half a second of its work. With more the recording ends, because it could not be replayed without
them."""
CHUNK_NS = NANOSECONDS // 2
"""A chunk is written at the latest after this wall time. A killed server loses at most that."""
CLOSE_TIMEOUT_S = 5.0
"""Wall time in which the writer must make progress at the end, however much is left to write."""
_DRAIN_S = 0.1
_BACKPRESSURE_S = 0.002


class SceneRecorder:
    """Observes the bodies of a world and their poses, at most `STATES_HZ` times a second. Runs on the simulation thread."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved
        self._probe = SceneProbe(world)
        self._every = max(1, math.ceil(world.rate_hz / STATES_HZ))
        self._seen: Presence | None = None
        self._current = world.water.current
        self._began: int | None = None
        self._jumps, self._has_failed = world.jumps, False

    def begin(self) -> None:
        """Count the jumps of time from here on. Later calls do nothing."""
        if self._began is None:
            self._began = self._world.jumps

    def next_tick(self, tick: int) -> int:
        """Return the next tick at which poses are due; the very next one if none were taken yet."""
        return tick + 1 if self._seen is None and not self._has_failed else tick + self._every - tick % self._every

    def changes(self) -> tuple[Presence | Seen, ...]:
        """Return the bodies, ports and services, if they changed, and the poses, if they are due."""
        world, seen = self._world, self._seen
        self.begin()
        is_as_before = seen is not None and seen.ports is world.ports and seen.services is world.services
        if self._has_failed or (world.tick % self._every and world.jumps == self._jumps and is_as_before):
            return ()
        self._jumps = world.jumps
        try:
            state = self._probe.state()
            found = Seen(self._since_began, state)
            presence = self._presence(state)
        except Exception:  # an internal fault in data for viewers only must end neither the world nor the recording
            self._has_failed = True
            log.exception("the poses of the bodies cannot be recorded; the recording continues without them")
            return ()
        return (found,) if presence is None else (presence, found)

    @property
    def _since_began(self) -> int:
        return self._world.jumps - (self._began or 0)

    def _presence(self, state: SceneState) -> Presence | None:
        world, seen = self._world, self._seen
        if seen and seen.entities is state.entities and seen.ports is world.ports and seen.services is world.services:
            return None
        models = {name: member.vehicle.model for name, member in world.members.items()}
        has_other_water = seen is None or self._current != state.current
        water = water_view(self._resolved, world) if has_other_water else None
        self._current = state.current
        self._seen = Presence(
            state.entities, self._since_began, world.tick, world.t_ns, world.ports, world.services, models, water
        )
        return self._seen


class Recorder:
    """Writes one run to one file. It is a `Sink` on the loop, and an `Observer` on the simulation thread.

    To record a run from its start, use `running` or `stepped`. To begin and end during a run, call in this order: `open`, `begin`, `write_from`,
    `end`, `close`; from `begin` to `end` it must be attached to the bus as a sink.

    Args:
        path: a file that does not exist yet.
        world: before its first tick; for `begin` at any time.
        resolved: the scenario from which it was built.
        rotation: limits of a part.
        foxglove: whether channels for Foxglove, Lichtblick and rerun are added.
    """

    def __init__(
        self, path: Path, world: World, resolved: Resolved, rotation: Rotation = ONE_FILE, *, foxglove: bool = True
    ) -> None:
        self.path = path
        self._seen = world.ports  # taken before `Output` reads the ports, so that no later change is missed
        self._output = Output(path, world, resolved, rotation, foxglove=foxglove)
        self._world = world
        self._simulation: Simulation | None = None
        self._queue: deque[Item] = deque()
        self._open = self._finished = False
        self._ending = threading.Event()
        self._error = ""
        self._scene_recorder = SceneRecorder(world, resolved)
        self._second = max(1, round(world.rate_hz))
        # Only one thread writes each counter, so that they need no lock.
        self._samples_put = self._dropped = 0  # loop
        self._index = self._requests_put = 0  # simulation
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
            # A server that failed to start leaves no file, because the next try would refuse to overwrite it.
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
        """Record a world that the caller steps, as a replay does, without a thread. Call `drain` after each tick; nothing is dropped.

        Args:
            timing: timing of the run, for the head.
            about: further keys of the metadata record, which say where the run comes from.

        Raises:
            OSError: as `running`. `drain` raises it too, when the file cannot be written any more.
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
        """Write everything in the queue, while `stepped` is active."""
        while self._queue:
            self._output.write(self._queue.popleft())

    # -- during a run ---------------------------------------------------------------------------------------------------------------

    def open(self, timing: Timing) -> None:
        """Make the file. On any thread. Raises OSError as `running`."""
        self._output.open(timing, is_midway=True)

    def begin(self, simulation: Simulation) -> Snapshot:
        """Observe a run from here on; return the state with which the recording begins. On the simulation thread, between two ticks."""
        self._simulation = simulation
        state = snapshot.take(self._world)
        self._open = True
        self._follow_ports()
        self._queue.extend(self._scene_recorder.changes())
        simulation.observe(self)
        return state

    def write_from(self, state: Snapshot) -> None:
        """Write the state with which the recording begins, and start to write the queue. On any thread; it waits for the disk.

        Raises:
            OSError: the file cannot be written.
            Refused: the state is too large to be loaded again.
        """
        self._output.begin_at(state)
        self._thread.start()
        log.info("recording to %s", self.path)

    def end(self) -> None:
        """Stop observing; the current state becomes the last of the recording. On the simulation thread between two ticks, or after its end."""
        if not self._open:
            return
        self._open = False
        if self._simulation is not None:
            self._simulation.observe(None)
        if not self._error:
            self._queue.extend(self._scene_recorder.changes())
            self._queue.append(State(self._next_index(), self._world.t_ns, snapshot.take(self._world), is_last=True))

    def close(self) -> None:
        """Write the rest of the queue and the end of the file. After `end`, on any thread; it waits for the disk."""
        self._ending.set()
        if self._thread.ident is None:  # the thread was never started
            self._output.close()
            return
        written = -1
        while self._thread.is_alive() and written != (written := self._output.samples + self._output.requests):
            self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            log.warning(
                "%s is incomplete, because the disk does not respond; it can be read up to its last chunk", self.path
            )
        if self._dropped:
            total = self._dropped + self._output.samples
            log.warning(
                "%d of %d samples are missing in %s, because it was written too slowly; a replay is not affected",
                self._dropped, total, self.path,
            )  # fmt: skip

    # -- status ---------------------------------------------------------------------------------------------------------------------

    @property
    def is_complete(self) -> bool:
        """Return whether everything that a replay needs was written, up to the end. Known after `running`, or `close`."""
        return self._finished

    def abandon(self, reason: str) -> None:
        """End the recording early, unless that has happened already. What was written stays; the last state is not added. On any thread."""
        if not self._error:
            self._error = reason
            log.error("recording to %s ended: %s; the world continues without it", self.path, reason)

    def status(self) -> dict[str, Json]:
        """Return the part of ``world/status`` about the recording: its file, progress, losses, and why it ended early."""
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

    def put_batch(self, batch: SampleBatch) -> None:
        """Queue the samples of a few ticks as rows; samples are made of them only when they are written."""
        if self._has_room(len(batch)):
            self._queue.append(batch)

    def _has_room(self, count: int) -> bool:
        """Return whether so many samples can be queued, and count them."""
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
            self.abandon(
                f"{MAX_REQUESTS} commands and calls wait to be written: they come faster than the recorder can write"
            )
            return
        self._requests_put += 1
        if item.source != BEGIN:  # loading the saved state with which a run begins is not a jump of time
            self._scene_recorder.begin()
        self._follow_ports()
        self._queue.append(Request.of(item, self._next_index(), batch, tick))

    def ticked(self, world: World) -> None:
        """Queue the state every simulated second. Wait for the writer if ticks are not paced by the wall clock."""
        if not self._open or self._error:
            return
        self._follow_ports()  # before the loop gets samples of this tick
        self._queue.extend(self._scene_recorder.changes())
        if world.tick % self._second == 0:
            self._queue.append(State(self._next_index(), world.t_ns, snapshot.take(world)))
        while self._may_wait() and self._full(MAX_SAMPLES // 2) and self._open and not self._error:
            self._ending.wait(_BACKPRESSURE_S)

    def next_tick(self, tick: int) -> int:
        """Return the next tick at which a state hash or poses are recorded."""
        return min(tick + self._second - tick % self._second, self._scene_recorder.next_tick(tick))

    def _follow_ports(self) -> None:
        if self._world.ports is not self._seen:
            self._seen = self._world.ports
            self._queue.append(Ports(self._seen))

    def _next_index(self) -> int:
        index, self._index = self._index, self._index + 1
        return index

    # -- any thread -----------------------------------------------------------------------------------------------------------------

    def _full(self, limit: int) -> bool:
        return self._samples_put - self._output.samples >= limit

    def _may_wait(self) -> bool:
        """Return whether ticks may wait for the writer, because the wall clock does not pace them: in other modes, or while the world is paused."""
        simulation = self._simulation
        return simulation is not None and (simulation.timing.mode != "realtime" or simulation.paused)

    # -- the recorder's thread ------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._write()
        except OSError as error:
            self.abandon(error.strerror or str(error))
        except (TooManyChannels, Refused) as error:
            self.abandon(str(error))
        except Exception as error:
            self.abandon(f"internal fault: {error}")
            log.exception("the recorder failed")
        finally:
            self._queue.clear()
            self._output.close()

    def _next(self) -> Item:
        """Take the oldest item; rows of samples together with the rows after them, which are written in one go."""
        item = self._queue.popleft()
        while isinstance(item, SampleBatch) and self._queue and isinstance(later := self._queue[0], SampleBatch):
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
            # Read before the queue is emptied, so that everything that was queued before the end is written.
            ending = self._ending.is_set()
            while True:
                if time.now_ns() - flushed >= CHUNK_NS:
                    self._output.flush()
                    flushed = time.now_ns()
                if not self._queue or self._error:
                    break
                self._output.write(self._next())
            if ending:
                self._output.finish()
                self._finished = not self._error
                return
            self._ending.wait(_DRAIN_S)
