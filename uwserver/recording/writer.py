"""Writes a recording's MCAP file: the format is told in `uwserver.recording.format`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import IO, Any

import msgspec
from msgspec import structs

from uwserver import __version__
from uwserver.adapter.foxglove import SCHEMAS, Foreign
from uwserver.ports import Event, Port, Sample, SceneState
from uwserver.recording.format import EVENTS, HASHES, METADATA, REQUESTS, Request, StateHash
from uwserver.recording.foxglove import FoxgloveChannels
from uwserver.recording.parts import STATE
from uwserver.recording.schemas import port_schema, schema_of
from uwserver.recording.states import CASTS, ENCODING, JUMPS, LAYOUT, STATES, Presence, Seen, state_message

MAX_CHANNELS = 65_535
"""Of an MCAP file, which has 16 bits for their numbers."""
CHUNK_BYTES = 256 * 1024
"""A chunk is written at the latest when it has grown to this."""


class TooManyChannels(Exception):
    """A recording has no number left for the channel of a port; the text says so."""


@dataclass(slots=True)
class _Kind:
    """A port of one direction and these fields, and its channel: 0 before its first message."""

    port: Port
    channel: int = 0


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
        # Imported here: it costs more than the rest of the start-up, and most runs record nothing.
        from mcap.writer import Writer

        self._encode = msgspec.json.Encoder().encode
        self._of_name: dict[str, list[_Kind]] = {}
        self._count = 1  # the states
        self._writer: Any = Writer(file, chunk_size=CHUNK_BYTES)  # half of its methods are untyped
        self._writer.start("", f"uwserver {__version__}")
        self._writer.add_metadata(METADATA, head)
        self._events = self._channel(EVENTS, "uwserver.Event", schema_of(Event))
        self._hashes = self._channel(HASHES, "uwserver.StateHash", schema_of(StateHash))
        self._requests = self._channel(REQUESTS, "uwserver.Request", schema_of(Request))
        self._jumps = self._channel(JUMPS, "uwserver.Event", schema_of(Event))
        self._casts = self._channel(CASTS, "uwserver.CastRecord", {"title": CASTS, "type": "object"})
        layout = self._writer.register_schema("uwserver.State", "text", LAYOUT.encode())
        self._states = int(self._writer.register_channel(STATES, ENCODING, layout, {}))
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
        self._writer.add_message(self._states, t_ns, state_message(seen), t_ns)
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
        self._writer.add_message(channel, message.t_ns, message.data, message.t_ns)

    def begin_at(self, state: bytes) -> None:
        """Say, before any message, with which state of the world a later part begins."""
        self._writer.add_attachment(0, 0, STATE, "application/msgpack", state)

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
        self._writer.add_message(channel, log_time, self._encode(message), publish_time, sequence)

    def know(self, ports: Iterable[Port]) -> None:
        """Ports as they are from here on; samples of those before may still come."""
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
        return int(self._writer.register_channel(topic, encoding, schema, about))
