"""Reads MCAP files, ours and others. If the file has an index, only the summary is read on opening; otherwise the whole file is."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, Topic, foreign
from uwserver.logfiles.readers.decoding import Decoding, decoding, undecoded
from uwserver.logfiles.readers.indexed import Entries, IndexedLog, LogTopic
from uwserver.logfiles.readers.mcap_records import (
    CHANNEL,
    CHUNK,
    MAGIC,
    MESSAGE,
    METADATA,
    RECORD_HEAD_BYTES,
    SCHEMA,
    ChunkPlace,
    Records,
    Summary,
    learn,
    messages,
    records_in,
)
from uwserver.logfiles.timebase import FIRST_UTC_NS, LAST_NS, LATE_NS, log_times, seconds, shortened, time_base, utc_ns

OURS = "uwserver"
"""Name of the metadata record of our own recordings."""
_MESSAGE_HEAD = 22
_KEPT_CHUNKS = 4
_MOST_PENDING_BYTES = 4 * (256 << 20)


def open_file(path: Path, limits: Limits) -> Log:
    """Open the log in an MCAP file.

    Raises:
        LogError: it contains no whole record, or a length in it exceeds the limits.
    """
    file = path.open("rb")
    try:
        records = Records(path, file, limits)
        summary = records.summary()
        if summary is not None and _is_complete(summary):
            _check_count(path, len(summary.channels), limits)
            head = _head(records, summary.metadata)
            if not (head and _goes_back(summary.chunks)):
                return _Indexed(path, records, summary, head, file.close)
        return _scanned(path, records, summary is None, limits, file.close)
    except BaseException:
        file.close()
        raise


def head_of(path: Path) -> Mapping[str, str]:
    """Read the metadata record at the start of a recording of ours; empty for any other file. Raises OSError."""
    with path.open("rb") as file:
        return Records(path, file, Limits()).first_metadata().get(OURS, {})


def _check_count(path: Path, channels: int, limits: Limits) -> None:
    if channels > limits.topics:
        raise LogError(f"{path}: {channels} channels, more than {limits.topics}")


def _is_complete(summary: Summary) -> bool:
    """Return whether the index leads to every message."""
    counted = summary.statistics
    if counted is None or (counted.message_count and not summary.chunks):
        return False
    return all(channel in summary.channels for channel in counted.channel_message_counts)


def _head(records: Records, offsets: list[int]) -> Mapping[str, str] | None:
    for offset in offsets[:16]:
        record = records.metadata(offset)
        if record is not None and record.name == OURS:
            return record.metadata
    return None


def _goes_back(chunks: list[ChunkPlace]) -> bool:
    """Return whether time goes back from chunk to chunk in the order of the file, because the world was reset."""
    newest = 0
    for chunk in sorted(chunks, key=lambda c: c.offset):
        if chunk.start < newest - LATE_NS and chunk.end:
            return True
        newest = max(newest, chunk.end)
    return False


def _epoch(head: Mapping[str, str]) -> int | None:
    """Return the UTC of simulation time 0, which the scenario in the head gives."""
    try:
        text = msgspec.json.decode(head["scenario"])["scenario"]["world"]["epoch_utc"]
    except (KeyError, TypeError, ValueError):
        return None
    return utc_ns(str(text))


class _Channels:
    """The channels of a file by topic, and how they are decoded; `is_own` tells that the file is a recording of ours."""

    def __init__(self, channels: Mapping[int, Any], schemas: Mapping[int, Any], is_own: bool) -> None:
        self._is_own = is_own
        self.by_topic: dict[str, list[int]] = {}
        self.decodings: dict[int, Decoding] = {}
        self.schema_of: dict[int, str] = {}
        self.remarks: list[str] = []
        known: dict[tuple[str, int], Decoding] = {}
        for number, channel in sorted(channels.items()):
            schema = schemas.get(channel.schema_id)
            key = (channel.message_encoding, channel.schema_id)
            if key not in known:
                known[key] = self._decoding(channel, schema)
            self.decodings[number] = known[key]
            self.schema_of[number] = "" if schema is None else schema.name
            self.by_topic.setdefault(channel.topic, []).append(number)
        several = [
            f"{topic}: {len(n)} channels have this name and are read as one"
            for topic, n in self.by_topic.items()
            if len(n) > 1
        ]
        self.remarks = [*shortened(self.remarks), *shortened(several)]

    def _decoding(self, channel: Any, schema: Any) -> Decoding:
        about = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
        try:
            with foreign(Path(channel.topic), "its schema cannot be used"):
                found = decoding(channel.message_encoding, *about)
        except LogError as error:
            # Channels for viewers in a recording of ours repeat what its own channels say, which need no package.
            if not (self._is_own and isinstance(error.__cause__, ImportError)):
                self.remarks.append(f"{error}; until then its messages are given as bytes")
            return undecoded("")
        if found.remark:
            self.remarks.append(f"{channel.topic}: {found.remark}")
        return found

    def topic(self, name: str, count: int | None) -> Topic:
        """Return a topic; if several channels have its name, with the type of the last."""
        number = self.by_topic[name][-1]
        return Topic(name, self.schema_of[number], self.decodings[number].fields, count, None, None)


class _Indexed:
    """A `Log` that reads the chunks that the index names."""

    def __init__(
        self, path: Path, records: Records, summary: Summary, head: Mapping[str, str] | None, close: Callable[[], None]
    ) -> None:
        self.path = path
        self.kind: Kind = "uwserver" if head else "mcap"
        self._records, self._close = records, close
        self._chunks = sorted((c for c in summary.chunks if c.unpacked), key=lambda c: (c.start, c.offset))
        for chunk in self._chunks:
            records.claim(chunk.unpacked)
        first = min((chunk.start for chunk in self._chunks), default=0)
        last = max((chunk.end for chunk in self._chunks), default=0)
        self._begin = 0 if head else min(first, LAST_NS)
        self.start_ns, self.end_ns = min(first, LAST_NS) - self._begin, min(last, LAST_NS) - self._begin
        self.epoch_ns = _epoch(head) if head else self._begin if self._begin >= FIRST_UTC_NS else None
        self._channels = _Channels(summary.channels, summary.schemas, bool(head))
        self._topic_of = {number: name for name, numbers in self._channels.by_topic.items() for number in numbers}
        counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
        self.topics: Mapping[str, Topic] = {
            name: self._channels.topic(name, sum(int(counts.get(n, 0)) for n in numbers))
            for name, numbers in self._channels.by_topic.items()
        }
        silences = []
        if not head and _goes_back(summary.chunks):
            silences.append("log times go back within the file: it is read in the order of log times, as MCAP tools do")
        newest = self._chunks[0].end if self._chunks else 0
        for chunk in self._chunks:
            if chunk.start > newest + LATE_NS:
                silences.append(f"no data for {seconds(chunk.start - newest)} from {seconds(newest - self._begin)}")
            newest = max(newest, chunk.end)
        self.remarks = (*self._channels.remarks, *shortened(silences))

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Yield data, as `Log.read`."""
        wanted = {n for n, name in self._topic_of.items() if topics is None or name in topics}
        first = -1 if start_ns is None else start_ns + self._begin
        last = 1 << 64 if end_ns is None else end_ns + self._begin
        return self._read(wanted, first, last)

    def _read(self, wanted: set[int], first: int, last: int) -> Iterator[Datum]:
        decoders = {number: self._channels.decodings[number].decode for number in wanted}
        begin, topic_of = self._begin, self._topic_of
        with foreign(self.path, "a message cannot be read"):
            chosen = [c for c in self._chunks if c.end >= first and c.start <= last and _holds(c, wanted)]
            # Chunks may overlap in time: messages wait here until the next chunk begins later than they do.
            pending: list[tuple[int, int, bytes]] = []
            newest = begin
            for k, chunk in enumerate(chosen):
                place = chunk.offset + RECORD_HEAD_BYTES
                data = self._records.unpacked(place, chunk.length - RECORD_HEAD_BYTES, chunk.unpacked)
                pending += [
                    (m.log_time, m.channel, data[m.begin : m.end])
                    for m in messages(data)
                    if m.channel in wanted and first <= m.log_time <= last
                ]
                pending.sort(key=lambda m: m[0])
                until = chosen[k + 1].start if k + 1 < len(chosen) else 1 << 64
                done = 0
                for log_time, channel, content in pending:
                    if log_time >= until:
                        break
                    done += 1
                    newest = max(newest, log_time)  # the time of a damaged message may be before its chunk
                    yield Datum(min(newest, LAST_NS) - begin, topic_of[channel], decoders[channel](content))
                del pending[:done]
                if pending and sum(len(m[2]) for m in pending) > _MOST_PENDING_BYTES:
                    raise LogError(
                        f"{self.path}: more than {_MOST_PENDING_BYTES >> 20} MB of its chunks overlap in time"
                    )

    def close(self) -> None:
        """Close the file, as `Log.close`."""
        self._close()


def _holds(chunk: ChunkPlace, wanted: set[int]) -> bool:
    """Return whether the index says that a chunk has messages of these channels; without an index it may have any."""
    if not chunk.channels:
        return True
    whole = chunk.channels[: len(chunk.channels) // 10 * 10]
    return not wanted.isdisjoint(np.frombuffer(whole, np.dtype([("id", "<u2"), ("at", "<u8")]))["id"].tolist())


class _Scan:
    """All records of a file without index, up to where it is damaged.

    Attributes:
        stamps, numbers, places: log time, channel and place of each message. A negative place is minus the place in the file; any other is the
            index of the chunk << 32 | place in the chunk.
        chunks: place and length of the content of each chunk, and its decompressed length.
        head: the metadata record of a recording of ours; None without one.
    """

    def __init__(self, records: Records) -> None:
        self.channels: dict[int, Any] = {}
        self.schemas: dict[int, Any] = {}
        self.stamps, self.numbers, self.places = array("Q"), array("i"), array("q")
        self.chunks: list[tuple[int, int, int]] = []
        self.head: Mapping[str, str] | None = None
        self.remarks: list[str] = []
        for code, begin, length in records.heads():
            if code == METADATA and self.head is None:
                self.head = _head(records, [begin - RECORD_HEAD_BYTES])
            elif code == MESSAGE and length >= _MESSAGE_HEAD:
                content = records.read(begin, _MESSAGE_HEAD)
                self._add(int.from_bytes(content[:2], "little"), int.from_bytes(content[6:14], "little"), -begin)
            elif code == CHUNK:
                self._chunk(records, begin, length)
            elif code in (SCHEMA, CHANNEL):
                learn(code, records.read(begin, length), 0, length, self.schemas, self.channels)

    def _add(self, channel: int, log_time: int, place: int) -> None:
        self.numbers.append(channel)
        self.stamps.append(log_time)
        self.places.append(place)

    def _chunk(self, records: Records, begin: int, length: int) -> None:
        try:
            with foreign(records.path, f"the chunk at byte {begin} is damaged"):
                data = records.unpacked(begin, length)
        except LogError as error:
            self.remarks.append(f"a chunk is left out: {str(error).removeprefix(f'{records.path}: ')}")
            return
        for code, start, end in records_in(data):
            if code in (SCHEMA, CHANNEL):
                learn(code, data, start, end, self.schemas, self.channels)
        for m in messages(data):
            self._add(m.channel, m.log_time, len(self.chunks) << 32 | m.begin - _MESSAGE_HEAD)
        self.chunks.append((begin, length, len(data)))


def _scanned(path: Path, records: Records, is_cut: bool, limits: Limits, close: Callable[[], None]) -> Log:
    """Make a log of every record of the file."""
    if records.read(0, len(MAGIC)) != MAGIC:
        raise LogError(f"{path}: not an MCAP file")
    scan = _Scan(records)
    if not scan.channels and not scan.stamps:
        raise LogError(f"{path}: the MCAP file of {records.size} bytes contains not one whole record")
    _check_count(path, len(scan.channels), limits)
    remarks = ["the file has no whole index (it was cut, is still being written, or is damaged): all of it was read"]
    remarks = [*(remarks if is_cut else []), *scan.remarks]
    known = _Channels(scan.channels, scan.schemas, bool(scan.head))
    topic_of = {n: k for k, of in enumerate(known.by_topic.values()) for n in of}
    described = np.array([n in topic_of for n in scan.numbers], bool)
    if lost := int((~described).sum()):
        remarks.append(f"{lost} messages are left out: the file does not describe their channels")
    stamps = np.minimum(np.frombuffer(scan.stamps, np.uint64)[described], LAST_NS).astype(np.int64)
    base = time_base(stamps, utc=False) if scan.head else log_times(stamps)
    if scan.head and len(stamps):
        # In our own recordings time 0 is the start of the scenario.
        base = base._replace(t_ns=base.t_ns + int(stamps[0] - base.t_ns[0]), epoch_ns=_epoch(scan.head))
    numbers = np.array([topic_of[n] for n in scan.numbers if n in topic_of], np.int32)
    entries = Entries(numbers, np.frombuffer(scan.places, np.int64)[described])
    decode = _decoder(records, scan.chunks, known.decodings)
    about = [known.topic(name, 0) for name in known.by_topic]
    sources = [LogTopic(topic.name, topic.schema, topic.fields, decode) for topic in about]
    kind: Kind = "uwserver" if scan.head else "mcap"
    return IndexedLog(path, kind, sources, entries, base, remarks=[*known.remarks, *shortened(remarks)], close=close)


def _decoder(
    records: Records, chunks: list[tuple[int, int, int]], decodings: Mapping[int, Decoding]
) -> Callable[[int], Mapping[str, object]]:
    """Return a function that decodes the message at a place of a scanned file. The chunks that were used last are kept."""

    @lru_cache(maxsize=_KEPT_CHUNKS)
    def chunk(number: int) -> bytes:
        return records.unpacked(*chunks[number])

    def decode(place: int) -> Mapping[str, object]:
        if place < 0:
            content = records.read(-place, int.from_bytes(records.read(-place - 8, 8), "little"))
        else:
            data, at = chunk(place >> 32), place & 0xFFFFFFFF
            content = data[at : at + int.from_bytes(data[at - 8 : at], "little")]
        return decodings[int.from_bytes(content[:2], "little")].decode(content[_MESSAGE_HEAD:])

    return decode
