"""An MCAP file that is written chunk by chunk: byte for byte what `mcap.writer.Writer` would write, at a fifth of its processor time for a message.

Records are the library's own, but for messages and their indexes, of which there are hundreds of thousands a second.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import IO, TYPE_CHECKING

import numpy as np
import zstandard

if TYPE_CHECKING:
    from mcap.records import AttachmentIndex, Channel, ChunkIndex, McapRecord, MetadataIndex, Schema

_MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length of what follows, channel, sequence, log time, publish time."""
_HEAD = _MESSAGE.size
_COUNTED = _HEAD - 9
"""Bytes of it that the length counts, too."""
_INDEX = struct.Struct("<BQHI")
"""Opcode, length of what follows, channel, bytes of its entries."""

Head = tuple[int, int, int, int]
"""Of a message: channel, sequence (32 bits), log time and publish time (ns)."""


class ChunkedFile:
    """Writes an MCAP file. Used by one thread at a time; every method raises OSError when the file cannot be written.

    Args:
        file: an empty binary file, opened for writing.
        library: what the header says of the writer.
        chunk_size: a chunk ends as soon as it is larger, bytes.
    """

    def __init__(self, file: IO[bytes], library: str, chunk_size: int) -> None:
        # Imported here: it costs more than the rest of the start-up, and most runs record nothing.
        from mcap.data_stream import RecordBuilder
        from mcap.opcode import Opcode
        from mcap.records import Header

        self._file, self._chunk_size = file, chunk_size
        self._builder = RecordBuilder
        self._message, self._message_index = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 0, 0
        # Of the chunk in progress: its pieces, their bytes together, and by channel time and place of each message.
        self._pieces: list[bytes] = []
        self._size = 0
        self._places: dict[int, list[int]] = {}
        file.write(_MAGIC)
        self._write(Header("", library))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """A new schema; returns its number."""
        from mcap.records import Schema

        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._add(self._bytes(schema))
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        """A new channel of messages of a schema; returns its number."""
        from mcap.records import Channel

        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, schema_id=schema, metadata=about
        )
        self._channels.append(channel)
        self._add(self._bytes(channel))
        return channel.id

    def add_message(self, head: Head, data: bytes) -> None:
        """A message of a registered channel."""
        self.add_messages((head,), (data,))

    def add_messages(self, heads: Iterable[Head], bodies: Iterable[bytes]) -> None:
        """Messages in their order; there may be more bodies than heads."""
        pieces, places, size, most = self._pieces, self._places, self._size, self._chunk_size
        pack, opcode = _MESSAGE.pack, self._message
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
        """A record of keys and texts."""
        from mcap.records import Metadata, MetadataIndex

        offset = self._file.tell()
        length = self._write(Metadata(name=name, metadata=data))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """A file in the file."""
        from mcap.records import Attachment, AttachmentIndex

        offset = self._file.tell()
        length = self._write(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        index = AttachmentIndex(
            offset=offset,
            length=length,
            create_time=0,
            log_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._attachments.append(index)

    def flush(self) -> None:
        """End the chunk in progress, if there are messages in it, and hand everything to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write index and statistics; nothing may follow."""
        from mcap.records import DataEnd, Footer, Statistics, SummaryOffset

        self._end_chunk()
        self._write(DataEnd(0))
        start = self._file.tell()
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks), message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata), message_start_time=self._first_ns, message_end_time=self._last_ns,
            schema_count=len(self._schemas),
        )  # fmt: skip
        groups: list[tuple[int, Sequence[McapRecord]]] = [
            (3, self._schemas), (4, self._channels), (11, [statistics]), (8, self._chunks), (10, self._attachments),
            (13, self._metadata),
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
        crc = zlib.crc32(struct.pack("<BQQQ", 2, 8 + 8 + 4, start, offset_start), zlib.crc32(summary))
        self._file.write(summary)
        self._write(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._file.write(_MAGIC)

    def _add(self, record: bytes) -> None:
        self._pieces.append(record)
        self._size += len(record)
        if self._size > self._chunk_size:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk in progress, unless there is no message in it: then what is registered waits for the first."""
        if not self._places:
            return
        from mcap.records import Chunk, ChunkIndex

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
            pieces += (_INDEX.pack(self._message_index, 6 + size, channel, size), entries_bytes[done : done + size])
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
        """Write a record; returns its bytes."""
        data = self._bytes(record)
        self._file.write(data)
        return len(data)

    def _bytes(self, record: McapRecord) -> bytes:
        builder = self._builder()
        record.write(builder)
        data: bytes = builder.end()  # type: ignore[no-untyped-call]
        return data
