"""Reads the records and chunks of MCAP files. Lengths are checked before anything is read, and chunks are decompressed up to a limit, so that a
small file cannot fill the memory.

The mcap library parses the records of the summary. This module splits chunks itself, because the library would decompress whatever size they
claim, and would make an object of every message, also of unwanted ones.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Metadata, Schema, Statistics

from uwserver.logfiles.log import Limits, LogError, foreign

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
RECORD_HEAD_BYTES = _RECORD.size
_CHUNK_INDEX = struct.Struct("<QQQQI")
_CHUNK = struct.Struct("<QQQII")
MESSAGE_HEAD = struct.Struct("<HIQQ")
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08
STATISTICS, METADATA, METADATA_INDEX, DATA_END = 0x0B, 0x0C, 0x0D, 0x0F
_FOOTER_BYTES = 9 + 20 + 8


class Unreadable(LogError):
    """A record or chunk that may be intact but is not read: it exceeds the limits, or its compression is unknown."""


class ChunkPlace(NamedTuple):
    """A chunk of the file, as the index describes it.

    Attributes:
        start, end: log times of its first and last message, ns.
        offset, length: place of its record, and the length of the record with its head.
        channels: numbers of its channels in the form of the index, 10 bytes each; empty when they are unknown.
        unpacked: decompressed length.
    """

    start: int
    end: int
    offset: int
    length: int
    channels: bytes
    unpacked: int


class Summary(NamedTuple):
    """The summary at the end of a complete file: schemas and channels by number, chunks, statistics, and the places of metadata records."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: list[ChunkPlace]
    statistics: Statistics | None
    metadata: list[int]


class Located(NamedTuple):
    """A message in a decompressed chunk: the number of its channel, its log time (ns), and the place of its data."""

    channel: int
    log_time: int
    begin: int
    end: int


class Records:
    """The records of an open MCAP file.

    Args:
        path: for error texts.
        file: open for reading.
        limits: largest record, and largest ratio of decompressed bytes to the size of the file.
    """

    def __init__(self, path: Path, file: IO[bytes], limits: Limits) -> None:
        self.path, self._file, self._limits = path, file, limits
        self.size = file.seek(0, 2)
        self._left = limits.expansion * self.size + limits.record_bytes

    def read(self, offset: int, length: int) -> bytes:
        """Read bytes at a place; fewer at the end of the file.

        Raises:
            Unreadable: the length exceeds the limit.
        """
        if length > self._limits.record_bytes:
            most = self._limits.record_bytes
            raise Unreadable(f"{self.path}: the record at byte {offset} has {length} bytes, at most {most} are allowed")
        self._file.seek(offset)
        return self._file.read(max(0, length))  # a negative length would read all

    def summary(self) -> Summary | None:
        """Read the summary; None when the file has none, was cut, or the summary is damaged."""
        try:
            with foreign(self.path, "its index is damaged"):
                return self._summary()
        except LogError:
            return None

    def _summary(self) -> Summary | None:
        tail = self.read(max(0, self.size - _FOOTER_BYTES), _FOOTER_BYTES)
        if len(tail) < _FOOTER_BYTES or not tail.endswith(MAGIC) or tail[0] != FOOTER:
            return None
        start = int(struct.unpack_from("<Q", tail, 9)[0])
        if not 0 < start < self.size:
            return None
        found = Summary({}, {}, [], None, [])
        data = self.read(start, self.size - _FOOTER_BYTES - start)
        for code, begin, end in records_in(data):
            if code == CHUNK_INDEX:
                first, last, offset, length, channels = _CHUNK_INDEX.unpack_from(data, begin)
                after = begin + _CHUNK_INDEX.size + channels
                name = int(struct.unpack_from("<I", data, after + 8)[0])
                unpacked = int(struct.unpack_from("<Q", data, after + 12 + name + 8)[0])
                keys = data[begin + _CHUNK_INDEX.size : after]
                found.chunks.append(ChunkPlace(first, last, offset, length, keys, unpacked))
            elif code == METADATA_INDEX:
                found.metadata.append(int(struct.unpack_from("<Q", data, begin)[0]))
            elif code == STATISTICS:
                found = found._replace(statistics=Statistics.read(_stream(data, begin, end)))
            else:
                learn(code, data, begin, end, found.schemas, found.channels)
        return found

    def metadata(self, offset: int) -> Metadata | None:
        """Read the metadata record at a place; None when there is none."""
        head = self.read(offset, _RECORD.size)
        if len(head) < _RECORD.size:
            return None
        code, length = _RECORD.unpack(head)
        data = self.read(offset + _RECORD.size, length)
        return Metadata.read(_stream(data, 0, len(data))) if code == METADATA and len(data) == length else None

    def first_metadata(self) -> dict[str, dict[str, str]]:
        """Read the metadata records before the first chunk or message, by name."""
        found: dict[str, dict[str, str]] = {}
        for code, begin, _ in self.heads():
            if code in (CHUNK, MESSAGE):
                break
            record = self.metadata(begin - _RECORD.size) if code == METADATA else None
            if record is not None:
                found.setdefault(record.name, record.metadata)
        return found

    def heads(self, at: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
        """Yield code, place of the content and its length of every record from a place on, including the record that ends the data.

        It stops before a record that is not whole.
        """
        while True:
            head = self.read(at, _RECORD.size)
            if len(head) < _RECORD.size:
                return
            code, length = _RECORD.unpack(head)
            if code == 0 or (at + _RECORD.size + length > self.size and code not in (DATA_END, FOOTER)):
                return
            yield code, at + _RECORD.size, length
            if code in (DATA_END, FOOTER):
                return
            at += _RECORD.size + length

    def claim(self, unpacked: int) -> None:
        """Count the claimed decompressed length of a chunk, once for each chunk, however often it is read.

        Raises:
            LogError: all chunks together claim too much.
        """
        self._left -= unpacked
        if self._left < 0:
            most = self._limits.expansion
            raise LogError(
                f"{self.path}: decompressed it would be more than {most} times its size: it looks like a zip bomb"
            )

    def unpacked(self, begin: int, length: int, claimed: int | None = None) -> bytes:
        """Return the decompressed content of a chunk.

        Args:
            begin, length: place and length of the content of the chunk's record.
            claimed: the decompressed length for which `claim` was called; None to call it now.

        Raises:
            Unreadable: the chunk exceeds the limit, or its compression is unknown.
            LogError: the chunk is cut, or its length is not what it or the index claims.
        """
        data = self.read(begin, length)
        where = f"{self.path}: the chunk at byte {begin}"
        if len(data) < _CHUNK.size:
            raise LogError(f"{where} is cut")
        _, _, size, _, name = _CHUNK.unpack_from(data)
        if size > self._limits.record_bytes:
            raise Unreadable(f"{where} claims {size} bytes, at most {self._limits.record_bytes} are allowed")
        if claimed is None:
            self.claim(size)
        elif size != claimed:
            raise LogError(f"{where} claims {size} bytes, the index says {claimed}")
        kind = data[_CHUNK.size : _CHUNK.size + name].decode(errors="replace")
        try:
            found = decompressed(kind, data[_CHUNK.size + name + 8 :], size)
        except ValueError as error:
            raise Unreadable(f"{where}: {error}") from error
        if found is None or (kind and len(found) != size):
            raise LogError(f"{where} does not decompress to the {size} bytes that it claims")
        return found


def messages(data: bytes) -> list[Located]:
    """Return the messages of a decompressed chunk in their order, without one that is cut at the end."""
    unpack = MESSAGE_HEAD.unpack_from
    found = []
    for code, begin, end in records_in(data):
        if code == MESSAGE and end - begin >= MESSAGE_HEAD.size:
            channel, _, log_time, _ = unpack(data, begin)
            found.append(Located(channel, log_time, begin + MESSAGE_HEAD.size, end))
    return found


def learn(
    code: int, data: bytes, begin: int, end: int, schemas: dict[int, Schema], channels: dict[int, Channel]
) -> None:
    """Store the schema or channel that a record describes; ignore other records."""
    if code == SCHEMA:
        schema = Schema.read(_stream(data, begin, end))
        schemas[schema.id] = schema
    elif code == CHANNEL:
        channel = Channel.read(_stream(data, begin, end))
        channels[channel.id] = channel


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield code, begin and end of the content of each record in a decompressed chunk or a summary, up to one that is cut."""
    at, size, unpack, head = 0, len(data), _RECORD.unpack_from, _RECORD.size
    while at + head <= size:
        code, length = unpack(data, at)
        begin = at + head
        at = begin + length
        if at > size:
            return
        yield code, begin, at


def _stream(data: bytes, begin: int, end: int) -> ReadDataStream:
    return ReadDataStream(BytesIO(data[begin:end]))


def decompressed(kind: str, data: bytes, most: int) -> bytes | None:
    """Return decompressed data; None when they are truncated or have more than `most` bytes.

    Args:
        kind: "zstd", "lz4", "bz2", or "" for data that are not compressed.
        data: compressed.
        most: largest number of bytes.

    Raises:
        ValueError: the kind is unknown.
        Exception: the data are damaged; each library raises its own exception.
    """
    if kind == "":
        return data
    if kind not in ("zstd", "lz4", "bz2"):
        raise ValueError(f"the compression {kind[:20]!r} is unknown: only zstd and lz4 can be read")
    if kind == "zstd":
        found: bytes = zstandard.ZstdDecompressor().stream_reader(data).read(most + 1)
        return found if len(found) <= most else None
    stream: Any = lz4.frame.LZ4FrameDecompressor() if kind == "lz4" else bz2.BZ2Decompressor()
    found = stream.decompress(data, max_length=most + 1)
    return found if stream.eof and len(found) <= most else None
