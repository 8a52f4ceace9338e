"""Writes a recording's MCAP file: the format is told in `uwserver.recording.format`."""

from __future__ import annotations

import keyword
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import IO, Any

import msgspec
from msgspec import structs

from uwserver import __version__
from uwserver.adapter.foxglove import SCHEMAS, Foreign
from uwserver.ports import Event, Port, Sample, SceneState
from uwserver.ports.told import Origin, Told
from uwserver.recording.chunked_file import ChunkedFile
from uwserver.recording.format import EVENTS, HASHES, METADATA, REQUESTS, Request, StateHash
from uwserver.recording.foxglove import FoxgloveChannels
from uwserver.recording.parts import STATE
from uwserver.recording.schemas import port_schema, schema_of
from uwserver.recording.states import CASTS, ENCODING, JUMPS, LAYOUT, STATES, Presence, Seen, state_message

MAX_CHANNELS = 65_535
"""Of an MCAP file, which has 16 bits for their numbers."""
TOGETHER = 512
"""Samples that are encoded in one go."""
_PLAIN = frozenset(("float", "int", "bool"))
CHUNK_BYTES = 256 * 1024
"""A chunk is written at the latest when it has grown to this."""


class TooManyChannels(Exception):
    """A recording has no number left for the channel of a port; the text says so."""


@dataclass(slots=True)
class _Kind:
    """A port of one direction and these fields, and its channel: 0 before its first message."""

    port: Port
    channel: int = 0


class _Message(msgspec.Struct, frozen=True, gc=False):
    """A sample as JSON has it; `value` is a struct of the fields of its port, which is encoded sooner than a dictionary."""

    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: Any


_Row = tuple[int, int, Callable[..., msgspec.Struct]]
"""How samples of a stream are encoded: channel of its port, number of its fields, and what makes the value of a message of theirs."""


class RecordingWriter:
    """Turns what happened into records of an open file. Used by one thread at a time.

    Args:
        file: an empty binary file, opened for writing.
        head: the metadata record.
        foxglove: makes what is written for other viewers; None for nothing.
        ports: what is known at the start; a later one gets its channel with its first message, and a name that goes to another kind a new one.

    Every method raises OSError when the file cannot be written, and TooManyChannels when a port finds no number for its channel.
    """

    def __init__(
        self, file: IO[bytes], head: dict[str, str], ports: Mapping[str, Port], foxglove: FoxgloveChannels | None = None
    ) -> None:
        encoder = msgspec.json.Encoder()
        self._encode, self._encode_lines = encoder.encode, encoder.encode_lines
        self._of_name: dict[str, list[_Kind]] = {}
        self._count = 1  # the states
        self._writer = ChunkedFile(file, f"uwserver {__version__}", CHUNK_BYTES)
        self._writer.add_metadata(METADATA, head)
        self._events = self._channel(EVENTS, "uwserver.Event", schema_of(Event))
        self._hashes = self._channel(HASHES, "uwserver.StateHash", schema_of(StateHash))
        self._requests = self._channel(REQUESTS, "uwserver.Request", schema_of(Request))
        self._jumps = self._channel(JUMPS, "uwserver.Event", schema_of(Event))
        self._casts = self._channel(CASTS, "uwserver.CastRecord", {"title": CASTS, "type": "object"})
        layout = self._writer.register_schema("uwserver.State", "text", LAYOUT.encode())
        self._states = self._writer.register_channel(STATES, ENCODING, layout, {})
        self._row_of: dict[int, _Row | None] = {}
        self._origins: Mapping[int, Origin] = {}
        self.told: Presence | None = None
        self.jumps_told = 0
        self._foxglove = foxglove
        self._foreign: dict[tuple[str, str], int] = {}
        self._foreign_schemas: dict[str, int] = {}
        for port in ports.values():
            self._number(self._kinds(port)[-1])
        self.flush()

    def sample(self, sample: Sample, ports: Mapping[str, Port]) -> None:
        """One sample on the channel of its port."""
        kinds = self._kinds(ports[sample.port])
        # One that comes late, when another kind has its name already, is of an earlier one.
        fits = [k for k in kinds if k.port.direction == "sensor" and len(k.port.fields) == len(sample.value)]
        kind = fits[-1] if fits else kinds[-1]
        message = {
            "seq": sample.seq,
            "t_ns": sample.t_ns,
            "t_sent_ns": sample.t_sent_ns,
            "valid": sample.valid,
            "value": dict(zip([field.name for field in kind.port.fields], sample.value, strict=True)),
        }
        # MCAP has 32 bits for the sequence; the message itself holds the whole number.
        self._add(self._number(kind), sample.t_sent_ns, message, sample.t_ns, sample.seq & 0xFFFFFFFF)
        if self._foxglove is not None:
            shown = self._foxglove.of_sample(sample, ports[sample.port])
            if shown is not None:
                self._add_foreign(shown)

    def rows(self, told: Told, ports: Mapping[str, Port]) -> None:
        """Samples as rows, each on the channel of its port: those of numbers alone are encoded in one go."""
        if told.origins is not self._origins:
            self._origins, self._row_of = told.origins, {}
        for part in told.parts(TOGETHER):
            self._encode_rows(part, ports)

    def _encode_rows(self, told: Told, ports: Mapping[str, Port]) -> None:
        entries, rows = told.entries(), self._row_of
        heads: list[tuple[int, int, int, int]] = []
        messages: list[_Message] = []
        for (t_sent_ns, _, stream, seq, t_ns, valid, _), values in zip(entries, told.values(entries), strict=True):
            row = rows[stream] if stream in rows else self._row(stream, ports)
            if row is not None and len(values) == row[1]:
                # MCAP has 32 bits for the sequence; the message itself holds the whole number.
                heads.append((row[0], seq & 0xFFFFFFFF, t_sent_ns, t_ns))
                messages.append(_Message(seq, t_ns, t_sent_ns, valid != 0, row[2](*values)))
            else:
                self._add_rows(heads, messages)
                heads, messages = [], []
                self.sample(Sample(told.origins[stream].path, seq, t_ns, t_sent_ns, valid != 0, values), ports)
        self._add_rows(heads, messages)

    def _add_rows(self, heads: list[tuple[int, int, int, int]], messages: list[_Message]) -> None:
        if heads:
            # A text holds no line's end as it is: JSON writes it in another way.
            self._writer.add_messages(heads, self._encode_lines(messages).split(b"\n"))

    def _row(self, stream: int, ports: Mapping[str, Port]) -> _Row | None:
        """How a stream's samples are encoded in one go; None for one by one: pictures would be too much at once, and of some others see them, too."""
        port = ports[self._origins[stream].path]
        kind = self._kinds(port)[-1]
        names = [field.name for field in port.fields]
        is_plain = all(field.type in _PLAIN for field in port.fields) and all(map(_is_name, names))
        is_shown = self._foxglove is not None and self._foxglove.shows(port)
        row = None
        if port.direction == "sensor" and is_plain and not is_shown:
            value = msgspec.defstruct(f"Value_{len(names)}", [(name, Any) for name in names])
            row = (self._number(kind), len(names), value)
        self._row_of[stream] = row
        return row

    def request(self, request: Request, t_ns: int, ports: Mapping[str, Port]) -> None:
        """One request, carried out at t_ns; a command also on the channel of its port, to be plotted."""
        self._add(self._requests, t_ns, request, t_ns, request.index & 0xFFFFFFFF)
        # One that was sent to another kind of the same name is in the requests alone.
        if request.port in ports and len(request.value) == len(ports[request.port].fields):
            port = ports[request.port]
            channel = self._number(self._kinds(port)[-1])
            # Of a command one number alone is a tuple too; on the channel it is what the schema says.
            value = {
                field.name: given[0] if isinstance(given, tuple) and not field.shape else given
                for field, given in zip(port.fields, request.value, strict=True)
            }
            message = {"tick": request.tick, "source": request.source, "value": value}
            self._add(channel, t_ns, message, t_ns, request.index & 0xFFFFFFFF)

    def hash(self, entry: StateHash, t_ns: int) -> None:
        """One state hash, taken at t_ns."""
        self._add(self._hashes, t_ns, entry, t_ns, entry.index & 0xFFFFFFFF)

    def event(self, event: Event) -> None:
        """One event."""
        self._add(self._events, event.t_ns, event, event.t_ns)
        if event.event == "reset":
            self.jumps_told += 1
            self._add(self._jumps, event.t_ns, event, event.t_ns)
        self._show(event)

    def presence(self, presence: Presence) -> None:
        """Who and what is there from here on."""
        record = presence.since(self.told)
        water = presence.water or (None if self.told is None else self.told.water)
        self.told = structs.replace(presence, water=water)
        self._add(self._casts, presence.t_ns, record, presence.t_ns)
        self._show(presence)

    def state(self, seen: Seen) -> None:
        """Where all bodies are; of a cast that was told by `presence`."""
        t_ns = seen.state.t_ns
        self._writer.add_message((self._states, 0, t_ns, t_ns), state_message(seen))
        self._show(seen.state)

    def _show(self, item: Presence | SceneState | Event) -> None:
        """Let other viewers see it, too."""
        if self._foxglove is not None:
            for message in self._foxglove.of(item):
                self._add_foreign(message)

    def _add_foreign(self, message: Foreign) -> None:
        """A message in Foxglove's schemas, on the channel of its topic."""
        key = (message.topic, message.schema)
        channel = self._foreign.get(key)
        if channel is None:
            if message.schema not in self._foreign_schemas:
                data = SCHEMAS[message.schema]
                self._foreign_schemas[message.schema] = self._writer.register_schema(message.schema, "protobuf", data)
            number = self._foreign_schemas[message.schema]
            channel = self._foreign[key] = self._numbered(message.topic, "protobuf", number, {})
        self._writer.add_message((channel, 0, message.t_ns, message.t_ns), message.data)

    def begin_at(self, state: bytes) -> None:
        """Say, before any message, with which state of the world a later part begins."""
        self._writer.add_attachment(STATE, "application/msgpack", state)

    def follow(self, before: RecordingWriter, tick: int, t_ns: int) -> None:
        """Go on where another writer ends, so that this file can be read alone: with its ports, whose late samples may still come, and with all who
        are there. The jumps of the states that follow count on from those that it told."""
        self.know(before.known)
        self.jumps_told = before.jumps_told
        if before.told is not None:
            self.presence(structs.replace(before.told, jumps=before.jumps_told, tick=tick, t_ns=t_ns))

    def flush(self) -> None:
        """End the chunk in progress and hand everything to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write index and statistics; nothing may follow."""
        self._writer.finish()

    def _add(self, channel: int, log_time: int, message: object, publish_time: int, sequence: int = 0) -> None:
        self._writer.add_message((channel, sequence, log_time, publish_time), self._encode(message))

    def know(self, ports: Iterable[Port]) -> None:
        """Ports as they are from here on; samples of those before may still come."""
        self._row_of = {}
        for port in ports:
            self._kinds(port)

    @property
    def known(self) -> list[Port]:
        """All that have had a name, the present one last: for the writer of the next part."""
        return [kind.port for kinds in self._of_name.values() for kind in kinds]

    def _kinds(self, port: Port) -> list[_Kind]:
        """All that had this name; the present one is the last."""
        kinds = self._of_name.setdefault(port.path, [])
        if not kinds or kinds[-1].port is not port:
            same = [k for k in kinds if (k.port.direction, k.port.fields) == (port.direction, port.fields)]
            kind = same[0] if same else _Kind(port)
            kind.port = port  # with another rate, perhaps
            kinds[:] = [*(each for each in kinds if each is not kind), kind]
        return kinds

    def _number(self, kind: _Kind) -> int:
        if not kind.channel:
            port = kind.port
            about = {"kind": port.kind, "direction": port.direction, "doc": port.doc}
            kind.channel = self._channel(port.path, port.path, port_schema(port), about)
        return kind.channel

    def _channel(self, topic: str, name: str, schema: dict[str, Any], about: dict[str, str] | None = None) -> int:
        return self._numbered(
            topic, "json", self._writer.register_schema(name, "jsonschema", self._encode(schema)), about or {}
        )

    def _numbered(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        if self._count >= MAX_CHANNELS:
            text = f"{self._count} ports of bodies that came and went have their channels, and MCAP knows no more"
            raise TooManyChannels(f"{text}: give bodies names that were used before")
        self._count += 1
        return self._writer.register_channel(topic, encoding, schema, about)


def _is_name(text: str) -> bool:
    """Whether a field can be one of a struct."""
    return text.isidentifier() and not keyword.iskeyword(text) and not text.startswith("__")
