"""What `uwserver record` took from a server, as a recording that can be played: its ports and samples as they were served.

Its scenario is not in the file. So bodies are boxes where the ports tell a pose, and the sea is still; all ports, samples, times and events are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from uwserver.logfiles import Log, LogError, Topic
from uwserver.logfiles.foreign import foreign
from uwserver.logfiles.joined_log import open_parts
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of
from uwserver.ports import Cast, Event, Field, Port, Present, Sample, Service
from uwserver.ports.buffer import unpacked
from uwserver.ports.checks import check_values
from uwserver.recording.format import EVENTS, metadata
from uwserver.recording.parts import SERVED
from uwserver.recording.player_file import NotPlayable
from uwserver.recording.player_import import body_name, scenario_of, states_of, water_of_still
from uwserver.recording.reading import NotReplayable, head_record
from uwserver.recording.states import Presence, ServiceRecord
from uwserver.recording.writer import RecordingWriter
from uwserver.simulation.clock import Timing
from uwserver.world.external.track import PoseTrack

_TYPES: Mapping[str, Literal["float", "int", "bool", "str"]] = {
    "number": "float", "integer": "int", "boolean": "bool", "string": "str"
}  # fmt: skip


class _World(msgspec.Struct):
    """What `describe` says of a world."""

    scenario: str = "a server"
    rate_hz: float = 100.0
    epoch_utc: str = ""
    seed: int = 0
    vehicles: tuple[str, ...] = ()


class _Told(msgspec.Struct):
    """The answer of `describe` that heads such a file."""

    world: _World
    ports: tuple[Port, ...] = ()
    services: tuple[ServiceRecord, ...] = ()


_Whole = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]


class _Said(msgspec.Struct):
    """A message of a sensor."""

    seq: _Whole
    t_ns: _Whole
    t_sent_ns: _Whole
    valid: bool
    value: dict[str, Any]


class _Happened(Event, frozen=True):
    """An event at a time that a file can have."""

    t_ns: _Whole


def is_served(path: Path) -> bool:
    """Whether `uwserver record` has written a file. Raises OSError."""
    try:
        return SERVED in head_record(path)
    except NotReplayable:
        return False


def import_served(path: Path, target: Path) -> tuple[str, ...]:
    """Write it as a recording of a world of which only the ports are known.

    Args:
        path: a file of which `is_served` is true.
        target: a file that does not exist yet.

    Returns what is to be told of it.

    Raises:
        OSError: a file cannot be read or written.
        NotPlayable: it is damaged, or there is no sample in it.
    """
    try:
        log = open_parts(path)
        try:
            with foreign(path, "cannot be read as what `uwserver record` writes"):
                return _imported(log, target)
        finally:
            log.close()
    except LogError as error:
        target.unlink(missing_ok=True)
        raise NotPlayable(str(error)) from error


def _imported(log: Log, target: Path) -> tuple[str, ...]:
    head = head_record(log.path)
    try:
        told = msgspec.json.decode(head["describe"], type=_Told)
    except (msgspec.MsgspecError, KeyError) as error:
        raise LogError(f"{log.path}: the head of the recording is damaged: {error}") from error
    ports = _ports(log, told)
    if not any(log.topics[path].count != 0 for path in ports if path in log.topics):
        raise LogError(f"{log.path}: not one sample is in it, so that there is nothing to play")
    tracks, remarks = _tracks(log, told.world.vehicles)
    resolved = scenario_of(told.world.scenario, told.world.epoch_utc, told.world.rate_hz, tracks)
    cast = Cast(1, (), tuple(Present(body, body) for body in tracks))
    services: dict[str, Service] = {record.path: record.service for record in told.services}
    with target.open("xb") as file:
        writer = RecordingWriter(file, metadata(resolved, told.world.seed, Timing()), ports)
        models = dict.fromkeys(tracks, "object")
        writer.presence(Presence(cast, 0, 0, log.start_ns, ports, services, models, water_of_still(resolved)))
        damaged = _write(log, writer, ports, states_of((log.start_ns, log.end_ns), tracks, cast, 0))
        writer.finish()
    where = f"`uwserver record` took it from the server at {head[SERVED]}: its scenario is not in it, so that bodies are boxes"
    left_out = [f"{damaged} messages are damaged, or are not as their ports say: they are left out"] if damaged else []
    return (f"{where} and the sea is still", *left_out, *log.remarks, *remarks)


def _write(log: Log, writer: RecordingWriter, ports: Mapping[str, Port], states: Iterator[Any]) -> int:
    """Returns how many messages are not what they should be."""
    damaged = 0
    state = next(states, None)
    for t_ns, topic, value in log.read({EVENTS, *ports}):
        while state is not None and state.state.t_ns <= t_ns:
            writer.state(state)
            state = next(states, None)
        try:
            if topic == EVENTS:
                event = msgspec.convert(value, _Happened)
                if event.event != "reset":  # the file ends there
                    writer.event(event)
            else:
                writer.sample(_sample(ports[topic], value), ports)
        except ValueError:  # msgspec's errors are ValueErrors
            damaged += 1
    while state is not None:
        writer.state(state)
        state = next(states, None)
    return damaged


def _sample(port: Port, value: object) -> Sample:
    """ValueError if it is no message of this port."""
    said = msgspec.convert(value, _Said)
    entry = tuple(_entry(field, said.value.get(field.name)) for field in port.fields)
    given = [(field, value) for field, value in zip(port.fields, entry, strict=True) if value is not None]
    check_values([field for field, _ in given], [value for _, value in given])
    return Sample(port.path, said.seq, said.t_ns, said.t_sent_ns, said.valid, entry)


def _entry(field: Field, value: Any) -> Any:
    if field.is_packed and isinstance(value, Mapping):
        return unpacked(value)
    return tuple(value) if isinstance(value, list) else value


def _ports(log: Log, told: _Told) -> dict[str, Port]:
    """Sensors as the server described them at first; those that came later as their channels tell."""
    ports = {port.path: port for port in told.ports}
    for name, topic in log.topics.items():
        if name not in ports and topic.count != 0 and any(field.name == "t_sent_ns" for field in topic.fields):
            ports[name] = _port(topic)
    return ports


def _port(topic: Topic) -> Port:
    fields = []
    for field in topic.fields:
        outer, _, name = field.name.partition(".")
        kind, _, size = field.type.rstrip("]").partition("[")
        if outer == "value" and kind in _TYPES:
            fields.append(Field(name, field.unit or "1", "", field.frame, (int(size),) if size else (), _TYPES[kind]))
    return Port(topic.name, "sensor", "log", tuple(fields), "It came while the server was recorded.", 1.0)


def _tracks(log: Log, vehicles: tuple[str, ...]) -> tuple[dict[str, PoseTrack], list[str]]:
    """Poses of the vehicles: their truth, if it was served, else what a navigation of theirs says; and what is to be told of them."""
    mapping = mapping_of(log)
    tracks: dict[str, PoseTrack] = {}
    remarks: list[str] = []
    for name, track in mapping.tracks.items():
        of = track.position.topic.partition("/")[0]
        body = of if of in vehicles and of not in tracks else body_name(name)
        try:
            found = pose_tracks(log, LogMapping(tracks={name: track}))[name]
        except LogError:
            continue  # a port that never had a pose
        tracks[body] = found.track
        remarks += found.remarks
    return tracks, remarks
