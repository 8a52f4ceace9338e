"""An MCAP file, or a recording in several files, as a list of chunks.

The chunks are found with the index at the end of a file, or, without an index, by one pass over the heads of its records. Only requested chunks are
decompressed, up to a limit. `Chunks.refresh` follows a file that still grows.

`PartChunks` reads several files as if they were one. Channels have different numbers in each file; there all channels of a topic have one number.
Only the files that are being read are open, so that the system's limit of open files does not limit the number of parts.
"""

from __future__ import annotations

import os
import struct
from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Final, NamedTuple, cast

import numpy as np

from uwserver.logfiles import Limits, LogError
from uwserver.logfiles.log import foreign
from uwserver.logfiles.readers.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD_BYTES,
    Records,
    Unreadable,
    learn,
    records_in,
)
from uwserver.recording.format import METADATA
from uwserver.recording.parts import FIRST_PART, PART, RUN, part_of, part_path
from uwserver.recording.reading import MOST_CHUNK_BYTES, MOST_RECORD_BYTES, NotReplayable, head_record, parts_of

LATEST_NS: Final = 1 << 62
"""146 years; a later message is damaged."""
_KEPT: Final = 6
"""Number of decompressed chunks that are kept."""
_CHUNK_TIMES = struct.Struct("<QQ")
_LIMITS: Final = Limits(record_bytes=MOST_RECORD_BYTES)
_CHUNK_LIMITS: Final = Limits(record_bytes=MOST_CHUNK_BYTES)
_INDEX_ENTRY = np.dtype([("channel", "<u2"), ("offset", "<u8")])


class NotPlayable(Exception):
    """A file that cannot be played; the text names it, says why and what to do."""


class NotOurs(NotPlayable):
    """A file that is not a recording of ours; another reader may be able to read it."""


class Channel(NamedTuple):
    """A channel of a file."""

    topic: str
    encoding: str


class Chunk(NamedTuple):
    """Place and length of the content of a chunk record, and the times of its first and last message, ns."""

    offset: int
    length: int
    start_ns: int
    end_ns: int


class McapMessage(NamedTuple):
    """A message: number of its channel, log time (ns), and its bytes."""

    channel: int
    t_ns: int
    data: bytes


class Chunks:
    """An open file.

    Attributes:
        path: its path.
        chunks: in the order of the file.
        channels: by number.
        is_finished: the file has an end; it does not grow any more.
        has_index: the file has an index.
        metadata: metadata records at the start of the file, by name.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Open a file.

        Args:
            path: path of the file.
            names: maps the first levels of topics to the names that they get here.

        Raises:
            OSError: the file cannot be read.
            NotPlayable: it is not an MCAP file.
        """
        self.path, self._names = path, names
        # Unbuffered, because a buffer would hide what is written to the file meanwhile.
        self._file: IO[bytes] = path.open("rb", buffering=0)
        self.chunks: list[Chunk] = []
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.is_finished = False
        self._where: dict[int, Sequence[int]] = {}
        self._kept: OrderedDict[int, list[McapMessage]] = OrderedDict()
        self._next = len(MAGIC)
        try:
            records = self._records(_LIMITS)
            if records.read(0, len(MAGIC)) != MAGIC:
                raise NotOurs(
                    f"{path}: not an MCAP file; play takes files that `uwserver run --record FILE` has written"
                )
            try:
                with foreign(path, "its metadata are damaged"):
                    self.metadata = records.first_metadata()
            except LogError:
                pass  # code that needs the head reports that it is missing
            self.has_index = self.is_finished = self._read_summary(records)
            self.refresh()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file. It is opened again when it is read later."""
        self._file.close()

    @property
    def is_replaced(self) -> bool:
        """Return whether the path names another file by now, or none."""
        try:
            there = self.path.stat()
        except OSError:
            return True
        here = os.fstat(self._file.fileno())
        return (there.st_ino, there.st_dev) != (here.st_ino, here.st_dev)

    # -- reading --------------------------------------------------------------------------------------------------------------------

    def messages(self, chunk: int) -> list[McapMessage]:
        """Return the messages of a chunk in the order of the file; an empty list for a damaged chunk.

        Raises:
            NotPlayable: the file shrank, or the chunk would decompress to more than is allowed.
        """
        kept = self._kept.get(chunk)
        if kept is not None:
            self._kept.move_to_end(chunk)
            return kept
        found = list(self._parsed(self._unpacked(self.chunks[chunk])))
        self._kept[chunk] = found
        if len(self._kept) > _KEPT:
            self._kept.popitem(last=False)
        return found

    def last_with(self, channel: int, before: int) -> int:
        """Return the last chunk before this one that contains messages of a channel; -1 for none."""
        where = self.holding(channel)
        place = bisect_left(where, before)
        return int(where[place - 1]) if place else -1

    def holding(self, channel: int) -> Sequence[int]:
        """Return all chunks that contain messages of a channel."""
        return self._where.get(channel, ())

    def refresh(self) -> bool:
        """Look for new chunks in a file that has no end yet; return whether there are any.

        Raises:
            NotPlayable: the file became shorter.
        """
        if self.is_finished:
            return False
        records, before = self._records(_LIMITS), len(self.chunks)
        if records.size < self._next - len(MAGIC):
            raise NotPlayable(f"{self.path}: the file became shorter while it was played")
        for code, begin, length in records.heads(self._next):
            if code in (DATA_END, FOOTER):
                self.is_finished = True
                break
            if code == CHUNK and length >= _CHUNK_TIMES.size:
                start, end = _CHUNK_TIMES.unpack(records.read(begin, _CHUNK_TIMES.size))
                self.chunks.append(Chunk(begin, length, min(start, LATEST_NS), min(end, LATEST_NS)))
            elif code == MESSAGE_INDEX and self.chunks and length >= 2:
                self._add_place(int.from_bytes(records.read(begin, 2), "little"))
            self._next = begin + length
        return len(self.chunks) > before

    def _add_place(self, channel: int) -> None:
        chunk = len(self.chunks) - 1
        if channel not in self.channels:
            self.messages(chunk)  # a channel is described in the chunk with its first message
        where = self._where.setdefault(channel, [])
        assert isinstance(where, list)
        if not where or where[-1] != chunk:
            where.append(chunk)

    def _records(self, limits: Limits) -> Records:
        """Return the records of the file as it is now."""
        if self._file.closed:
            self._file = self.path.open("rb", buffering=0)
        return Records(self.path, self._file, limits)

    def _unpacked(self, chunk: Chunk) -> bytes:
        """Return the records of a chunk."""
        records = self._records(_CHUNK_LIMITS)
        if chunk.offset + chunk.length > records.size:
            raise NotPlayable(f"{self.path}: the file became shorter while it was played")
        try:
            with foreign(self.path, f"the chunk at byte {chunk.offset} is damaged"):
                return records.unpacked(chunk.offset, chunk.length)
        except Unreadable as error:
            raise NotPlayable(f"{error}; uwserver did not write it") from error
        except LogError as error:
            if isinstance(error.__cause__, OSError):
                raise NotPlayable(str(error)) from error
            return b""  # the other chunks can still be played

    def _parsed(self, data: bytes) -> Iterator[McapMessage]:
        for code, begin, end in records_in(data):
            if code == MESSAGE and end - begin >= MESSAGE_HEAD.size:
                channel, _, t_ns, _ = MESSAGE_HEAD.unpack_from(data, begin)
                if t_ns <= LATEST_NS:
                    yield McapMessage(channel, t_ns, data[begin + MESSAGE_HEAD.size : end])
            elif code == CHANNEL:
                channels: dict[int, Any] = {}
                try:
                    with foreign(self.path, "a channel is damaged"):
                        learn(code, data, begin, end, {}, channels)
                except LogError:
                    continue
                self._add_channels(channels)

    def _add_channels(self, channels: Mapping[int, Any]) -> None:
        for number, channel in channels.items():
            named = Channel(renamed(channel.topic, self._names), channel.message_encoding)
            self.channels.setdefault(number, named)

    def _read_summary(self, records: Records) -> bool:
        """Read the index of the chunks; return whether the file has one."""
        summary = records.summary()
        if summary is None or not summary.chunks:
            return False
        for c in summary.chunks:
            is_inside = c.length >= RECORD_HEAD_BYTES and c.offset + c.length <= records.size
            if not is_inside or len(c.channels) % _INDEX_ENTRY.itemsize:
                return False
        self._add_channels(summary.channels)
        self.chunks = [
            Chunk(c.offset + RECORD_HEAD_BYTES, c.length - RECORD_HEAD_BYTES, min(c.start, LATEST_NS), min(c.end, LATEST_NS))
            for c in summary.chunks
        ]  # fmt: skip
        self._where = _by_channel([c.channels for c in summary.chunks])
        return True


def renamed(path: str, names: Mapping[str, str]) -> str:
    """Return a path whose first level is replaced by its new name, if it has one."""
    first, slash, rest = path.partition("/")
    return names.get(first, first) + slash + rest


def _by_channel(entries: list[bytes]) -> dict[int, Sequence[int]]:
    """Return the numbers of the chunks that contain messages of each channel, from the index entries of each chunk."""
    rows = np.frombuffer(b"".join(entries), _INDEX_ENTRY)["channel"]
    numbers = np.repeat(np.arange(len(entries)), [len(each) // _INDEX_ENTRY.itemsize for each in entries])
    order = np.argsort(rows, kind="stable")
    channels, starts = np.unique(rows[order], return_index=True)
    parts = np.split(numbers[order], starts[1:])
    return {int(n): cast(Sequence[int], part) for n, part in zip(channels, parts, strict=True)} if len(rows) else {}


_Key = tuple[Channel, int]
"""A channel, and how many channels of the same topic and encoding come before it in its file: those of ports of one path with other fields."""


@dataclass
class _Part:
    """One file.

    Attributes:
        file: its chunks.
        start: number of its first chunk in the recording.
        numbers: maps channel numbers of the file to those here.
        own: maps channel numbers here to those of the file.
        seen: number of channels of each topic and encoding so far.
        is_as_written: all channel numbers are the same here and in the file.
    """

    file: Chunks
    start: int
    numbers: dict[int, int] = field(default_factory=dict)
    own: dict[int, int] = field(default_factory=dict)
    seen: Counter[Channel] = field(default_factory=Counter)
    is_as_written: bool = True


class PartChunks:
    """An open recording: like `Chunks`, with all its parts. A later part that is opened by its own name is opened alone.

    Attributes:
        path, metadata: those of the first part.
        chunks: chunks of all parts, in their order.
        channels: by number.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Open a recording.

        Args:
            path: the first part, or one later part.
            names: as in `Chunks`.

        Raises:
            OSError: a file cannot be read.
            NotPlayable: it is not an MCAP file, or a part is missing.
        """
        self.path, self._names = path, names
        self.chunks: list[Chunk] = []
        self.channels: dict[int, Channel] = {}
        self._parts: list[_Part] = []
        self._number_of: dict[_Key, int] = {}
        self._add(path)
        self._reading = self._parts[0]
        self.metadata = self._parts[0].file.metadata
        head = self.metadata.get(METADATA, {})
        self._run = head.get(RUN, "") if PART in head and part_of(head) == FIRST_PART else ""
        try:
            self._add_later()
        except BaseException:
            self.close()
            raise

    def _add_later(self) -> bool:
        """Open the parts that are not open yet; return whether there are any."""
        before = len(self._parts)
        try:
            for path in parts_of(self.path)[before:] if self._run else ():
                self._add(path)
        except NotReplayable as error:
            raise NotPlayable(str(error)) from error
        return len(self._parts) > before

    def _add(self, path: Path) -> None:
        file = Chunks(path, self._names)
        if self._parts:
            self._parts[-1].file.close()
        self._parts.append(_Part(file, len(self.chunks)))
        self._take_in()

    def _take_in(self) -> None:
        """Add the new channels and chunks of the last part."""
        last = self._parts[-1]
        self._learn(last)
        self.chunks += last.file.chunks[len(self.chunks) - last.start :]

    def _learn(self, part: _Part) -> None:
        """Give numbers to new channels of a part."""
        if len(part.numbers) == len(part.file.channels):
            return
        for own, channel in part.file.channels.items():
            if own not in part.numbers:
                key = (channel, part.seen[channel])
                part.seen[channel] += 1
                free = own if own not in self.channels else max(self.channels) + 1
                number = self._number_of.setdefault(key, free)
                part.numbers[own], part.own[number] = number, own
                part.is_as_written &= number == own
                self.channels.setdefault(number, channel)

    @property
    def has_index(self) -> bool:
        """Return whether each part has an index."""
        return all(part.file.has_index for part in self._parts)

    @property
    def is_finished(self) -> bool:
        """Return whether the recording does not grow any more."""
        return self._parts[-1].file.is_finished and not self._is_next_there()

    @property
    def is_replaced(self) -> bool:
        """Return whether the last part was replaced, as `Chunks.is_replaced`."""
        return self._parts[-1].file.is_replaced

    def close(self) -> None:
        """Close all files."""
        for part in self._parts:
            part.file.close()

    def messages(self, chunk: int) -> list[McapMessage]:
        """Return the messages of a chunk, as `Chunks.messages`."""
        part = self._parts[bisect_right(self._parts, chunk, key=lambda part: part.start) - 1]
        if part is not self._reading:
            if self._reading is not self._parts[-1]:  # the last part stays open, because it may grow
                self._reading.file.close()
            self._reading = part
        found = part.file.messages(chunk - part.start)
        self._learn(part)
        if part.is_as_written:
            return found
        return [McapMessage(part.numbers.get(own, -1), t_ns, data) for own, t_ns, data in found]

    def last_with(self, channel: int, before: int) -> int:
        """Return the last chunk before this one that contains messages of a channel, as `Chunks.last_with`."""
        for part in reversed(self._parts):
            own = part.own.get(channel)
            found = -1 if own is None or part.start >= before else part.file.last_with(own, before - part.start)
            if found >= 0:
                return found + part.start
        return -1

    def holding(self, channel: int) -> list[int]:
        """Return all chunks that contain messages of a channel, as `Chunks.holding`."""
        parts = (part for part in self._parts if channel in part.own)
        return [int(chunk) + part.start for part in parts for chunk in part.file.holding(part.own[channel])]

    def refresh(self) -> bool:
        """Look for new chunks, as `Chunks.refresh`, also in the next part if it exists."""
        before = len(self.chunks)
        self._parts[-1].file.refresh()
        self._take_in()
        while self._parts[-1].file.is_finished and self._add_later():
            pass
        return len(self.chunks) > before

    def _is_next_there(self) -> bool:
        """Return whether there is a next part, or a file that may become it because its head is not written yet."""
        if not self._run:
            return False
        try:
            return head_record(part_path(self.path, len(self._parts) + FIRST_PART)).get(RUN) == self._run
        except NotReplayable:
            return True
        except OSError:
            return False
