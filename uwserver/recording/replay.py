"""Runs a recording again and compares: the same requests at the same ticks must give the same states, bit for bit."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import msgspec

from uwserver.physics.collision.engine import missing_engine
from uwserver.recording.format import (
    HASHES,
    METADATA,
    REQUESTS,
    Head,
    Request,
    StateHash,
    Versions,
    head_of,
    versions_here,
)
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import NO_MORE, More
from uwserver.scenario.files.opening import opened
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.world import snapshot
from uwserver.world.world import Diverged, World

_MAGIC = b"\x89MCAP0\r\n"
MOST_RECORD_BYTES = 1 << 30
"""Of a record of a file: the scenario, whose seabed may be large."""
MOST_CHUNK_BYTES = 1 << 28
"""Of a chunk when it is unpacked; the recorder begins a new one after `format.CHUNK_BYTES`."""


class NotReplayable(Exception):
    """A file that cannot be replayed; the text names it, says why, and where it is damaged."""


@dataclass(frozen=True)
class Difference:
    """Where a replay first went another way than the recording.

    Attributes:
        tick: of the recorded entry.
        t_ns: its simulation time.
        index: running number of the entry.
        expected, found: state hashes; for anything but a hash, what the entry says and what the world says.
    """

    tick: int
    t_ns: int
    index: int
    expected: str
    found: str


@dataclass(frozen=True)
class Replayed:
    """What came of a replay.

    Attributes:
        ticks: run again.
        requests: carried out again.
        hashes: compared, and equal.
        difference: the first one; None when all states are equal.
        truncated: the recording has no end (its server was killed, or the disk was full); it was replayed as far as it goes.
        recorded, here: versions of then and now.
    """

    ticks: int
    requests: int
    hashes: int
    difference: Difference | None
    truncated: bool
    recorded: Versions
    here: Versions

    @property
    def changed_versions(self) -> dict[str, tuple[str, str]]:
        """What is not as it was: name -> (then, now)."""
        pairs = {
            name: (getattr(self.recorded, name), getattr(self.here, name))
            for name in Versions.__struct_fields__
            if name != "started_utc"
        }
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def replay(path: Path, extensions: Sequence[Path] = ()) -> Replayed:
    """Replay a recording as fast as possible. Needs no file but the recording, and no adapter.

    Args:
        path: of the recording.
        extensions: the Python files of its scenario, which are not in it; they are run.

    Raises:
        OSError: the file cannot be read.
        NotReplayable: it is no recording of ours, damaged, or of a scenario that this version cannot build.
    """
    with opened(path) as file:
        reading = _Reading(path, file, _kinds(extensions))
        run = _Run(path, reading.head)
        for entry in reading.entries():
            run.follow(entry)
            if run.difference is not None:
                break
        else:
            run.carry_out()
        head = reading.head
        return Replayed(
            run.ticks, run.requests, run.hashes, run.difference, reading.truncated, head.versions, versions_here()
        )


def _kinds(extensions: Sequence[Path]) -> More:
    problems: list[str] = []
    names = [str(path) for path in extensions]
    more = extension_kinds(
        names, Path.cwd(), lambda _, text: problems.append(text), lambda problem: problems.append(str(problem))
    )
    if problems:
        raise NotReplayable("\n".join(problems))
    return more if extensions else NO_MORE


class _Run:
    """A world that follows the entries of a recording."""

    def __init__(self, path: Path, head: Head) -> None:
        self._path = path
        # Contacts of another engine may differ in their last bits.
        missing = missing_engine(head.resolved.scenario.world.engine, instead=False) if head.resolved.is_solid else None
        if missing is not None:
            raise NotReplayable(f"{path}: its contacts cannot be found again here: {missing}")
        self._world: World = build(head.resolved, head.seed)
        self._world.want(())
        self._batch: list[Request] = []
        self._next_index = 0
        self.ticks = self.requests = self.hashes = 0
        self.difference: Difference | None = None

    def follow(self, entry: Request | StateHash) -> None:
        """Go on to the tick of the entry; carry it out or compare."""
        if entry.index != self._next_index:
            text = f"{self._path}: entry {self._next_index} is missing before tick {entry.tick}: the file was changed after its recording"
            raise NotReplayable(text)
        self._next_index += 1
        if self._batch and not (isinstance(entry, Request) and entry.batch == self._batch[0].batch):
            self.carry_out()
        if not self._advance(entry):
            return
        if isinstance(entry, Request):
            self._batch.append(entry)
            return
        found = snapshot.take(self._world).hash()
        if found == entry.hash:
            self.hashes += 1
        else:
            self._differs(entry, entry.hash, found)

    def carry_out(self) -> None:
        """Carry out the batch that was collected; without a tick, for the recorded world may have been paused. If it ran, its tick follows."""
        for request in self._batch:
            if request.service and request.service not in self._world.services:
                text = f'{self._path}: tick {request.tick} calls "{request.service}", which this version of uwserver does not have'
                raise NotReplayable(text)
            self._world.submit(request.item)
        self._world.flush()
        self.requests += len(self._batch)
        self._batch = []

    def _advance(self, entry: Request | StateHash) -> bool:
        """Step to the tick of an entry. False, with a difference, when the world cannot get there."""
        world = self._world
        # A recording has an entry each simulated second at least.
        if entry.tick - world.tick > 2 * max(1, round(world.rate_hz)):
            text = f"{self._path}: no entry between the ticks {world.tick} and {entry.tick}: the file was changed after its recording"
            raise NotReplayable(text)
        while world.tick < entry.tick:
            self.ticks += 1
            try:
                world.advance()
            except Diverged as error:
                # The recorded world stopped here as well if its next entry is of this tick.
                if world.tick != entry.tick:
                    self._differs(entry, f"a world that runs on to tick {entry.tick}", str(error))
                    return False
        if world.tick > entry.tick:
            self._differs(entry, f"a world at tick {entry.tick}", f"a world at tick {world.tick}")
            return False
        return True

    def _differs(self, entry: Request | StateHash, expected: str, found: str) -> None:
        self.difference = Difference(entry.tick, self._world.ticks.time_of(entry.tick), entry.index, expected, found)


class _Reading:
    """A recording, entry by entry in the order of the file, so that its length does not matter.

    Attributes:
        head: the metadata record.
        truncated: the file ended without its end mark. Known after the last entry.
    """

    def __init__(self, path: Path, file: IO[bytes], more: More) -> None:
        self._path = path
        self._file = file
        self._types: dict[int, Any] = {}
        self.truncated = False
        if file.read(len(_MAGIC)) != _MAGIC:
            raise NotReplayable(f"{path}: no MCAP file; replay takes what `uwserver run --record FILE` has written")
        file.seek(0)
        self._records = self._checked()
        self._more = more
        self.head = self._head()

    def entries(self) -> Iterator[Request | StateHash]:
        """Requests and hashes."""
        from mcap.records import Channel, Message

        for record in self._records:
            if isinstance(record, Channel):
                self._types[record.id] = {REQUESTS: Request, HASHES: StateHash}.get(record.topic)
            elif isinstance(record, Message) and self._types.get(record.channel_id) is not None:
                yield self._decoded(record)

    def _head(self) -> Head:
        from mcap.records import Metadata

        for record in self._records:
            if isinstance(record, Metadata) and record.name == METADATA:
                try:
                    return head_of(record.metadata, self._more)
                except ValueError as error:
                    raise NotReplayable(f"{self._path}: {error}") from error
        raise NotReplayable(f"{self._path}: an MCAP file, but not written by `uwserver run --record FILE`")

    def _decoded(self, message: Any) -> Request | StateHash:
        try:
            entry: Request | StateHash = msgspec.json.decode(message.data, type=self._types[message.channel_id])
        except msgspec.MsgspecError as error:
            raise NotReplayable(f"{self._path}: an entry at {message.log_time} ns cannot be read: {error}") from error
        return entry

    def _checked(self) -> Iterator[Any]:
        """All records. A file that just stops is truncated; one that goes on after a fault is damaged."""
        from mcap.exceptions import McapError
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader
        from zstandard import ZstdError

        try:
            reader = StreamReader(self._file, emit_chunks=True, validate_crcs=True, record_size_limit=MOST_RECORD_BYTES)
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield from self._unpacked(record)
                else:
                    yield record
        except MemoryError as error:
            text = f"{self._path}: there is too little memory for what it says at byte {self._file.tell()}"
            raise NotReplayable(text) from error
        except (McapError, ZstdError, struct.error, ValueError) as error:
            place = self._file.tell()
            if self._file.read(1):
                raise NotReplayable(f"{self._path}: damaged before byte {place}: {error}") from error
            self.truncated = True

    def _unpacked(self, chunk: Any) -> list[Any]:
        """The records of a chunk, unless a few bytes stand for any number of them."""
        from mcap.stream_reader import breakup_chunk
        from zstandard import frame_content_size

        size: int = chunk.uncompressed_size
        if chunk.compression == "zstd":
            size = max(size, frame_content_size(chunk.data))
        if size > MOST_CHUNK_BYTES:
            text = f"a chunk of {size} bytes, at most {MOST_CHUNK_BYTES}: uwserver did not write it"
            raise NotReplayable(f"{self._path}: damaged before byte {self._file.tell()}: {text}")
        return breakup_chunk(chunk, validate_crc=True)
