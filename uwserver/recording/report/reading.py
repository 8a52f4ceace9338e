"""What a report needs of a recording, as columns of numbers. Reads its parts and chunks once, in their order: also of a file that has no end."""

from __future__ import annotations

import contextlib
import re
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
import numpy.typing as npt

from uwserver.ports import Cast, Event, Field
from uwserver.recording.format import EVENTS, METADATA
from uwserver.recording.parts import SERVED
from uwserver.recording.reading import MOST_CHUNK_BYTES, MOST_RECORD_BYTES, NotReplayable, parts_of
from uwserver.recording.report.columns import Column, FloatArray, columns_of
from uwserver.recording.states import CASTS, STATES, CastRecord, read_state
from uwserver.scenario.files.opening import opened
from uwserver.units import NANOSECONDS

IntArray = npt.NDArray[np.int64]

MOST_EVENTS = 20_000
"""That a report keeps."""

_CHANNEL, _SCHEMA, _MESSAGE = 0x04, 0x03, 0x05
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_TYPES = {"number": "float", "integer": "int", "boolean": "bool", "string": "str", "object": "bytes"}


@dataclass(frozen=True)
class Series:
    """What one port told.

    Attributes:
        path: of the port; the part before the first "/" is its vehicle.
        kind: of the component.
        direction: "sensor" or "actuator".
        fields: by name; those of text and of pictures but a sonar's have no columns.
        t: (n) measured at, s of simulation time; of a command, when it acted.
        seq: (n) of samples, 0 for commands.
        valid: (n).
        columns: (n, size) of each field, NaN where there is no value.
    """

    path: str
    kind: str
    direction: str
    fields: dict[str, Field]
    t: FloatArray
    seq: IntArray
    valid: npt.NDArray[np.bool_]
    columns: dict[str, FloatArray]

    @property
    def vehicle(self) -> str:
        """First level of the path."""
        return self.path.partition("/")[0]


@dataclass(frozen=True)
class Recorded:
    """A recording.

    Attributes:
        path: of the file; of the first, if there are several.
        head: the metadata record, as text.
        scenario: its resolved scenario as plain tables: name, scenario, vehicles, materials.
        series: of each port that said something, by path.
        poses: (n, 8) of each body: t (s), p_NB (m), q_NB (w x y z), from the states; none in old recordings.
        events: what every client was told.
        end_s: simulation time of the last entry, s.
        remarks: what is missing or doubtful, as sentences.
    """

    path: Path
    head: dict[str, str]
    scenario: dict[str, Any]
    series: dict[str, Series]
    poses: dict[str, FloatArray]
    events: tuple[Event, ...]
    end_s: float
    remarks: tuple[str, ...]


def read_recording(path: Path) -> Recorded:
    """Read a recording of ours, of any version of the physics, with all its parts.

    Raises:
        OSError: a file cannot be read.
        ValueError: it is no recording of ours, or a part is missing; the text names it and says why.
    """
    reading = _Reading(path)
    with opened(path) as file:
        reading.read(path, file)
    try:
        later = parts_of(path)[1:]
    except NotReplayable as error:
        raise ValueError(str(error)) from error
    for part in later:
        with opened(part) as file:
            reading.read(part, file)
    return reading.recorded()


def fields_of(schema: dict[str, Any]) -> dict[str, Field]:
    """The fields of a port again, as far as the JSON schema of its channel tells them."""
    return {field.name: field for field in _fields(schema["properties"]["value"]["properties"])}


def _fields(properties: dict[str, Any]) -> Iterator[Field]:
    for name, told in properties.items():
        text = told["description"]
        unit, frame = re.search(r"; unit ([^;]*)", text), re.search(r"; frame (\w+)", text)
        shape = (int(told["maxItems"]),) if "items" in told else ()
        type_: Any = _TYPES[told.get("items", told)["type"][0]]
        yield Field(name, unit[1] if unit else "1", text, frame[1] if frame else "", shape, type_)


@dataclass
class _Channel:
    """A port of a recording while it is read."""

    path: str
    kind: str
    direction: str
    fields: dict[str, Field]
    t: array[int] = field(default_factory=lambda: array("q"))
    seq: array[int] = field(default_factory=lambda: array("q"))
    valid: bytearray = field(default_factory=bytearray)
    columns: dict[str, Column] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = dict(columns_of(self.kind, self.fields))

    def add(self, message: dict[str, Any], publish_ns: int) -> None:
        t_ns, seq = int(message.get("t_ns", publish_ns)), int(message.get("seq", 0))
        if not 0 <= t_ns <= _LATEST_NS:
            raise ValueError("a time that no world lives to see")
        value, whole = message["value"], len(self.t)
        try:
            for name, column in self.columns.items():
                column.add(value.get(name))
        except BaseException:
            for column in self.columns.values():
                del column.numbers[whole * column.size :]
            raise
        self.t.append(t_ns)
        self.seq.append(seq)
        self.valid.append(bool(message.get("valid", True)))

    def series(self) -> Series:
        count = len(self.t)
        return Series(
            self.path,
            self.kind,
            self.direction,
            self.fields,
            np.frombuffer(self.t, dtype=np.int64) / NANOSECONDS,
            np.frombuffer(self.seq, dtype=np.int64),
            np.frombuffer(bytes(self.valid), dtype=np.bool_),
            {name: column.whole(count) for name, column in self.columns.items()},
        )


class _Reading:
    """A recording while its files are read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[str, list[_Channel]] = {}
        self._head: dict[str, str] | None = None
        self._schemas: dict[int, dict[str, Any]] = {}
        self._channels: dict[int, _Channel | None] = {}
        self._events: list[Event] = []
        self._own: dict[int, str] = {}
        self._casts: dict[int, Cast] = {}
        self._poses: dict[str, array[float]] = {}
        self._bad: dict[str, int] = {}
        self._more_events = 0
        self._end_ns = 0
        self._remarks: list[str] = []

    def read(self, path: Path, file: IO[bytes]) -> None:
        """Read one file to its end, or to where it breaks off. Numbers of schemas and channels hold within a file."""
        from mcap.exceptions import McapError
        from mcap.records import Channel, Chunk, DataEnd, Metadata, Schema
        from mcap.stream_reader import StreamReader
        from zstandard import ZstdError

        self._schemas, self._channels, self._own = {}, {}, {}
        name = "file" if path == self._path else f"part {path.name}"
        ended = False
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=MOST_RECORD_BYTES).records:
                if isinstance(record, Metadata) and record.name == METADATA and self._head is None:
                    self._head = record.metadata
                elif isinstance(record, Schema):
                    self._schema(record.id, record.data)
                elif isinstance(record, Channel):
                    self._channel(record.id, record.topic, record.schema_id, record.metadata)
                elif isinstance(record, Chunk):
                    if self._head is None:
                        break
                    self._unpack(record)
                elif isinstance(record, DataEnd):
                    ended = True
                    break
        except (McapError, ZstdError, struct.error, ValueError, MemoryError, EOFError) as error:
            if self._head is None:
                text = f"{path}: not written by `uwserver run --record FILE`, or damaged at its start{f': {error}' if str(error) else ''}"
                raise ValueError(text) from error
            rest = "damaged" if file.read(1) else "cut off"
            self._remarks.append(f"The {name} is {rest} at byte {file.tell()}; the report ends there.")
            ended = True
        if self._head is None:
            raise ValueError(f"{path}: an MCAP file, but not written by `uwserver run --record FILE`")
        if not ended:
            self._remarks.append("The recording has no end: its server was killed, or it is still being written.")

    def recorded(self) -> Recorded:
        """All that was read."""
        assert self._head is not None
        try:
            if SERVED in self._head:  # by another process, which never had it
                scenario: dict[str, Any] = {"scenario": {}}
                self._remarks.append("Recorded from a running server: its scenario is not in the file.")
            else:
                scenario = msgspec.json.decode(self._head["scenario"], type=dict[str, Any])
        except (KeyError, msgspec.MsgspecError) as error:
            raise ValueError(f"{self._path}: its scenario cannot be read: {error}") from error
        for path, count in self._bad.items():
            self._remarks.append(f"{count} messages of {path} do not fit their schema and are left out.")
        if self._more_events:
            self._remarks.append(f"{self._more_events} events after the first {MOST_EVENTS} are left out.")
        resets = sum(event.event == "reset" for event in self._events)
        if resets:
            self._remarks.append(
                f"The world was reset {resets} times: what was told at the same time lies on top of one another."
            )
        found: dict[str, Series] = {}
        for channel in (channel for channels in self._found.values() for channel in channels):
            if len(channel.t):
                # A name that went to another kind has a channel each; the longest is shown.
                series = channel.series()
                if channel.path not in found or len(found[channel.path].t) < len(series.t):
                    found[channel.path] = _in_order(series)
        events = tuple(self._events)
        poses = {name: np.frombuffer(rows, dtype=np.float64).reshape(-1, 8) for name, rows in self._poses.items()}
        end_s = self._end_ns / NANOSECONDS
        return Recorded(self._path, self._head, scenario, found, poses, events, end_s, tuple(self._remarks))

    def _schema(self, number: int, data: bytes) -> None:
        with contextlib.suppress(msgspec.MsgspecError):  # one of another encoding, as Foxglove's
            self._schemas[number] = msgspec.json.decode(data, type=dict[str, Any])

    def _channel(self, number: int, topic: str, schema: int, about: dict[str, str]) -> None:
        if number in self._channels:
            return
        self._channels[number] = None
        if topic in (EVENTS, STATES, CASTS):
            self._own[number] = topic
        elif "kind" in about and "direction" in about and schema in self._schemas:
            try:
                fields = fields_of(self._schemas[schema])
            except (KeyError, TypeError, ValueError, IndexError):
                self._remarks.append(f"The schema of {topic} cannot be read; it is left out.")
                return
            self._channels[number] = self._same(_Channel(topic, about["kind"], about["direction"], fields))

    def _same(self, new: _Channel) -> _Channel:
        """The channel of the same port in an earlier part; or else this one."""
        known = self._found.setdefault(new.path, [])
        for old in known:
            if (old.kind, old.direction, old.fields) == (new.kind, new.direction, new.fields):
                return old
        known.append(new)
        return new

    def _unpack(self, chunk: Any) -> None:
        """The messages of a chunk. Not by the library, which makes an object of each record: it would take most of the time."""
        import zstandard

        size = max(chunk.uncompressed_size, len(chunk.data))
        if chunk.compression == "zstd":
            size = max(size, zstandard.frame_content_size(chunk.data))
        if size > MOST_CHUNK_BYTES:
            raise ValueError(f"a chunk of {size} bytes, at most {MOST_CHUNK_BYTES}: uwserver did not write it")
        data = chunk.data
        if chunk.compression:
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=MOST_CHUNK_BYTES)
        place = 0
        while place + 9 <= len(data):
            code, length = data[place], int.from_bytes(data[place + 1 : place + 9], "little")
            body = data[place + 9 : place + 9 + length]
            if len(body) != length:
                raise ValueError("a record goes beyond its chunk")
            place += 9 + length
            if code == _MESSAGE:
                self._message(body)
            elif code in (_CHANNEL, _SCHEMA):
                self._declared(code, body)

    def _declared(self, code: int, body: bytes) -> None:
        from io import BytesIO

        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(BytesIO(body))
        if code == _SCHEMA:
            schema = Schema.read(stream)
            self._schema(schema.id, schema.data)
        else:
            channel = Channel.read(stream)
            self._channel(channel.id, channel.topic, channel.schema_id, channel.metadata)

    def _message(self, body: bytes) -> None:
        number, _, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(body)
        channel, data = self._channels.get(number), body[_MESSAGE_HEAD.size :]
        try:
            if channel is not None:
                channel.add(msgspec.json.decode(data), publish_ns)
            elif number in self._own:
                self._own_message(self._own[number], data)
        except (msgspec.MsgspecError, KeyError, TypeError, ValueError, AttributeError, OverflowError):
            path = channel.path if channel is not None else self._own[number]
            self._bad[path] = self._bad.get(path, 0) + 1
            return
        self._end_ns = max(self._end_ns, min(log_ns, _LATEST_NS))

    def _own_message(self, topic: str, data: bytes) -> None:
        if topic == CASTS:
            cast = msgspec.json.decode(data, type=CastRecord).cast
            self._casts[cast.revision] = cast
        elif topic == STATES:
            state = read_state(data, self._casts).state
            if not 0 <= state.t_ns <= _LATEST_NS:
                raise ValueError("a time that no world lives to see")
            for body, pose in zip((*state.cast.vehicles, *state.cast.objects), state.poses.tolist(), strict=True):
                self._poses.setdefault(body.name, array("d")).extend((state.t_ns / NANOSECONDS, *pose))
        elif len(self._events) < MOST_EVENTS:
            self._events.append(msgspec.json.decode(data, type=Event))
        else:
            self._more_events += 1


_LATEST_NS = 10**9 * NANOSECONDS
"""A world lives no longer; what says more is damaged."""


def _in_order(series: Series) -> Series:
    """By time: after a reset it begins anew, and what was before is drawn below what came after."""
    if np.all(np.diff(series.t) >= 0.0):
        return series
    order = np.argsort(series.t, kind="stable")
    columns = {name: column[order] for name, column in series.columns.items()}
    return Series(
        series.path, series.kind, series.direction, series.fields, series.t[order], series.seq[order], series.valid[order], columns
    )  # fmt: skip
