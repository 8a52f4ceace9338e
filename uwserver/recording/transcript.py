"""Writes what a world does that a replay steps: a recording of its own, which can be replayed again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from uwserver.ports import Port
from uwserver.ports.crossing import TickOutput
from uwserver.recording.format import RecordingWriter, Request, StateHash, metadata
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.clock import Timing
from uwserver.world import snapshot
from uwserver.world.world import World


class Transcript:
    """Beside `uwserver.recording.recorder` without threads and without haste: all is written at once, and nothing is dropped.

    Every method raises OSError when the file cannot be written.
    """

    def __init__(
        self, file: IO[bytes], world: World, resolved: Resolved, timing: Mapping[str, Any], about: Mapping[str, str]
    ) -> None:
        """Begin the file.

        Args:
            file: empty, opened for writing.
            world: before its first tick.
            resolved: what it was built from.
            timing: of the recording that is replayed.
            about: further keys of the metadata record: where the run comes from.
        """
        head = metadata(resolved, world.seed, msgspec.convert(timing, Timing))
        self._world = world
        self._writer = RecordingWriter(file, {**head, **about}, world.ports)
        self._known: Mapping[str, Port] = world.ports
        self._index = self._batch = 0
        self._second = max(1, round(world.rate_hz))

    def requested(self, requests: Sequence[Request]) -> None:
        """Write a batch that is carried out now."""
        tick, t_ns = self._world.tick, self._world.t_ns
        for request in requests:
            again = Request.of(request.item, self._next(), self._batch, tick)
            self._writer.request(again, t_ns, self._world.ports)
        self._batch += 1

    def told(self, output: TickOutput) -> None:
        """Write what a tick, or a batch without one, gave."""
        ports = self._world.ports
        if ports is not self._known:
            self._writer.know(port for path, port in ports.items() if self._known.get(path) is not port)
            self._known = ports
        for event in output.events:
            self._writer.event(event)
        for sample in output.samples:
            self._writer.sample(sample, ports)

    def ticked(self, output: TickOutput) -> None:
        """Write a tick that is done, and each simulated second the state's hash."""
        self.told(output)
        if self._world.tick % self._second == 0:
            self._hash()

    def finish(self) -> None:
        """Write the last state, and the file's index."""
        self._hash()
        self._writer.finish()

    def _hash(self) -> None:
        entry = StateHash(self._next(), self._world.tick, snapshot.take(self._world).hash())
        self._writer.hash(entry, self._world.t_ns)

    def _next(self) -> int:
        index, self._index = self._index, self._index + 1
        return index


def new_file(path: Path) -> IO[bytes]:
    """A file for a recording. An old one is never overwritten: it may be the only one of its run.

    Raises:
        OSError: it exists already or cannot be written; the text names it and says what to do.
    """
    try:
        return path.open("xb")
    except FileExistsError:
        text = f"cannot record to {path}: it exists already; give --record another name, or remove it first"
        raise FileExistsError(text) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise OSError(f"cannot record to {path}: {reason}; give --record a place that can be written") from error
