"""Writes the items that a recorder queued to the file of a recording, and to the next part when that is full. It runs outside the tick."""

from __future__ import annotations

import contextlib
import logging
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from uwserver.ports import Event, Port, Sample
from uwserver.ports.sample_batch import SampleBatch
from uwserver.recording.format import Request, StateHash, metadata
from uwserver.recording.parts import (
    BEGINS,
    FIRST_PART,
    ONE_FILE,
    PART,
    RUN,
    WITH_STATE,
    Rotation,
    later_parts,
    new_file,
    part_path,
    there_already,
    unwritable,
)
from uwserver.recording.states import Presence, Seen
from uwserver.recording.writer import FoxgloveChannels, RecordingWriter
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.clock import Timing
from uwserver.units import NANOSECONDS
from uwserver.world.state import snapshot
from uwserver.world.state.snapshot import Snapshot
from uwserver.world.world import World

log = logging.getLogger(__name__)

NOTHING: Mapping[str, str] = {}


@dataclass(frozen=True)
class State:
    """A state whose hash is computed when it is written, because that takes too long for the tick."""

    index: int
    t_ns: int
    snapshot: Snapshot
    is_last: bool = False


@dataclass(frozen=True)
class Ports:
    """The ports from here on. A port may have left the world by the time its queued samples are written."""

    ports: Mapping[str, Port]


Item = SampleBatch | tuple[Sample, ...] | Request | State | Ports | Presence | Seen | Event


class Output:
    """Writes the items of one run. Only one thread may use it at a time.

    Args:
        path: a file that does not exist yet.
        world: only its constants are read, and its ports at the start.
        resolved: the scenario from which it was built.
        rotation: limits of a part.
        foxglove: whether channels for Foxglove, Lichtblick and rerun are added.

    Attributes:
        samples, requests: numbers of those that were written.
        bytes: size of all parts up to the last chunk.
        part: number of the current part.
        since_ns: simulation time at which the recording begins.

    Methods that write raise OSError when the file cannot be written, TooManyChannels when a port gets no channel number, and Refused when a state
    is too large.
    """

    def __init__(
        self, path: Path, world: World, resolved: Resolved, rotation: Rotation = ONE_FILE, *, foxglove: bool = True
    ) -> None:
        self._path, self._world, self._resolved, self._rotation = path, world, resolved, rotation
        self._foxglove = FoxgloveChannels(world, resolved) if foxglove else None
        self._known = dict(world.ports)
        self._head: dict[str, str] = {}
        self.samples = self.requests = self.bytes = 0
        self.part, self.since_ns = FIRST_PART, world.t_ns
        self._part_ns, self._finished_bytes = world.t_ns, 0
        self._file: IO[bytes]
        self._writer: RecordingWriter

    def open(self, timing: Timing, about: Mapping[str, str] = NOTHING, *, is_midway: bool = False) -> None:
        """Make a new file with its head. An old recording is never overwritten: it may be the only record of its run.

        Args:
            timing: timing of the run, for the head.
            about: further keys of the metadata record.
            is_midway: the run has begun already; `begin_at` follows.

        Raises:
            OSError: the file exists already or cannot be written; the text names it and says what to do.
        """
        self._head = {**metadata(self._resolved, self._world.seed, timing), **about}
        if is_midway:
            self._head[BEGINS] = WITH_STATE
        if is_midway or self._rotation:
            self._world.identity()  # computed once; later it would delay the recorder's thread
        if self._rotation:
            self._head |= {RUN: secrets.token_hex(8), PART: str(FIRST_PART)}
            try:
                for other in later_parts(self._path).values():
                    raise there_already(other)
            except FileNotFoundError as error:
                raise unwritable(self._path, error) from error
        file = new_file(self._path)
        try:
            self._file, self._writer = file, RecordingWriter(file, self._head, self._known, self._foxglove)
        except BaseException as error:
            with contextlib.suppress(OSError):
                file.close()
            self._path.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise unwritable(self._path, error) from error
            raise

    def begin_at(self, state: Snapshot) -> None:
        """Write the state of the world with which the recording begins. Call it before any item is written."""
        self._part_ns = self.since_ns = self._world.ticks.time_of(state.tick)
        self._writer.begin_at(snapshot.to_bytes(self._world, state))
        self.flush()

    def write(self, item: Item) -> None:
        """Write one item."""
        writer = self._writer
        if isinstance(item, SampleBatch):
            writer.rows(item, self._known)
            self.samples += len(item)
        elif isinstance(item, tuple):
            for sample in item:
                writer.sample(sample, self._known)
            self.samples += len(item)
        elif isinstance(item, Request):
            writer.request(item, self._world.ticks.time_of(item.tick), self._known)
            self.requests += 1
        elif isinstance(item, State):
            writer.hash(StateHash(item.index, item.snapshot.tick, item.snapshot.hash()), item.t_ns)
            if self._rotation and not item.is_last:
                self.flush()
                seconds = abs(item.t_ns - self._part_ns) / NANOSECONDS  # a reset sets the time back
                if self._rotation.is_due(self._file.tell(), seconds):
                    self._turn_over(item)
        elif isinstance(item, Ports):
            writer.know(port for path, port in item.ports.items() if self._known.get(path) is not port)
            self._known |= item.ports
        elif isinstance(item, Presence):
            writer.presence(item)
        elif isinstance(item, Seen):
            writer.state(item)
        else:
            writer.event(item)

    def flush(self) -> None:
        """End the chunk in progress and pass everything to the operating system."""
        self._writer.flush()
        self.bytes = self._finished_bytes + self._file.tell()

    def finish(self) -> None:
        """Write the index and the statistics, and close the file. Nothing can be written afterwards."""
        self._writer.finish()
        self._file.flush()
        self.bytes = self._finished_bytes + self._file.tell()
        self._file.close()  # some file systems report a full disk only here

    def close(self) -> None:
        """Close the file, whatever was written. After `finish` it does nothing."""
        with contextlib.suppress(OSError):  # on a full disk the last flush fails again
            self._file.close()

    def _turn_over(self, state: State) -> None:
        """Continue in the next part, which begins with this state."""
        path = part_path(self._path, self.part + 1)
        data = snapshot.to_bytes(self._world, state.snapshot)
        file = path.open("xb")
        try:
            writer = RecordingWriter(file, {**self._head, PART: str(self.part + 1)}, self._known, self._foxglove)
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
        self.part, self._part_ns = self.part + 1, state.t_ns
        log.info("recording to %s", path)
