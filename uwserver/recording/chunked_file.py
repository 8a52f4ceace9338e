"""Writes an MCAP file chunk by chunk: the same bytes as `mcap.writer.Writer`, at a fifth of its processor time per message.

The library makes all records except messages and message indexes, of which there may be hundreds of thousands a second.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import IO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from uwserver.logfiles.readers.mcap_records import MAGIC

_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time, publish time."""
_HEAD = _MESSAGE.size
_COUNTED = _HEAD - 9
"""Bytes of the head that its length field counts."""
_INDEX = struct.Struct("<BQHI")
"""Opcode, length of the rest, channel, bytes of its entries."""

Head = tuple[int, int, int, int]
"""The head of a message: channel, sequence (32 bits), log time and publish time (ns)."""


class ChunkedFile:
    """Writes an MCAP file. Only one thread may use it at a time. Every method raises OSError when the file cannot be written.

    Args:
        file: an empty binary file, opened for writing.
        library: name of the writer in the header.
        chunk_size: a chunk ends as soon as it is larger than this, bytes.
    """

    def __init__(self, file: IO[bytes], library: str, chunk_size: int) -> None:
        self._file, self._chunk_size = file, chunk_size
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 0, 0
        # The chunk in progress: its pieces, their total length, and for each channel the time and place of each message, one after the other.
        self._pieces: list[bytes] = []
        self._size = 0
        self._places: dict[int, list[int]] = {}
        file.write(MAGIC)
        self._write(Header("", library))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its number."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._add(self._bytes(schema))
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        """Add a channel for messages of a schema; return its number."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, schema_id=schema, metadata=about
        )
        self._channels.append(channel)
        self._add(self._bytes(channel))
        return channel.id

    def add_message(self, head: Head, data: bytes) -> None:
        """Add a message of a registered channel."""
        self.add_messages((head,), (data,))

    def add_messages(self, heads: Iterable[Head], bodies: Iterable[bytes]) -> None:
        """Add messages in their order; there may be more bodies than heads."""
        pieces, places, size, most = self._pieces, self._places, self._size, self._chunk_size
        pack, opcode = _MESSAGE.pack, int(Opcode.MESSAGE)
        for (channel, sequence, log_ns, publish_ns), data in zip(heads, bodies, strict=False):
            length = len(data)
            if channel in places:
                places[channel] += (log_ns, size)
            else:
                places[channel] = [log_ns, size]
            pieces += (pack(opcode, _COUNTED + length, channel, sequence, log_ns, publish_ns), data)
            size += _HEAD + length
            if size > most:
                self._size = size
                self._end_chunk()
                pieces, places, size = self._pieces, self._places, self._size
        self._size = size

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Add a metadata record."""
        offset = self._file.tell()
        length = self._write(Metadata(name=name, metadata=data))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment."""
        offset = self._file.tell()
        length = self._write(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(
                offset=offset, length=length, create_time=0, log_time=0, data_size=len(data), name=name, media_type=media_type,
            )
        )  # fmt: skip

    def flush(self) -> None:
        """End the chunk in progress, if it contains messages, and pass everything to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the index and the statistics. Nothing can be added afterwards."""
        self._end_chunk()
        self._write(DataEnd(0))
        start = self._file.tell()
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks), message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata), message_start_time=self._first_ns, message_end_time=self._last_ns,
            schema_count=len(self._schemas),
        )  # fmt: skip
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels), (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks), (Opcode.ATTACHMENT_INDEX, self._attachments), (Opcode.METADATA_INDEX, self._metadata),
        ]  # fmt: skip
        summary, offsets = b"", []
        for opcode, records in groups:
            group = b"".join(map(self._bytes, records))
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        offset_start = start + len(summary)
        summary += b"".join(map(self._bytes, offsets))
        # The checksum covers the summary and the footer up to the checksum itself.
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offset_start), zlib.crc32(summary))
        self._file.write(summary)
        self._write(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._file.write(MAGIC)

    def _add(self, record: bytes) -> None:
        self._pieces.append(record)
        self._size += len(record)
        if self._size > self._chunk_size:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk in progress. Without a message it is kept: its schemas and channels go into the chunk of the first message."""
        if not self._places:
            return
        data = b"".join(self._pieces)
        packed = zstandard.compress(data)
        entries = np.array([*chain.from_iterable(self._places.values())], "<u8")
        first, last = int(entries[::2].min()), int(entries[::2].max())
        self._first_ns = min(self._first_ns, first) if self._counts else first
        self._last_ns = max(self._last_ns, last)
        crc = zlib.crc32(data)
        offset = self._file.tell()
        length = self._write(Chunk("zstd", packed, last, first, crc, len(data)))
        pieces: list[bytes] = []
        at, places, done, entries_bytes = offset + length, {}, 0, entries.tobytes()
        for channel, each in self._places.items():
            places[channel], size = at, 8 * len(each)
            pieces += (_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size), entries_bytes[done : done + size])
            at, done = at + _INDEX.size + size, done + size
            self._counts[channel] = self._counts.get(channel, 0) + len(each) // 2
        indexes = b"".join(pieces)
        self._file.write(indexes)
        self._chunks.append(
            ChunkIndex(
                message_start_time=first, message_end_time=last, chunk_start_offset=offset, chunk_length=length,
                message_index_offsets=places, message_index_length=len(indexes), compression="zstd",
                compressed_size=len(packed), uncompressed_size=len(data),
            )
        )  # fmt: skip
        self._pieces, self._size, self._places = [], 0, {}

    def _write(self, record: McapRecord) -> int:
        """Write a record; return its length in bytes."""
        data = self._bytes(record)
        self._file.write(data)
        return len(data)

    def _bytes(self, record: McapRecord) -> bytes:
        builder = RecordBuilder()
        record.write(builder)
        data: bytes = builder.end()  # type: ignore[no-untyped-call]
        return data
