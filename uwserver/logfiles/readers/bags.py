"""Reads bags of ROS 1 (.bag) and ROS 2 (a folder, or a .db3 file) with rosbags."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, Topic, foreign
from uwserver.logfiles.readers import mcap_file
from uwserver.logfiles.readers.decoding import Decoding, ros_decoding, undecoded
from uwserver.logfiles.readers.mcap_records import decompressed
from uwserver.logfiles.timebase import FIRST_UTC_NS, shortened

_FILE_MODE = re.compile(rb"^\s*compression_mode:\s*[\"']?file", re.IGNORECASE | re.MULTILINE)
_MOST_METADATA = 1 << 24


def open_file(path: Path, limits: Limits) -> Log:
    """Open the log in a bag.

    Raises:
        LogError: its files are compressed as a whole, or it exceeds the limits.
    """
    if not path.is_dir() and path.suffix != ".db3":
        from rosbags.rosbag1 import Reader as Reader1

        return _Bag(path, "bag", Reader1(path), limits)
    from rosbags.rosbag2 import Reader as Reader2

    if path.is_dir():
        with (path / "metadata.yaml").open("rb") as about:
            text = about.read(_MOST_METADATA)
        if _FILE_MODE.search(text):
            raise LogError(f"{path}: its files are compressed as a whole: decompress them (zstd -d) and try again")
        files = sorted(path.glob("*.mcap"))
        if len(files) == 1:
            return mcap_file.open_file(files[0], limits)
        for file in files:
            mcap_file.open_file(file, limits).close()  # refuses a file that exceeds the limits
    return _Bag(path, "rosbag2", Reader2(path), limits)


class _Bag:
    """A `Log` over a rosbags reader."""

    def __init__(self, path: Path, kind: Kind, reader: Any, limits: Limits) -> None:
        self.path = path
        self.kind: Kind = kind
        self._reader, self._most_bytes = reader, limits.record_bytes
        self._is_compressed = False
        self._decodings: dict[int, Decoding] = {}
        self.topics: dict[str, Topic] = {}
        reader.open()
        try:
            self._limit()
            if len(reader.connections) > limits.topics:
                raise LogError(f"{path}: {len(reader.connections)} connections, more than {limits.topics}")
            self.remarks = tuple(shortened(self._read_types()))
            self._begin = int(reader.start_time) if reader.message_count else 0
            self.start_ns, self.end_ns = 0, int(reader.end_time) - 1 - self._begin if reader.message_count else 0
            self.epoch_ns = self._begin if self._begin >= FIRST_UTC_NS else None
        except BaseException:
            reader.close()
            raise

    def _limit(self) -> None:
        """Replace the decompression of rosbags, which has no limit. ROS 1 compresses chunks, ROS 2 each message."""
        if self.kind == "bag":
            chunks = self._reader.chunks
            for place, chunk in chunks.items():
                module = str(getattr(chunk.decompressor, "__module__", ""))
                kind = "bz2" if "bz2" in module else "lz4" if "lz4" in module else ""
                if kind:
                    chunks[place] = chunk._replace(decompressor=partial(self._decompressed, kind))
        elif self._reader.compression_mode == "message":
            self._is_compressed = True
            self._reader.storage.metadata = self._reader.storage.metadata._replace(compression_mode=None)

    def _decompressed(self, kind: str, data: bytes) -> bytes:
        found = decompressed(kind, data, self._most_bytes)
        if found is None:
            raise LogError(f"{self.path}: a chunk is truncated, or decompresses to more than {self._most_bytes} bytes")
        return found

    def _read_types(self) -> list[str]:
        """Fill `topics` and `_decodings`; return remarks about types that cannot be decoded."""
        remarks: list[str] = []
        known: dict[tuple[str, str], Decoding] = {}
        for connection in self._reader.connections:
            key = (connection.msgtype, connection.msgdef.data)
            if key not in known:
                known[key] = self._decoding(connection, remarks)
            topic, its = connection.topic, known[key]
            self._decodings[connection.id] = its
            count = int(connection.msgcount) + ((self.topics[topic].count or 0) if topic in self.topics else 0)
            self.topics[topic] = Topic(topic, connection.msgtype, its.fields, count, None, None)
        return remarks

    def _decoding(self, connection: Any, remarks: list[str]) -> Decoding:
        name = str(connection.msgtype)
        try:
            with foreign(Path(name), "its definition cannot be used"):
                is_idl = connection.msgdef.format.name == "IDL"
                found = ros_decoding(name, connection.msgdef.data, is_idl, self.kind == "bag")
                if found is None:
                    raise LogError(f"{name}: neither the bag nor ROS 2 Humble defines this type")
                return found
        except LogError as error:
            remarks.append(f"{error}: its messages are given as bytes")
            return undecoded("")

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Yield data, as `Log.read`."""
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        start = None if start_ns is None else max(0, start_ns + self._begin)
        stop = None if end_ns is None else max(0, end_ns + self._begin + 1)
        newest = self._begin if start is None else start
        if not chosen:  # rosbags would take an empty list for all connections
            return
        with foreign(self.path, "a message cannot be read"):
            for connection, stamp, data in self._reader.messages(connections=chosen, start=start, stop=stop):
                newest = max(newest, stamp)
                content = self._decompressed("zstd", bytes(data)) if self._is_compressed else data
                yield Datum(newest - self._begin, connection.topic, self._decodings[connection.id].decode(content))

    def close(self) -> None:
        """Close the files, as `Log.close`."""
        if self._reader.is_open if self.kind == "rosbag2" else self._reader.bio:
            self._reader.close()
