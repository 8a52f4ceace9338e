"""An MCAP file by its chunks: found by the index at its end, or by one walk over the heads of its records where it has none.

Nothing is unpacked but the chunks that are asked for. A file that still grows is followed with `Chunks.refresh`. Lengths in the file are believed
only as far as the file goes, and unpacking has a limit.
"""

from __future__ import annotations

import os
import struct
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, Final, NamedTuple, cast

import numpy as np

from uwserver.recording.reading import MOST_CHUNK_BYTES, MOST_RECORD_BYTES

MAGIC: Final = b"\x89MCAP0\r\n"
MOST_SUMMARY_BYTES: Final = 1 << 30
"""Of the index of a file."""
LATEST_NS: Final = 1 << 62
"""146 years: no message is later."""
_KEPT: Final = 6
"""Unpacked chunks that are kept."""

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX, _METADATA = 0x03, 0x04, 0x05, 0x06, 0x07, 0x08, 0x0C
_ENDS: Final = (0x0F, 0x02)  # end of the data, footer
_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_INDEX_HEAD = struct.Struct("<QQQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER = struct.Struct("<BQQQI")
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_WHERE = np.dtype([("channel", "<u2"), ("offset", "<u8")])


class NotPlayable(Exception):
    """A file that cannot be played; the text names it, says why and what to do."""


class NotOurs(NotPlayable):
    """A file that is no recording of ours; another reader may know it."""


class Channel(NamedTuple):
    """A channel of a file."""

    topic: str
    encoding: str


class Chunk(NamedTuple):
    """Where a chunk record stands, and the span of time of its messages, ns."""

    offset: int
    length: int
    start_ns: int
    end_ns: int


class Message(NamedTuple):
    """A message: number of its channel, log time (ns), and its bytes."""

    channel: int
    t_ns: int
    data: bytes


class Chunks:
    """An open file.

    Attributes:
        path: of it.
        chunks: in the order of the file.
        channels: by number.
        is_finished: it has an end; nothing comes any more.
        has_index: it brought one.
        metadata: records of the file's start, by name.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Of a file.

        Args:
            path: of the file.
            names: first levels of topics -> what they are called here.

        Raises:
            OSError: it cannot be read.
            NotPlayable: it is no MCAP file.
        """
        self.path, self._names = path, names
        self._file: IO[bytes] = path.open("rb", buffering=0)  # what it held a moment ago may have grown
        self.chunks: list[Chunk] = []
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.is_finished = self.has_index = False
        self._where: dict[int, Sequence[int]] = {}
        self._kept: OrderedDict[int, list[Message]] = OrderedDict()
        self._next = len(MAGIC)
        if self._read(0, len(MAGIC)) != MAGIC:
            self.close()
            raise NotOurs(f"{path}: no MCAP file; play takes what `uwserver run --record FILE` has written")
        try:
            self._read_start()
            self.has_index = self.is_finished = self._read_summary()
            if not self.has_index:
                self.chunks, self._where = [], {}
                self.refresh()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; what reads of it later opens it again."""
        self._file.close()

    @property
    def is_replaced(self) -> bool:
        """Whether another file stands under its name, or none."""
        try:
            there = self.path.stat()
        except OSError:
            return True
        here = os.fstat(self._file.fileno())
        return (there.st_ino, there.st_dev) != (here.st_ino, here.st_dev)

    # -- reading --------------------------------------------------------------------------------------------------------------------

    def messages(self, chunk: int) -> list[Message]:
        """The messages of a chunk, in the order of the file; damaged ones are an empty list.

        Raises:
            NotPlayable: the file shrank, or the chunk would unpack to more than it may.
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
        """The last chunk before this one that holds messages of a channel; -1 for none."""
        where = self._where.get(channel, ())
        place = bisect_left(where, before)
        return int(where[place - 1]) if place else -1

    def holding(self, channel: int) -> Sequence[int]:
        """All chunks that hold messages of a channel."""
        return self._where.get(channel, ())

    def refresh(self) -> bool:
        """Look for more in a file that has no end yet; returns whether there is more.

        Raises:
            NotPlayable: it became shorter.
        """
        if self.is_finished:
            return False
        size, before = os.fstat(self._file.fileno()).st_size, len(self.chunks)
        if size < self._next - len(MAGIC):
            raise NotPlayable(f"{self.path}: the file became shorter while it was played")
        while self._next + _RECORD.size <= size:
            kind, length = _RECORD.unpack(self._read(self._next, _RECORD.size))
            begin = self._next + _RECORD.size
            if kind in _ENDS:
                self.is_finished = True
                break
            if begin + length > size:
                break  # not written yet, or cut off
            if kind == _CHUNK:
                self._add_chunk(begin, length)
            elif kind == _MESSAGE_INDEX and self.chunks and length >= _U16.size:
                self._add_place(_U16.unpack(self._read(begin, _U16.size))[0])
            self._next = begin + length
        return len(self.chunks) > before

    def _add_chunk(self, begin: int, length: int) -> None:
        if length < _CHUNK_HEAD.size:
            return
        start, end, _, _ = _CHUNK_HEAD.unpack(self._read(begin, _CHUNK_HEAD.size))
        self.chunks.append(Chunk(begin, length, min(start, LATEST_NS), min(end, LATEST_NS)))

    def _add_place(self, channel: int) -> None:
        chunk = len(self.chunks) - 1
        if channel not in self.channels:
            self.messages(chunk)  # channels stand in the chunk of their first message
        where = self._where.setdefault(channel, [])
        assert isinstance(where, list)
        if not where or where[-1] != chunk:
            where.append(chunk)

    def _read(self, offset: int, length: int) -> bytes:
        if self._file.closed:
            self._file = self.path.open("rb", buffering=0)
        self._file.seek(offset)
        return self._file.read(length)

    def _unpacked(self, chunk: Chunk) -> bytes:
        """The records of a chunk."""
        from zstandard import ZstdDecompressor, ZstdError, frame_content_size

        body = self._read(chunk.offset, chunk.length)
        if len(body) < chunk.length:
            raise NotPlayable(f"{self.path}: the file became shorter while it was played")
        try:
            _, _, size, _ = _CHUNK_HEAD.unpack_from(body)
            name, at = _text(body, _CHUNK_HEAD.size)
            length = _U64.unpack_from(body, at)[0]
            data = body[at + _U64.size : at + _U64.size + length]
            if name == "zstd":
                size = max(size, frame_content_size(data))
            if size > MOST_CHUNK_BYTES:
                text = f"a chunk of {size} bytes, at most {MOST_CHUNK_BYTES}: uwserver did not write it"
                raise NotPlayable(f"{self.path}: damaged at byte {chunk.offset}: {text}")
            if name == "zstd":
                return ZstdDecompressor().decompress(data, max_output_size=size)
            if name:
                raise NotPlayable(f"{self.path}: chunks are packed with {name[:20]!r}: uwserver did not write it")
            return data
        except (ZstdError, struct.error, ValueError):
            return b""  # one damaged chunk must not end the others

    def _parsed(self, data: bytes) -> Iterator[Message]:
        at, end = 0, len(data)
        while at + _RECORD.size <= end:
            kind, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if at + length > end:
                return
            if kind == _MESSAGE and length >= _MESSAGE_HEAD.size:
                channel, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(data, at)
                if t_ns <= LATEST_NS:
                    yield Message(channel, t_ns, data[at + _MESSAGE_HEAD.size : at + length])
            elif kind == _CHANNEL:
                self._add_channel(data[at : at + length])
            at += length

    def _add_channel(self, body: bytes) -> None:
        try:
            number, _ = struct.unpack_from("<HH", body)
            topic, at = _text(body, 4)
            encoding, _ = _text(body, at)
        except (struct.error, ValueError):
            return
        self.channels.setdefault(number, Channel(renamed(topic, self._names), encoding))

    # -- start and end of the file ----------------------------------------------------------------------------------------------------

    def _read_start(self) -> None:
        """Metadata before the first chunk."""
        size, at = os.fstat(self._file.fileno()).st_size, self._next
        while at + _RECORD.size <= size:
            kind, length = _RECORD.unpack(self._read(at, _RECORD.size))
            at += _RECORD.size
            if kind in (_CHUNK, *_ENDS) or at + length > size or length > MOST_RECORD_BYTES:
                return
            if kind == _METADATA:
                self._add_metadata(self._read(at, length))
            at += length

    def _add_metadata(self, body: bytes) -> None:
        try:
            name, at = _text(body, 0)
            end = at + _U32.size + _U32.unpack_from(body, at)[0]
            at, entries = at + _U32.size, {}
            while at < min(end, len(body)):
                key, at = _text(body, at)
                entries[key], at = _text(body, at)
        except (struct.error, ValueError):
            return
        self.metadata.setdefault(name, entries)

    def _read_summary(self) -> bool:
        """Whether the file brings an index of its chunks."""
        size = os.fstat(self._file.fileno()).st_size
        foot = self._read(max(0, size - _FOOTER.size - len(MAGIC)), _FOOTER.size + len(MAGIC))
        if len(foot) < _FOOTER.size + len(MAGIC) or not foot.endswith(MAGIC):
            return False
        kind, _, start, _, _ = _FOOTER.unpack_from(foot)
        end = size - _FOOTER.size - len(MAGIC)
        if kind != _ENDS[1] or not 0 < start < end or end - start > MOST_SUMMARY_BYTES:
            return False
        data, at, places = self._read(start, end - start), 0, []
        while at + _RECORD.size <= len(data):
            kind, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if at + length > len(data):
                return False
            if kind == _CHANNEL:
                self._add_channel(data[at : at + length])
            elif kind == _CHUNK_INDEX and length >= _INDEX_HEAD.size:
                first, last, offset, size_of, mapped = _INDEX_HEAD.unpack_from(data, at)
                if offset + size_of > start or mapped + _INDEX_HEAD.size > length or mapped % _WHERE.itemsize:
                    return False
                begin = offset + _RECORD.size
                self.chunks.append(Chunk(begin, size_of - _RECORD.size, min(first, LATEST_NS), min(last, LATEST_NS)))
                places.append(data[at + _INDEX_HEAD.size : at + _INDEX_HEAD.size + mapped])
            at += length
        self._where = _by_channel(places)
        return bool(self.chunks)


def renamed(path: str, names: Mapping[str, str]) -> str:
    """A path with another first level, where it is to have one."""
    first, slash, rest = path.partition("/")
    return names.get(first, first) + slash + rest


def _by_channel(places: list[bytes]) -> dict[int, Sequence[int]]:
    """Numbers of the chunks that hold messages of each channel."""
    rows = np.frombuffer(b"".join(places), _WHERE)["channel"]
    numbers = np.repeat(np.arange(len(places)), [len(each) // _WHERE.itemsize for each in places])
    order = np.argsort(rows, kind="stable")
    channels, starts = np.unique(rows[order], return_index=True)
    parts = np.split(numbers[order], starts[1:])
    return {int(n): cast(Sequence[int], part) for n, part in zip(channels, parts, strict=True)} if len(rows) else {}


def _text(body: bytes, at: int) -> tuple[str, int]:
    """A text with its length before it, and where it ends.

    Raises:
        ValueError: it goes beyond the end (struct.error: its length does), or is no UTF-8.
    """
    end = at + _U32.size + _U32.unpack_from(body, at)[0]
    if end > len(body):
        raise ValueError("a text goes beyond the end of its record")
    return body[at + _U32.size : end].decode(), end
