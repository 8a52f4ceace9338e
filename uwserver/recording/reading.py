"""Reads a recording from its file, or from all its parts, one record after the other, so that its length does not matter."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import IO, Any

import msgspec
import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from uwserver.logfiles.part_files import MissingPart, parts_of_run
from uwserver.logfiles.readers.mcap_records import MAGIC
from uwserver.recording.format import HASHES, METADATA, REQUESTS, Request, StateHash
from uwserver.recording.parts import STATE, begins_with_state
from uwserver.scenario.files.documents import opened

MOST_RECORD_BYTES = 1 << 30
"""Largest record of a file. The largest one is the scenario, which may contain a large seabed."""
MOST_CHUNK_BYTES = 1 << 28
"""Largest chunk, decompressed. The recorder begins a new chunk after `writer.CHUNK_BYTES`."""
DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError)
"""The exceptions that a damaged file causes in the parser."""


class NotReplayable(Exception):
    """A file that cannot be replayed or read; the text names it, says why, and where it is damaged."""


class NoRecording(NotReplayable):
    """A file that is not a recording of ours; the text names it and says no more."""


def parts_of(path: Path) -> tuple[Path, ...]:
    """Return all files of a recording in their order; a later part, or a recording in one file, is returned alone.

    Raises:
        OSError: the file cannot be read.
        NotReplayable: it is not an MCAP file, or a part is missing before a later one.
    """

    def head(part: Path) -> Mapping[str, str]:
        try:
            return head_record(part)
        except NotReplayable:
            if part == path:
                raise
            return {}  # a process that was killed while it wrote the head leaves a file like this

    try:
        return parts_of_run(path, head)
    except MissingPart as error:
        raise NotReplayable(str(error)) from error


def head_record(path: Path) -> Mapping[str, str]:
    """Read the metadata record ``uwserver`` of a file. Raises OSError or NotReplayable."""
    with opened(path) as file:
        return _File(path, file).head


class Reading:
    """A recording with all its parts.

    Attributes:
        paths: the files of the parts.
        record: the metadata record of the first part.
        state: the state of the world with which the file begins, in the form of `snapshot.to_bytes`, if it is a later part, or the recording
            began during the run; b"" otherwise.
        truncated: the last part ends without its end mark. Known after the last record.
    """

    def __init__(self, path: Path) -> None:
        """Open a recording by the path of its first part, or one later part. Raises OSError or NotReplayable."""
        self.paths = parts_of(path)
        self.truncated = False
        self._stack = ExitStack()
        try:
            self._first = _File(self.paths[0], self._stack.enter_context(opened(self.paths[0])))
            self.record = self._first.head
            self.state = self._first.state() if begins_with_state(self.record) else b""
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def entries(self) -> Iterator[Request | StateHash]:
        """Yield requests and state hashes."""
        kinds: dict[str, Any] = {REQUESTS: Request, HASHES: StateHash}
        decoders = {topic: msgspec.json.Decoder(kind) for topic, kind in kinds.items()}
        for topic, message in self.messages(decoders):
            try:
                yield decoders[topic].decode(message.data)
            except msgspec.MsgspecError as error:
                text = f"{self.paths[0]}: an entry at {message.log_time} ns cannot be read: {error}"
                raise NotReplayable(text) from error

    def messages(self, topics: Mapping[str, Any] | None = None) -> Iterator[tuple[str, Any]]:
        """Yield topic and message record, of these topics or of all (None), in the order in which they were written."""
        names: dict[int, str] = {}
        for record in self.records():
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message):
                topic = names.get(record.channel_id, "")
                if topics is None or topic in topics:
                    yield topic, record

    def records(self) -> Iterator[Any]:
        """Yield all records of all parts after the head. Channel numbers hold within a part; each part describes its channels again.

        Raises:
            NotReplayable: a file is damaged, and goes on after the damage. A file that merely stops is truncated.
        """
        yield from self._first.records
        self.truncated = self._first.truncated
        for path in self.paths[1:]:
            with opened(path) as file:
                part = _File(path, file)
                yield from part.records
                self.truncated = part.truncated


class _File:
    """The records of one file.

    Attributes:
        records: the records after those that were read already.
        head: the metadata record.
        truncated: the file ended without its end mark.
    """

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file = path, file
        self.truncated = False
        if file.read(len(MAGIC)) != MAGIC:
            raise NoRecording(f"{path}: not an MCAP file, so not a recording of `uwserver run --record FILE`")
        file.seek(0)
        self.records: Iterator[Any] = self._checked()
        self.head: Mapping[str, str] = self._head()

    def _head(self) -> Mapping[str, str]:
        for record in self.records:
            if isinstance(record, Metadata) and record.name == METADATA:
                return record.metadata
        raise NoRecording(f"{self._path}: an MCAP file, but not written by `uwserver run --record FILE`")

    def state(self) -> bytes:
        """Return the state with which the file begins. The records before it stay in `records`."""
        before: list[Any] = []
        for record in self.records:
            if isinstance(record, Attachment) and record.name == STATE:
                self.records = chain(before, self.records)
                return bytes(record.data)
            if isinstance(record, Message):
                break
            before.append(record)
        text = "the recording began during a run, but the state with which it begins is missing"
        raise NotReplayable(f"{self._path}: {text}")

    def _checked(self) -> Iterator[Any]:
        try:
            reader = StreamReader(self._file, emit_chunks=True, validate_crcs=True, record_size_limit=MOST_RECORD_BYTES)
            for record in reader.records:
                if isinstance(record, Chunk):
                    check_chunk_size(record)
                    yield from breakup_chunk(record, validate_crc=True)
                else:
                    yield record
        except MemoryError as error:
            text = f"{self._path}: there is too little memory for the record at byte {self._file.tell()}"
            raise NotReplayable(text) from error
        except DAMAGE as error:
            place = self._file.tell()
            # At the end of the file nothing follows the damage: the file was only cut off. A chunk that is too large was not.
            if self._file.read(1) or isinstance(error, TooLarge):
                raise NotReplayable(f"{self._path}: damaged before byte {place}: {error}") from error
            self.truncated = True


class TooLarge(ValueError):
    """A chunk whose few bytes would decompress to more than any recorder writes."""


def check_chunk_size(chunk: Chunk) -> None:
    """Check the decompressed size of a chunk before it is decompressed. Raises TooLarge, or ZstdError when its data are damaged."""
    size = max(chunk.uncompressed_size, len(chunk.data))
    if chunk.compression == "zstd":
        size = max(size, zstandard.frame_content_size(chunk.data))
    if size > MOST_CHUNK_BYTES:
        raise TooLarge(f"a chunk of {size} bytes, at most {MOST_CHUNK_BYTES}: uwserver did not write it")
