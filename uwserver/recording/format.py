"""The format of a recording: an MCAP file that any MCAP tool can plot, and from which `uwserver.recording.replay` can run the world again.

One channel a port, topic = its path, JSON with a JSON schema that names units and frames; ``log_time`` is `t_sent_ns` (for commands: the
time at which they act), ``publish_time`` `t_ns`, both in simulation time. Besides them channels of our own:

* ``uwserver/requests``: every command and call that was carried out (`Request`);
* ``uwserver/hashes``: the hash of the whole state, each simulated second and at the end (`StateHash`);
* ``uwserver/events``: what every client was told;
* topics that begin with "/", in Foxglove's schemas: see `uwserver.adapter.foxglove`;
* ``uwserver/states``, ``uwserver/casts`` and ``uwserver/jumps``: where all bodies are, who they are, and where time was set, see
  `uwserver.recording.states`.

Requests and hashes share one running index: the order in which they happened, also where a reset makes the tick go back.
The metadata record ``uwserver`` stands first: versions, seed, timing, and the whole resolved scenario.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import IO, Any

import msgspec
from msgspec import Struct

from uwserver import __version__
from uwserver.adapter.foxglove import SCHEMAS, Foreign
from uwserver.physics import PHYSICS
from uwserver.ports import Call, Command, Event, Items, Port, Sample, SceneState
from uwserver.recording.foxglove import FoxgloveChannels
from uwserver.recording.schemas import port_schema, schema_of
from uwserver.recording.states import CASTS, ENCODING, JUMPS, LAYOUT, STATES, Presence, Seen, state_message
from uwserver.scenario.files.convert import NO_MORE, More, convert
from uwserver.scenario.files.errors import KeyPath, dotted
from uwserver.scenario.load.export import engine_named, tables
from uwserver.scenario.load.resolved import Resolved, ResolvedObject, ResolvedVehicle
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.archive import pack, unpack
from uwserver.scenario.solids.objects import object_params
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.simulation import clock
from uwserver.simulation.clock import Timing

FORMAT = "uwserver-recording-3"
"""Of all channels; `uwserver.physics.PHYSICS` is the other version on which a replay depends."""
REPLAYED_FORMATS = ("uwserver-recording-2", FORMAT)
"""Those whose requests and hashes are as here: the second brought none of the states."""
METADATA = "uwserver"
REQUESTS, HASHES, EVENTS = "uwserver/requests", "uwserver/hashes", "uwserver/events"

MAX_CHANNELS = 65_535
"""Of an MCAP file, which has 16 bits for their numbers."""
CHUNK_BYTES = 256 * 1024
"""A chunk is written at the latest when it has grown to this."""

_SECRETS = ("token", "password", "secret")


class Request(Struct, frozen=True, omit_defaults=True):
    """A command (`port`, `value`) or a call (`service`, `args`) that was carried out.

    Attributes:
        index: running number over requests and hashes.
        batch: those of one batch were carried out together: of several commands to one port only the last acted.
        tick: at whose start.
        source: who sent it.
        value: one entry per field of the port.
    """

    index: int
    batch: int
    tick: int
    source: str
    port: str = ""
    value: Items = ()
    service: str = ""
    args: dict[str, Any] = {}

    @classmethod
    def of(cls, item: Command | Call, index: int, batch: int, tick: int) -> Request:
        """The entry for a command or call."""
        if isinstance(item, Command):
            return cls(index, batch, tick, item.source, port=item.port, value=item.value)
        return cls(index, batch, tick, item.source, service=item.service, args=dict(item.args))

    @property
    def item(self) -> Command | Call:
        """The command or call itself."""
        if self.port:
            return Command(self.port, self.value, self.source)
        return Call(self.service, self.args, self.source)


class StateHash(Struct, frozen=True):
    """`Snapshot.hash` of the world after `tick`; `index` as in `Request`."""

    index: int
    tick: int
    hash: str


class Versions(Struct, frozen=True):
    """What a run depends on besides its scenario. `started_utc` is the wall clock."""

    uwserver: str
    python: str
    numpy: str
    numba: str
    platform: str
    started_utc: str = ""


class Head(Struct, frozen=True):
    """The metadata record: everything but the requests that a replay needs."""

    versions: Versions
    seed: int
    timing: dict[str, Any]
    resolved: Resolved


class TooManyChannels(Exception):
    """A recording has no number left for the channel of a port; the text says so."""


@dataclass(slots=True)
class _Kind:
    """A port of one direction and these fields, and its channel: 0 before its first message."""

    port: Port
    channel: int = 0


def versions_here() -> Versions:
    """Those of this process."""
    return Versions(
        __version__,
        platform.python_version(),
        version("numpy"),
        version("numba"),
        platform.platform(),
        clock.utc_text(),
    )


def metadata(resolved: Resolved, seed: int, timing: Timing) -> dict[str, str]:
    """The metadata record of a recording. Keys of adapters that hold a token, password or secret are left out."""
    whole = {
        "name": resolved.name,
        "scenario": _without_secrets(tables(engine_named(resolved.scenario), defaults=True)),
        "vehicles": {
            name: {
                "vehicle": tables(vehicle.vehicle, defaults=True),
                "devices": {key: tables(device, defaults=True) for key, device in vehicle.devices.items()},
            }
            for name, vehicle in resolved.vehicles.items()
        },
        "materials": resolved.materials,
    }
    solids = {f"static/{name}": solid for name, solid in resolved.static.items()}
    solids |= {f"objects/{name}": body.solid for name, body in resolved.objects.items()}
    solids |= {f"vehicles/{name}": v.solid for name, v in resolved.vehicles.items() if v.solid is not None}
    return {
        "format": FORMAT,
        "physics": str(PHYSICS),
        **{key: str(value) for key, value in msgspec.structs.asdict(versions_here()).items()},
        "seed": str(seed),
        "timing": msgspec.json.encode(timing).decode(),
        "scenario": msgspec.json.encode(whole, enc_hook=str).decode(),
        "solids": pack(solids),
    }


def head_of(record: Mapping[str, str], more: More = NO_MORE) -> Head:
    """A metadata record read back; adapters stay plain tables.

    Args:
        record: of a recording.
        more: kinds of the extensions that its scenario uses; their files are not in the recording.

    Raises:
        ValueError: it is of another format or physics, or the scenario in it does not fit this version.
    """
    for name, here in (("format", FORMAT), ("physics", str(PHYSICS))):
        then = record.get(name, "1")
        if then != here and then not in REPLAYED_FORMATS:
            made_by = f"uwserver {record.get('uwserver', 'of old')}"
            text = f"the recording was made by {made_by}, whose {name} is {then}; here it is {here}, and the run would go otherwise"
            raise ValueError(f"{text}: replay it with that version. MCAP tools and `uwserver plot` read it as before")
    try:
        whole = msgspec.json.decode(record["scenario"])
        if whole["scenario"].get("extensions") and not more:
            names = ", ".join(whole["scenario"]["extensions"])
            raise ValueError(f"its components come from {names}: give the file by --extension, if you trust it")
        scenario = _typed(whole["scenario"], Scenario, more)
        solids = unpack(record["solids"])
        vehicles = {
            name: ResolvedVehicle(
                name,
                scenario.vehicles[name],
                _typed(parts["vehicle"], VehicleFile, more),
                msgspec.convert(parts["devices"], dict[str, ThrusterDevice]),
                solids.get(f"vehicles/{name}"),
            )
            for name, parts in whole["vehicles"].items()
        }
        objects = {
            name: ResolvedObject(name, entry, object_params(entry, scenario.environment), solids[f"objects/{name}"])
            for name, entry in scenario.objects.items()
        }
        static = {name.removeprefix("static/"): solid for name, solid in solids.items() if name.startswith("static/")}
        resolved = Resolved(whole["name"], scenario, vehicles, None, (), static, objects, tuple(whole["materials"]))
        versions = msgspec.convert(dict(record), Versions)
        return Head(versions, int(record["seed"]), msgspec.json.decode(record["timing"]), resolved)
    except (KeyError, TypeError, ValueError) as error:
        text = f"the scenario in the recording (uwserver {record.get('uwserver')}) does not fit uwserver {__version__}: {error}"
        raise ValueError(text) from error


def _typed(raw: dict[str, Any], type_: Any, more: More) -> Any:
    if not more:
        return msgspec.convert(raw, type_)

    def fail(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        raise ValueError(f"{dotted(path)}: {text}")

    return convert(raw, type_, (), fail, more)


def _without_secrets(scenario: dict[str, Any]) -> dict[str, Any]:
    adapters = {
        name: {key: value for key, value in table.items() if not any(word in key.lower() for word in _SECRETS)}
        for name, table in scenario.get("adapters", {}).items()
    }
    return {**scenario, "adapters": adapters}


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
        self._presence: Presence | None = None
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
            self._add(self._jumps, event.t_ns, event, event.t_ns)
        self._show(event)

    def presence(self, presence: Presence) -> None:
        """Who and what is there from here on."""
        record = presence.since(self._presence)
        self._presence = presence
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
