"""A recording read from its file, or from all the parts that it was written in: record by record, so that its length does not matter."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import IO, Any

import msgspec

from uwserver.recording.format import HASHES, METADATA, REQUESTS, Request, StateHash
from uwserver.recording.parts import FIRST_PART, PART, RUN, STATE, begins_with_state, later_parts, part_of, part_path
from uwserver.scenario.files.opening import opened

_MAGIC = b"\x89MCAP0\r\n"
MOST_RECORD_BYTES = 1 << 30
"""Of a record of a file: the scenario, whose seabed may be large."""
MOST_CHUNK_BYTES = 1 << 28
"""Of a chunk when it is unpacked; the recorder begins a new one after `writer.CHUNK_BYTES`."""


class NotReplayable(Exception):
    """A file that cannot be replayed or read; the text names it, says why, and where it is damaged."""


class NoRecording(NotReplayable):
    """A file of another origin; the text names it, and says no more than that."""


def parts_of(path: Path) -> tuple[Path, ...]:
    """All files of a recording by its name, in their order; of a later part, or of a recording in one file, that file alone.

    Raises:
        OSError: the file cannot be read.
        NotReplayable: it is no MCAP file, or a part is missing before a later one.
    """
    first = head_record(path)
    if PART not in first or part_of(first) != FIRST_PART:
        return (path,)
    there = [number for number, other in later_parts(path).items() if _is_of(other, first.get(RUN, ""))]
    for expected, number in enumerate(there, FIRST_PART + 1):
        if number != expected:
            missing = part_path(path, expected).name
            raise NotReplayable(f"{path}: its part {missing} is missing, {part_path(path, number).name} is there")
    return (path, *(part_path(path, number) for number in there))


def _is_of(path: Path, run: str) -> bool:
    """Whether a file is a part of this run; one that was killed while it wrote its head is not."""
    try:
        return head_record(path).get(RUN) == run
    except NotReplayable:
        return False


def head_record(path: Path) -> Mapping[str, str]:
    """The metadata record ``uwserver`` of a file. Raises OSError or NotReplayable."""
    with opened(path) as file:
        return _File(path, file).head


class Reading:
    """A recording over all its parts.

    Attributes:
        paths: of the parts.
        record: the first part's metadata record.
        state: of the world where it begins, as `snapshot.to_bytes` gives it, if it is a later part, or began while
            the run went on; b"" otherwise.
        truncated: the last part ended without its end mark. Known after the last record.
    """

    def __init__(self, path: Path) -> None:
        """Of a recording's name, or of one part's. Raises OSError or NotReplayable."""
        self.paths = parts_of(path)
        self.truncated = False
        self._stack = ExitStack()
        try:
            self._files = [self._open(self.paths[0])]
            self.record = self._files[0].head
            self.state = b""
            if begins_with_state(self.record):
                self.state = self._files[0].state()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def entries(self) -> Iterator[Request | StateHash]:
        """Requests and hashes."""
        from mcap.records import Message

        kinds: dict[str, Any] = {REQUESTS: Request, HASHES: StateHash}
        decoders = {topic: msgspec.json.Decoder(kind) for topic, kind in kinds.items()}
        for topic, message in self.messages(decoders):
            assert isinstance(message, Message)
            try:
                yield decoders[topic].decode(message.data)
            except msgspec.MsgspecError as error:
                text = f"{self.paths[0]}: an entry at {message.log_time} ns cannot be read: {error}"
                raise NotReplayable(text) from error

    def messages(self, topics: Mapping[str, Any] | None = None) -> Iterator[tuple[str, Any]]:
        """Topic and message record, of these topics or of all, in the order in which they were written."""
        from mcap.records import Channel, Message

        names: dict[int, str] = {}
        for record in self.records():
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message):
                topic = names.get(record.channel_id, "")
                if topics is None or topic in topics:
                    yield topic, record

    def records(self) -> Iterator[Any]:
        """All records of all parts, from behind the first one's head. Numbers of channels hold within a part; each tells its own again.

        A file that just stops is truncated; one that goes on after a fault is damaged, which raises NotReplayable.
        """
        yield from self._files[0].records
        self.truncated = self._files[0].truncated
        for path in self.paths[1:]:
            with opened(path) as file:
                part = _File(path, file)
                yield from part.records
                self.truncated = part.truncated

    def _open(self, path: Path) -> _File:
        return _File(path, self._stack.enter_context(opened(path)))


class _File:
    """One file: its head, and what follows."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file = path, file
        self.truncated = False
        if file.read(len(_MAGIC)) != _MAGIC:
            raise NoRecording(f"{path}: no MCAP file, so no recording of `uwserver run --record FILE`")
        file.seek(0)
        self.records: Iterator[Any] = self._checked()
        self.head: Mapping[str, str] = self._head()

    def _head(self) -> Mapping[str, str]:
        from mcap.records import Metadata

        for record in self.records:
            if isinstance(record, Metadata) and record.name == METADATA:
                head: Mapping[str, str] = record.metadata
                return head
        raise NoRecording(f"{self._path}: an MCAP file, but not written by `uwserver run --record FILE`")

    def state(self) -> bytes:
        """The state with which it begins."""
        from mcap.records import Attachment, Message

        before: list[Any] = []
        for record in self.records:
            if isinstance(record, Attachment) and record.name == STATE:
                self.records = chain(before, self.records)
                return bytes(record.data)
            if isinstance(record, Message):
                break
            before.append(record)
        text = "a recording from the midst of a run, without the state it begins with"
        raise NotReplayable(f"{self._path}: {text}")

    def _checked(self) -> Iterator[Any]:
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
