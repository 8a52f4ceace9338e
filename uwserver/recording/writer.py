"""Writes the MCAP file of a recording, in the format that `uwserver.recording.format` describes.

`FoxgloveChannels` makes additional channels that Foxglove, Lichtblick and rerun show without set-up. A replay ignores them.
"""

from __future__ import annotations

import keyword
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import IO, Any

import msgspec
from msgspec import structs

from uwserver.adapter.foxglove import SCHEMAS, Foreign, SceneChannels
from uwserver.ports import Event, Port, Sample, SceneState, WaterView
from uwserver.ports.sample_batch import Origin, SampleBatch
from uwserver.recording.channels import port_schema, schema_of
from uwserver.recording.chunked_file import ChunkedFile
from uwserver.recording.format import EVENTS, HASHES, METADATA, REQUESTS, Request, StateHash
from uwserver.recording.parts import STATE
from uwserver.recording.states import ENCODING, ENTITY_LISTS, JUMPS, LAYOUT, STATES, Presence, Seen, state_message
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import Scenery
from uwserver.version import __version__
from uwserver.world.world import World

log = logging.getLogger(__name__)

MAX_CHANNELS = 65_535
"""Largest number of channels; MCAP has 16 bits for their numbers."""
TOGETHER = 512
"""Number of samples that are encoded in one go."""
_SEQUENCE = 0xFFFFFFFF
"""MCAP has 32 bits for the sequence number; the message itself contains the whole number."""
_PLAIN = frozenset(("float", "int", "bool"))
CHUNK_BYTES = 256 * 1024
"""A chunk is written as soon as it reaches this size."""


class FoxgloveChannels:
    """Makes the messages for other viewers. It runs on the recorder's thread, and reads only what is constant in the world.

    An internal fault ends these channels, but not the recording.

    Args:
        world: as built.
        resolved: the scenario from which it was built.
    """

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._water: WaterView | None = None
        self._scenery = Scenery(resolved, world, self._newest_water)
        self._channels = SceneChannels(self._scenery.meshes.data.__getitem__, self._scenery.model_files.__getitem__)
        self._ended = False

    def of(self, item: Presence | SceneState | Event | Sample, port: Port | None = None) -> Iterator[Foreign]:
        """Yield the messages for the entities of the world, their poses, an event, or a sample of this port. Most ports have none."""
        if self._ended:
            return
        try:
            if isinstance(item, Sample):
                if port is not None and (shown := self._channels.sample(port, item)) is not None:
                    yield shown
            elif isinstance(item, Presence):
                self._water = item.water or self._water
                yield self._channels.scene(self._scenery.scene(item.entities), item.t_ns)
            elif isinstance(item, SceneState):
                yield from self._channels.state(item)
            else:
                yield self._channels.event(item)
        except Exception:  # channels that only other viewers need must not end the recording
            self._ended = True
            log.exception("an internal fault ended the channels for Foxglove; the recording itself continues")

    def shows(self, port: Port) -> bool:
        """Return whether samples of a port may have messages."""
        return not self._ended and self._channels.shows(port)

    def _newest_water(self) -> WaterView:
        assert self._water is not None, "the first presence contains the water"
        return self._water


class TooManyChannels(Exception):
    """A recording has no channel number left for a port; the text says so."""


@dataclass(slots=True)
class _Kind:
    """A port with its direction and fields, and the number of its channel: 0 before its first message."""

    port: Port
    channel: int = 0


class _SampleRecord(msgspec.Struct, frozen=True, gc=False):
    """A sample as it is written in JSON; `value` is a struct of the port's fields, which is encoded faster than a dictionary."""

    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: Any


_Row = tuple[int, int, Callable[..., msgspec.Struct]]
"""How samples of a stream are encoded: channel of the port, number of its fields, and the class of the message's value."""


class RecordingWriter:
    """Writes samples, requests, events and states as records of an open file. Only one thread may use it at a time.

    Args:
        file: an empty binary file, opened for writing.
        head: the metadata record.
        foxglove: makes the messages for other viewers; None for no such messages.
        ports: the ports at the start. A later port gets a channel with its first message; a port path that is used again for other fields gets a new
            channel.

    Every method raises OSError when the file cannot be written, and TooManyChannels when no channel number is left.
    """

    def __init__(
        self, file: IO[bytes], head: dict[str, str], ports: Mapping[str, Port], foxglove: FoxgloveChannels | None = None
    ) -> None:
        encoder = msgspec.json.Encoder()
        self._encode, self._encode_lines = encoder.encode, encoder.encode_lines
        self._of_name: dict[str, list[_Kind]] = {}
        self._count = 1  # the channel of states, which is registered directly
        self._writer = ChunkedFile(file, f"uwserver {__version__}", CHUNK_BYTES)
        self._writer.add_metadata(METADATA, head)
        self._events = self._channel(EVENTS, "uwserver.Event", schema_of(Event))
        self._hashes = self._channel(HASHES, "uwserver.StateHash", schema_of(StateHash))
        self._requests = self._channel(REQUESTS, "uwserver.Request", schema_of(Request))
        self._jumps = self._channel(JUMPS, "uwserver.Event", schema_of(Event))
        self._entity_lists = self._channel(
            ENTITY_LISTS, "uwserver.CastRecord", {"title": ENTITY_LISTS, "type": "object"}
        )
        layout = self._writer.register_schema("uwserver.State", "text", LAYOUT.encode())
        self._states = self._writer.register_channel(STATES, ENCODING, layout, {})
        self._row_of: dict[int, _Row | None] = {}
        self._origins: Mapping[int, Origin] = {}
        self.last_presence: Presence | None = None
        self.last_jumps = 0
        self._foxglove = foxglove
        self._foreign: dict[tuple[str, str], int] = {}
        self._foreign_schemas: dict[str, int] = {}
        for port in ports.values():
            self._number(self._kinds(port)[-1])
        self.flush()

    def sample(self, sample: Sample, ports: Mapping[str, Port]) -> None:
        """Write a sample on the channel of its port."""
        kinds = self._kinds(ports[sample.port])
        # A late sample may belong to an earlier port of this path, if another port has taken the path meanwhile.
        fits = [k for k in kinds if k.port.direction == "sensor" and len(k.port.fields) == len(sample.value)]
        kind = fits[-1] if fits else kinds[-1]
        message = {
            "seq": sample.seq,
            "t_ns": sample.t_ns,
            "t_sent_ns": sample.t_sent_ns,
            "valid": sample.valid,
            "value": dict(zip([field.name for field in kind.port.fields], sample.value, strict=True)),
        }
        self._add(self._number(kind), sample.t_sent_ns, message, sample.t_ns, sample.seq)
        self._show(sample, ports[sample.port])

    def rows(self, batch: SampleBatch, ports: Mapping[str, Port]) -> None:
        """Write samples that come as rows, each on the channel of its port. Samples that contain only numbers are encoded in one go."""
        if batch.origins is not self._origins:
            self._origins, self._row_of = batch.origins, {}
        for part in batch.parts(TOGETHER):
            self._encode_rows(part, ports)

    def _encode_rows(self, batch: SampleBatch, ports: Mapping[str, Port]) -> None:
        entries, rows = batch.entries(), self._row_of
        heads: list[tuple[int, int, int, int]] = []
        messages: list[_SampleRecord] = []
        for (t_sent_ns, _, stream, seq, t_ns, valid, _), values in zip(entries, batch.values(entries), strict=True):
            row = rows[stream] if stream in rows else self._row(stream, ports)
            if row is not None and len(values) == row[1]:
                heads.append((row[0], seq & _SEQUENCE, t_sent_ns, t_ns))
                messages.append(_SampleRecord(seq, t_ns, t_sent_ns, valid != 0, row[2](*values)))
            else:
                self._add_rows(heads, messages)
                heads, messages = [], []
                self.sample(Sample(batch.origins[stream].path, seq, t_ns, t_sent_ns, valid != 0, values), ports)
        self._add_rows(heads, messages)

    def _add_rows(self, heads: list[tuple[int, int, int, int]], messages: list[_SampleRecord]) -> None:
        if heads:
            # Messages can be split at line feeds, because JSON escapes those in texts.
            self._writer.add_messages(heads, self._encode_lines(messages).split(b"\n"))

    def _row(self, stream: int, ports: Mapping[str, Port]) -> _Row | None:
        """Return how the samples of a stream are encoded in one go.

        None means that they are written one by one: pictures, which are too large to be encoded together, and samples that other viewers see too.
        """
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
        """Write a request that was carried out at t_ns; a command also on the channel of its port, for plots."""
        self._add(self._requests, t_ns, request, t_ns, request.index)
        # A command to an earlier port with other fields is written as a request only.
        port = ports.get(request.port)
        if port is not None and len(request.value) == len(port.fields):
            # In a command a single number is a tuple too; on the channel it is a number, as the schema says.
            value = {
                field.name: given[0] if isinstance(given, tuple) and not field.shape else given
                for field, given in zip(port.fields, request.value, strict=True)
            }
            message = {"tick": request.tick, "source": request.source, "value": value}
            self._add(self._number(self._kinds(port)[-1]), t_ns, message, t_ns, request.index)

    def hash(self, entry: StateHash, t_ns: int) -> None:
        """Write a state hash that was taken at t_ns."""
        self._add(self._hashes, t_ns, entry, t_ns, entry.index)

    def event(self, event: Event) -> None:
        """Write an event."""
        self._add(self._events, event.t_ns, event, event.t_ns)
        if event.event == "reset":
            self.last_jumps += 1
            self._add(self._jumps, event.t_ns, event, event.t_ns)
        self._show(event)

    def presence(self, presence: Presence) -> None:
        """Write the bodies, ports and services from here on."""
        record = presence.since(self.last_presence)
        water = presence.water or (None if self.last_presence is None else self.last_presence.water)
        self.last_presence = structs.replace(presence, water=water)
        self._add(self._entity_lists, presence.t_ns, record, presence.t_ns)
        self._show(presence)

    def state(self, seen: Seen) -> None:
        """Write the poses of all bodies. `presence` must have written the list of bodies before."""
        t_ns = seen.state.t_ns
        self._writer.add_message((self._states, 0, t_ns, t_ns), state_message(seen))
        self._show(seen.state)

    def _show(self, item: Presence | SceneState | Event | Sample, port: Port | None = None) -> None:
        """Write an item for other viewers too; with a sample comes its port."""
        if self._foxglove is not None:
            for message in self._foxglove.of(item, port):
                self._add_foreign(message)

    def _add_foreign(self, message: Foreign) -> None:
        """Write a message in one of Foxglove's schemas on the channel of its topic."""
        name, key = message.schema, (message.topic, message.schema)
        if name not in self._foreign_schemas:
            self._foreign_schemas[name] = self._writer.register_schema(name, "protobuf", SCHEMAS[name])
        if key not in self._foreign:
            self._foreign[key] = self._numbered(message.topic, "protobuf", self._foreign_schemas[name], {})
        self._writer.add_message((self._foreign[key], 0, message.t_ns, message.t_ns), message.data)

    def begin_at(self, state: bytes) -> None:
        """Write the state of the world with which a later part begins. Call it before any message is written."""
        self._writer.add_attachment(STATE, "application/msgpack", state)

    def follow(self, before: RecordingWriter, tick: int, t_ns: int) -> None:
        """Continue where another writer ends, so that this file can be read alone.

        It gets the ports of the other writer, whose late samples may still come, the bodies that are there, and the number of jumps.
        """
        self.know(before.known)
        self.last_jumps = before.last_jumps
        if before.last_presence is not None:
            self.presence(structs.replace(before.last_presence, jumps=before.last_jumps, tick=tick, t_ns=t_ns))

    def flush(self) -> None:
        """End the chunk in progress and pass everything to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index and the statistics. Nothing can be written afterwards."""
        self._writer.finish()

    def _add(self, channel: int, log_time: int, message: object, publish_time: int, sequence: int = 0) -> None:
        self._writer.add_message((channel, sequence & _SEQUENCE, log_time, publish_time), self._encode(message))

    def know(self, ports: Iterable[Port]) -> None:
        """Take over the ports from here on. Samples of earlier ports may still come."""
        self._row_of = {}
        for port in ports:
            self._kinds(port)

    @property
    def known(self) -> list[Port]:
        """Return all ports so far, for the writer of the next part; of a path the current one comes last."""
        return [kind.port for kinds in self._of_name.values() for kind in kinds]

    def _kinds(self, port: Port) -> list[_Kind]:
        """Return all ports that have had this path; the current one is the last."""
        kinds = self._of_name.setdefault(port.path, [])
        if not kinds or kinds[-1].port is not port:
            same = [k for k in kinds if (k.port.direction, k.port.fields) == (port.direction, port.fields)]
            kind = same[0] if same else _Kind(port)
            kind.port = port  # it may have another rate
            kinds[:] = [*(each for each in kinds if each is not kind), kind]
        return kinds

    def _number(self, kind: _Kind) -> int:
        if not kind.channel:
            port = kind.port
            about = {"kind": port.kind, "direction": port.direction, "doc": port.doc}
            about |= {"message": port.message} if port.message else {}
            kind.channel = self._channel(port.path, port.path, port_schema(port), about)
        return kind.channel

    def _channel(self, topic: str, name: str, schema: dict[str, Any], about: dict[str, str] | None = None) -> int:
        return self._numbered(
            topic, "json", self._writer.register_schema(name, "jsonschema", self._encode(schema)), about or {}
        )

    def _numbered(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        if self._count >= MAX_CHANNELS:
            text = f"the ports of all bodies so far have {self._count} channels, the most that MCAP allows"
            raise TooManyChannels(f"{text}: reuse the names of removed bodies")
        self._count += 1
        return self._writer.register_channel(topic, encoding, schema, about)


def _is_name(text: str) -> bool:
    """Return whether a struct can have a field of this name."""
    return text.isidentifier() and not keyword.iskeyword(text) and not text.startswith("__")
