"""Records and chunks of an MCAP file: lengths are checked before anything is read, and chunks are unpacked in pieces up to a limit.

The mcap library parses the records of the summary. Chunks are taken apart here: it would unpack whatever they claim, and build an object for
each message that nobody wants.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Metadata, Schema, Statistics

from uwserver.logfiles.log import Limits, LogError

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, CHUNK_INDEX, STATISTICS, METADATA, METADATA_INDEX, DATA_END = (
    2,
    3,
    4,
    5,
    6,
    8,
    11,
    12,
    13,
    15,
)
_FOOTER_BYTES = 9 + 20 + 8
_PIECE = 1 << 20


class ChunkPlace(NamedTuple):
    """A chunk in the file: times of its first and last message, where its record begins, its length with the record's head, the numbers of its
    channels as the index has them (10 bytes each; empty when unknown), and its length unpacked."""

    start: int
    end: int
    offset: int
    length: int
    channels: bytes
    unpacked: int


class Summary(NamedTuple):
    """What stands at the end of a whole file."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: list[ChunkPlace]
    statistics: Statistics | None
    metadata: list[int]


class Located(NamedTuple):
    """One message: number of its channel, its time in the log, and where its data stand in the unpacked chunk."""

    channel: int
    log_time: int
    begin: int
    end: int


class Records:
    """The records of an open MCAP file.

    Args:
        path: for error texts.
        file: open for reading.
        limits: what it may ask for.
    """

    def __init__(self, path: Path, file: IO[bytes], limits: Limits) -> None:
        self.path, self._file, self._limits = path, file, limits
        self.size = file.seek(0, 2)
        self._left = limits.expansion * self.size + limits.record_bytes

    def read(self, offset: int, length: int) -> bytes:
        """Bytes at a place; fewer at the end of the file."""
        if length > self._limits.record_bytes:
            raise LogError(
                f"{self.path}: a record of {length} bytes at byte {offset}: more than {self._limits.record_bytes}"
            )
        self._file.seek(offset)
        return self._file.read(length)

    def summary(self) -> Summary | None:
        """The summary; None when the file has none, or was cut."""
        tail = self.read(max(0, self.size - _FOOTER_BYTES), _FOOTER_BYTES)
        if len(tail) < _FOOTER_BYTES or not tail.endswith(MAGIC) or tail[0] != FOOTER:
            return None
        start = int(struct.unpack_from("<Q", tail, 9)[0])
        if not 0 < start < self.size:
            return None
        found = Summary({}, {}, [], None, [])
        data = self.read(start, self.size - _FOOTER_BYTES - start)
        for code, begin, end in _records(data, len(data)):
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
        """The metadata record at a place; None when there is none."""
        head = self.read(offset, _RECORD.size)
        if len(head) < _RECORD.size:
            return None
        code, length = _RECORD.unpack(head)
        data = self.read(offset + _RECORD.size, length)
        return Metadata.read(_stream(data, 0, len(data))) if code == METADATA and len(data) == length else None

    def heads(self) -> Iterator[tuple[int, int, int]]:
        """Code, place of the content and its length of every record of the data section, until the end or what is damaged."""
        at = len(MAGIC)
        while True:
            head = self.read(at, _RECORD.size)
            if len(head) < _RECORD.size:
                return
            code, length = _RECORD.unpack(head)
            if at + _RECORD.size + length > self.size or code in (0, DATA_END, FOOTER):
                return
            yield code, at + _RECORD.size, length
            at += _RECORD.size + length

    def claim(self, unpacked: int) -> None:
        """Count what a chunk will be unpacked; once for each chunk, however often it is read.

        Raises:
            LogError: all chunks together claim too much.
        """
        self._left -= unpacked
        if self._left < 0:
            most = self._limits.expansion
            raise LogError(f"{self.path}: unpacked it would be more than {most} times its size, as of a zip bomb")

    def unpacked(self, begin: int, length: int, claimed: int | None = None) -> bytes:
        """The content of the chunk whose record has its content at a place; no more than was claimed, or else it is claimed now."""
        data = self.read(begin, length)
        if len(data) < _CHUNK.size:
            raise LogError(f"{self.path}: the chunk at byte {begin} is cut")
        _, _, size, _, name = _CHUNK.unpack_from(data)
        if size > self._limits.record_bytes:
            raise LogError(
                f"{self.path}: the chunk at byte {begin} claims {size} bytes: more than {self._limits.record_bytes}"
            )
        if claimed is not None and size != claimed:
            raise LogError(f"{self.path}: the chunk at byte {begin} claims {size} bytes, the index says {claimed}")
        if claimed is None:
            self.claim(size)
        compression = data[_CHUNK.size : _CHUNK.size + name]
        packed = data[_CHUNK.size + name + 8 :]
        if compression == b"":
            return packed
        if compression == b"zstd":
            unpack = zstandard.ZstdDecompressor().stream_reader(packed)
            found = unpack.read(size + 1)
        elif compression == b"lz4":
            found = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        else:
            raise LogError(f"{self.path}: a chunk is compressed by {compression[:20]!r}: only zstd and lz4 are known")
        if len(found) != size:
            raise LogError(f"{self.path}: the chunk at byte {begin} does not unpack to the {size} bytes that it claims")
        return found


def messages(data: bytes) -> list[Located]:
    """The messages of an unpacked chunk, in its order; what is cut at its end is left out."""
    unpack = _MESSAGE.unpack_from
    found = []
    for code, begin, end in _records(data, len(data)):
        if code == MESSAGE and end - begin >= _MESSAGE.size:
            channel, _, log_time, _ = unpack(data, begin)
            found.append(Located(channel, log_time, begin + _MESSAGE.size, end))
    return found


def learn(
    code: int, data: bytes, begin: int, end: int, schemas: dict[int, Schema], channels: dict[int, Channel]
) -> None:
    """Keep what a record says of a schema or channel."""
    if code == SCHEMA:
        schema = Schema.read(_stream(data, begin, end))
        schemas[schema.id] = schema
    elif code == CHANNEL:
        channel = Channel.read(_stream(data, begin, end))
        channels[channel.id] = channel


def learn_all(data: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    """Keep what the records of an unpacked chunk say of schemas and channels."""
    for code, begin, end in _records(data, len(data)):
        if code in (SCHEMA, CHANNEL):
            learn(code, data, begin, end, schemas, channels)


def _records(data: bytes, size: int) -> Iterator[tuple[int, int, int]]:
    at, unpack, head = 0, _RECORD.unpack_from, _RECORD.size
    while at + head <= size:
        code, length = unpack(data, at)
        begin = at + head
        at = begin + length
        if at > size:
            return
        yield code, begin, at


def _stream(data: bytes, begin: int, end: int) -> ReadDataStream:
    return ReadDataStream(BytesIO(data[begin:end]))
