"""Reads a recording into columns of numbers, for a report. It reads each part once, and can read a file that has no end.

Echoes of sonars, also those in pictures, become one row per ping.
"""

from __future__ import annotations

import contextlib
import math
import re
from abc import ABC, abstractmethod
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.exceptions import InvalidMagic
from mcap.records import Channel, Chunk, DataEnd, Metadata, Schema
from mcap.stream_reader import StreamReader

from uwserver.adapter.pictures import amplitudes
from uwserver.logfiles.readers.mcap_records import CHANNEL, MESSAGE, MESSAGE_HEAD, SCHEMA, learn, records_in
from uwserver.ports import Buffer, EntityList, Event, Field
from uwserver.recording.channels import message_of
from uwserver.recording.format import EVENTS, METADATA
from uwserver.recording.parts import SERVED
from uwserver.recording.reading import (
    DAMAGE,
    MOST_CHUNK_BYTES,
    MOST_RECORD_BYTES,
    NotReplayable,
    check_chunk_size,
    parts_of,
)
from uwserver.recording.states import ENTITY_LISTS, STATES, EntityListRecord, read_state
from uwserver.scenario.files.documents import opened
from uwserver.units import NANOSECONDS

FloatArray = npt.NDArray[np.float64]

ACROSS = 256
"""Numbers that are kept of a row of echoes, each the largest of its neighbours. A plot of pings over time has fewer pixels."""
_ECHOES: Mapping[str, Mapping[str, int]] = {
    "SonarImage": {"image": 2},
    "SonarPing": {"bins": 1},
    "SideScan": {"port": 1, "starboard": 1},
}
"""Number of dimensions of the fields that contain echoes over range, by the standard message of the sonar."""

IntArray = npt.NDArray[np.int64]
MOST_EVENTS = 20_000
"""Largest number of events in a report."""
_LATEST_NS = 10**9 * NANOSECONDS
"""32 years; a message with a later time is damaged."""
_TYPES = {"number": "float", "integer": "int", "boolean": "bool", "string": "str", "object": "bytes"}


class Column(ABC):
    """The numbers of one field, `size` of them per message."""

    def __init__(self, size: int) -> None:
        self.size, self.numbers = size, array("d")

    @abstractmethod
    def add(self, value: Any) -> None:
        """Add the value of a message. Raises ValueError or TypeError, and adds nothing, when it does not fit."""

    def whole(self, count: int) -> FloatArray:
        """Return the numbers (count, size) of the first messages."""
        return np.frombuffer(self.numbers, dtype=np.float64)[: count * self.size].reshape(count, self.size)


class Numbers(Column):
    """The column of a field of numbers."""

    def add(self, value: Any) -> None:
        if value is None:
            self.numbers.extend([math.nan] * self.size)
        elif self.size == 1 and not isinstance(value, list):
            self.numbers.append(value)
        elif isinstance(value, list) and len(value) == self.size:
            try:
                self.numbers.extend(value)
            except TypeError:
                del self.numbers[len(self.numbers) // self.size * self.size :]
                self.numbers.extend([math.nan if v is None else v for v in value])
        else:
            raise ValueError(f"{value!r} instead of {self.size} numbers")


class Echoes(Column):
    """The column of a buffer of echoes over range: their amplitudes; of a picture those of the strongest beam at each range."""

    def __init__(self, dimensions: int) -> None:
        super().__init__(ACROSS)
        self._dimensions = dimensions

    def add(self, value: Any) -> None:
        row: FloatArray = np.full(1, math.nan)
        if value is not None:
            heard = amplitudes(msgspec.convert(value, Buffer), self._dimensions)
            if heard.ndim != self._dimensions or not heard.size:
                raise ValueError(f"echoes of shape {list(heard.shape)}")
            row = heard.max(axis=1).astype(np.float64) if heard.ndim == 2 else heard.astype(np.float64)
        self.numbers.extend(np.maximum.reduceat(row, np.arange(ACROSS) * len(row) // ACROSS))


def columns_of(message: str, fields: Mapping[str, Field]) -> Iterator[tuple[str, Column]]:
    """Yield names and empty columns of the fields of a port that fits this message. Texts and other buffers have no column."""
    echoes = _ECHOES.get(message, {})
    for name, described in fields.items():
        if described.type not in ("str", "bytes", "buffer"):
            yield name, Numbers(described.size)
        elif name in echoes and described.type != "str":
            yield name, Echoes(echoes[name])


@dataclass(frozen=True)
class Series:
    """The samples or commands of one port.

    Attributes:
        path: path of the port; the part before the first "/" is its vehicle.
        kind: kind of the component.
        message: standard message that the fields of a sensor fit; "" for none.
        direction: "sensor" or "actuator".
        fields: by name; texts, and pictures except those of sonars, have no columns.
        t: (n) simulation time, s, of the measurement; of a command, when it acted.
        seq: (n) sequence numbers of samples, 0 for commands.
        valid: (n) whether the sample is valid.
        columns: (n, size) for each field, NaN where there is no value.
    """

    path: str
    kind: str
    message: str
    direction: str
    fields: dict[str, Field]
    t: FloatArray
    seq: IntArray
    valid: npt.NDArray[np.bool_]
    columns: dict[str, FloatArray]

    @property
    def vehicle(self) -> str:
        """Return the first level of the path."""
        return self.path.partition("/")[0]


@dataclass(frozen=True)
class Recorded:
    """A recording.

    Attributes:
        path: the file, or the first of several.
        head: the metadata record, as texts.
        scenario: the resolved scenario as plain tables: name, scenario, vehicles, materials.
        series: by path, for each port with data.
        poses: (n, 8) for each body: t (s), p_NB (m), q_NB (w x y z), from the states; empty for old recordings.
        events: the events that all clients received.
        end_s: simulation time of the last entry, s.
        remarks: what is missing or doubtful, one sentence each.
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
    """Read a recording of ours with all its parts. Any version of the physics can be read.

    Raises:
        OSError: a file cannot be read.
        ValueError: it is not a recording of ours, or a part is missing; the text names it and says why.
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
    """Return the fields of a port, by name, as far as the JSON schema of its channel describes them."""
    found: dict[str, Field] = {}
    for name, node in schema["properties"]["value"]["properties"].items():
        text = node["description"]
        unit, frame = re.search(r"; unit ([^;]*)", text), re.search(r"; frame (\w+)", text)
        shape = (int(node["maxItems"]),) if "items" in node else ()
        type_: Any = _TYPES[node.get("items", node)["type"][0]]
        found[name] = Field(name, unit[1] if unit else "1", text, frame[1] if frame else "", shape, type_)
    return found


@dataclass
class _PortData:
    """The data of a port while the recording is read."""

    path: str
    kind: str
    message: str
    direction: str
    fields: dict[str, Field]
    t: array[int] = field(default_factory=lambda: array("q"))
    seq: array[int] = field(default_factory=lambda: array("q"))
    valid: bytearray = field(default_factory=bytearray)
    columns: dict[str, Column] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = dict(columns_of(self.message, self.fields))

    def add(self, message: dict[str, Any], publish_ns: int) -> None:
        t_ns, seq = int(message.get("t_ns", publish_ns)), int(message.get("seq", 0))
        if not 0 <= t_ns <= _LATEST_NS:
            raise ValueError("the time is out of range")
        value, whole = message["value"], len(self.t)
        try:
            for name, column in self.columns.items():
                column.add(value.get(name))
        except BaseException:  # all columns must stay equally long
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
            self.message,
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
        self._found: dict[str, list[_PortData]] = {}
        self._head: dict[str, str] | None = None
        self._schemas: dict[int, dict[str, Any]] = {}
        self._channels: dict[int, _PortData | None] = {}
        self._events: list[Event] = []
        self._own: dict[int, str] = {}
        self._entity_lists: dict[int, EntityList] = {}
        self._poses: dict[str, array[float]] = {}
        self._bad: Counter[str] = Counter()
        self._more_events = 0
        self._end_ns = 0
        self._remarks: list[str] = []

    def read(self, path: Path, file: IO[bytes]) -> None:
        """Read one file to its end, or to where it breaks off. Numbers of schemas and channels are valid within a file."""
        self._schemas, self._channels, self._own = {}, {}, {}
        name = "file" if path == self._path else f"part {path.name}"
        ended = False
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=MOST_RECORD_BYTES).records:
                if isinstance(record, Metadata) and record.name == METADATA and self._head is None:
                    self._head = record.metadata
                elif isinstance(record, Schema):
                    self._schema(record)
                elif isinstance(record, Channel):
                    self._channel(record)
                elif isinstance(record, Chunk):
                    if self._head is None:
                        break
                    self._unpack(record)
                elif isinstance(record, DataEnd):
                    ended = True
                    break
        except (*DAMAGE, MemoryError, EOFError) as error:
            if self._head is None:
                # That of a wrong beginning shows its bytes, which say nothing to people.
                reason = f": {error}" if str(error) and not isinstance(error, InvalidMagic) else ""
                text = f"{path}: not written by `uwserver run --record FILE`, or damaged at its start{reason}"
                raise ValueError(text) from error
            rest = "damaged" if file.read(1) else "cut off"
            self._remarks.append(f"The {name} is {rest} at byte {file.tell()}; the report ends there.")
            ended = True
        if self._head is None:
            raise ValueError(f"{path}: an MCAP file, but not written by `uwserver run --record FILE`")
        if not ended:
            self._remarks.append("The recording has no end: its server was killed, or it is still being written.")

    def recorded(self) -> Recorded:
        """Return everything that was read."""
        assert self._head is not None
        try:
            if SERVED in self._head:  # the process that wrote it did not have the scenario
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
                f"The world was reset {resets} times: data of equal times are drawn on top of one another."
            )
        # A path that was used for several kinds of ports has several entries; the longest is shown.
        longest = {path: max(entries, key=lambda data: len(data.t)) for path, entries in self._found.items()}
        found = {path: _in_order(data.series()) for path, data in longest.items() if len(data.t)}
        events = tuple(self._events)
        poses = {name: np.frombuffer(rows, dtype=np.float64).reshape(-1, 8) for name, rows in self._poses.items()}
        end_s = self._end_ns / NANOSECONDS
        return Recorded(self._path, self._head, scenario, found, poses, events, end_s, tuple(self._remarks))

    def _schema(self, schema: Schema) -> None:
        with contextlib.suppress(msgspec.MsgspecError):  # Foxglove's schemas have another encoding
            self._schemas[schema.id] = msgspec.json.decode(schema.data, type=dict[str, Any])

    def _channel(self, channel: Channel) -> None:
        number, topic, about = channel.id, channel.topic, channel.metadata
        if number in self._channels:
            return
        self._channels[number] = None
        if topic in (EVENTS, STATES, ENTITY_LISTS):
            self._own[number] = topic
        elif "kind" in about and "direction" in about and channel.schema_id in self._schemas:
            try:
                fields = fields_of(self._schemas[channel.schema_id])
            except (KeyError, TypeError, ValueError, IndexError):
                self._remarks.append(f"The schema of {topic} cannot be read; it is left out.")
                return
            data = _PortData(topic, about["kind"], message_of(about), about["direction"], fields)
            self._channels[number] = self._same(data)

    def _same(self, new: _PortData) -> _PortData:
        """Return the data of the same port in an earlier part; if there are none, the new data."""
        known = self._found.setdefault(new.path, [])
        for old in known:
            if (old.kind, old.direction, old.fields) == (new.kind, new.direction, new.fields):
                return old
        known.append(new)
        return new

    def _unpack(self, chunk: Chunk) -> None:
        """Read the records of a chunk. The library would make an object of each message, which would take most of the time."""
        check_chunk_size(chunk)
        data = chunk.data
        if chunk.compression:
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=MOST_CHUNK_BYTES)
        done = 0
        for code, begin, done in records_in(data):
            if code == MESSAGE:
                self._message(data[begin:done])
            elif code in (CHANNEL, SCHEMA):
                schemas: dict[int, Schema] = {}
                channels: dict[int, Channel] = {}
                learn(code, data, begin, done, schemas, channels)
                for schema in schemas.values():
                    self._schema(schema)
                for channel in channels.values():
                    self._channel(channel)
        if done < len(data):
            raise ValueError("a record goes beyond its chunk")

    def _message(self, body: bytes) -> None:
        number, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(body)
        port, data = self._channels.get(number), body[MESSAGE_HEAD.size :]
        try:
            if port is not None:
                port.add(msgspec.json.decode(data), publish_ns)
            elif number in self._own:
                self._own_message(self._own[number], data)
        except (msgspec.MsgspecError, KeyError, TypeError, ValueError, AttributeError, OverflowError):
            self._bad[port.path if port is not None else self._own[number]] += 1
            return
        self._end_ns = max(self._end_ns, min(log_ns, _LATEST_NS))

    def _own_message(self, topic: str, data: bytes) -> None:
        if topic == ENTITY_LISTS:
            entities = msgspec.json.decode(data, type=EntityListRecord).entities
            self._entity_lists[entities.revision] = entities
        elif topic == STATES:
            state = read_state(data, self._entity_lists).state
            if not 0 <= state.t_ns <= _LATEST_NS:
                raise ValueError("the time is out of range")
            for body, pose in zip(
                (*state.entities.vehicles, *state.entities.objects), state.poses.tolist(), strict=True
            ):
                self._poses.setdefault(body.name, array("d")).extend((state.t_ns / NANOSECONDS, *pose))
        elif len(self._events) < MOST_EVENTS:
            self._events.append(msgspec.json.decode(data, type=Event))
        else:
            self._more_events += 1


def _in_order(series: Series) -> Series:
    """Return a series sorted by time. After a reset the times begin again; of equal times, those before the reset come first."""
    if np.all(np.diff(series.t) >= 0.0):
        return series
    order = np.argsort(series.t, kind="stable")
    columns = {name: column[order] for name, column in series.columns.items()}
    return replace(series, t=series.t[order], seq=series.seq[order], valid=series.valid[order], columns=columns)
