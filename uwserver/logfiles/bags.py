"""Bags of ROS 1 (.bag) and ROS 2 (a folder, or a .db3 file), by rosbags."""

from __future__ import annotations

import bz2
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from uwserver.logfiles import mcap_file
from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, LogField, Topic
from uwserver.logfiles.ros_messages import Definition, RosTypes
from uwserver.logfiles.timebase import shortened

_FIRST_UTC_NS = 946_684_800_000_000_000
_FILE_MODE = re.compile(rb"^\s*compression_mode:\s*[\"']?file", re.IGNORECASE | re.MULTILINE)
_MOST_METADATA = 1 << 24
_Decode = Callable[[bytes], Mapping[str, object]]


def open_file(path: Path, limits: Limits) -> Log:
    """The log in a bag.

    Raises:
        LogError: it is compressed as a whole, or asks for more than the limits.
    """
    if not path.is_dir() and path.suffix != ".db3":
        from rosbags.rosbag1 import Reader as Reader1

        return _Bag(path, "bag", Reader1(path), limits)
    from rosbags.rosbag2 import Reader as Reader2

    if path.is_dir():
        with (path / "metadata.yaml").open("rb") as about:
            text = about.read(_MOST_METADATA)
        if _FILE_MODE.search(text):
            raise LogError(f"{path}: its files are compressed as a whole: unpack them (zstd -d) and try again")
        files = sorted(path.glob("*.mcap"))
        if len(files) == 1:
            return mcap_file.open_file(files[0], limits)
        for file in files:
            mcap_file.open_file(file, limits).close()  # refuses what claims too much
    return _Bag(path, "rosbag2", Reader2(path), limits)


class _Bag:
    """A `Log` of an open rosbags reader."""

    def __init__(self, path: Path, kind: Kind, reader: Any, limits: Limits) -> None:
        self.path = path
        self.kind: Kind = kind
        self._reader, self._limits = reader, limits
        self._unzips = False
        reader.open()
        try:
            self._limit()
            if len(reader.connections) > limits.topics:
                raise LogError(f"{path}: {len(reader.connections)} connections, more than {limits.topics}")
            self._decoders: dict[int, _Decode] = {}
            remarks: list[str] = []
            self.topics: Mapping[str, Topic] = self._learn(remarks)
            self._begin = int(reader.start_time) if reader.message_count else 0
            self.start_ns, self.end_ns = 0, int(reader.end_time) - 1 - self._begin if reader.message_count else 0
            self.epoch_ns = self._begin if self._begin >= _FIRST_UTC_NS else None
            self.remarks = tuple(shortened(remarks))
        except BaseException:
            reader.close()
            raise

    def _limit(self) -> None:
        """Let nothing unpack without a limit: chunks of ROS 1 here, messages of ROS 2 as they are read."""
        if self.kind == "bag":
            chunks = self._reader.chunks
            for place, chunk in chunks.items():
                unpack = {"bz2": self._bz2, "lz4": self._lz4}.get(_compression(chunk.decompressor))
                if unpack is not None:
                    chunks[place] = chunk._replace(decompressor=unpack)
        elif self._reader.compression_mode == "message":
            self._unzips = True
            self._reader.storage.metadata = self._reader.storage.metadata._replace(compression_mode=None)

    def _bz2(self, data: bytes) -> bytes:
        unpack = bz2.BZ2Decompressor()
        return self._whole(unpack.decompress(data, self._limits.record_bytes), unpack.eof)

    def _lz4(self, data: bytes) -> bytes:
        unpack = lz4.frame.LZ4FrameDecompressor()
        return self._whole(unpack.decompress(data, max_length=self._limits.record_bytes), unpack.eof)

    def _zstd(self, data: bytes) -> bytes:
        found = zstandard.ZstdDecompressor().stream_reader(data).read(self._limits.record_bytes)
        return self._whole(found, len(found) < self._limits.record_bytes)

    def _whole(self, data: bytes, is_whole: bool) -> bytes:
        if not is_whole:
            raise LogError(f"{self.path}: a chunk is cut, or unpacks to more than {self._limits.record_bytes} bytes")
        return data

    def _learn(self, remarks: list[str]) -> dict[str, Topic]:
        counts: dict[str, int] = {}
        known: dict[tuple[str, str], tuple[tuple[LogField, ...], _Decode | None]] = {}
        found: dict[str, Topic] = {}
        for connection in self._reader.connections:
            key = (connection.msgtype, connection.msgdef.data)
            if key not in known:
                known[key] = self._type(connection, remarks)
            fields, decode = known[key]
            self._decoders[connection.id] = decode or (lambda data: {"data": bytes(data)})
            counts[connection.topic] = counts.get(connection.topic, 0) + int(connection.msgcount)
            found[connection.topic] = Topic(
                connection.topic, connection.msgtype, fields, counts[connection.topic], None, None
            )
        return found

    def _type(self, connection: Any, remarks: list[str]) -> tuple[tuple[LogField, ...], _Decode | None]:
        name = str(connection.msgtype)
        try:
            with foreign(Path(name), "its definition cannot be used"):
                text, is_idl = connection.msgdef.data, connection.msgdef.format.name == "IDL"
                types = RosTypes([Definition(name, text, is_idl)])
                decode = types.decoder(name, self.kind == "bag")
                if decode is None:
                    raise LogError(f"{name}: the bag does not define it, and it is none of ROS")
                return types.fields(name), decode
        except LogError as error:
            remarks.append(f"{error}: only the bytes of its messages are given")
            return (LogField("data", "bytes"),), None

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """As in `Log`."""
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        start = None if start_ns is None else max(0, start_ns + self._begin)
        stop = None if end_ns is None else max(0, end_ns + self._begin + 1)
        newest = self._begin if start is None else start
        if not chosen:
            return
        with foreign(self.path, "a message cannot be read"):
            for connection, stamp, data in self._reader.messages(connections=chosen, start=start, stop=stop):
                newest = max(newest, stamp)
                content = self._zstd(bytes(data)) if self._unzips else data
                yield Datum(newest - self._begin, connection.topic, self._decoders[connection.id](content))

    def close(self) -> None:
        """As in `Log`."""
        if self._reader.is_open if self.kind == "rosbag2" else self._reader.bio:
            self._reader.close()


def _compression(decompressor: Any) -> str:
    """Which of the packers of ROS 1 a chunk used."""
    module = str(getattr(decompressor, "__module__", ""))
    return "bz2" if "bz2" in module else "lz4" if "lz4" in module else ""
