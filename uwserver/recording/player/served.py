"""Converts a file that `uwserver record` took from a server into a recording that can be played.

The scenario is not in such a file, so bodies are boxes at the poses that the ports give, and the sea is still. All ports, samples, times and events
are kept.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from uwserver.logfiles import Log, LogError, Topic
from uwserver.logfiles.log import foreign
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.readers.opening import open_parts
from uwserver.logfiles.rules import mapping_of
from uwserver.ports import Event, Field, Port, Sample
from uwserver.ports.buffer import unpacked
from uwserver.ports.checks import check_values
from uwserver.recording.channels import SampleMessage, Whole
from uwserver.recording.format import EVENTS
from uwserver.recording.parts import SERVED
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.importing import ImportedWorld, body_name, scenario_of, write_imported
from uwserver.recording.reading import NotReplayable, head_record
from uwserver.recording.states import ServiceRecord
from uwserver.world.external.track import PoseTrack

_TYPES: Mapping[str, Literal["float", "int", "bool", "str"]] = {
    "number": "float", "integer": "int", "boolean": "bool", "string": "str"
}  # fmt: skip


class _World(msgspec.Struct):
    """The world in the answer of `describe`."""

    scenario: str = "a server"
    rate_hz: float = 100.0
    epoch_utc: str = ""
    seed: int = 0
    vehicles: tuple[str, ...] = ()


class _Description(msgspec.Struct):
    """The answer of `describe` in the head of the file."""

    world: _World
    ports: tuple[Port, ...] = ()
    services: tuple[ServiceRecord, ...] = ()


class _BoundedEvent(Event, frozen=True):
    """An event whose time MCAP can store."""

    t_ns: Whole


def is_served(path: Path) -> bool:
    """Return whether `uwserver record` wrote the file. Raises OSError."""
    try:
        return SERVED in head_record(path)
    except NotReplayable:
        return False


def import_served(path: Path, target: Path) -> tuple[str, ...]:
    """Write the file as a recording of a world of which only the ports are known.

    Args:
        path: a file for which `is_served` is true.
        target: a file that does not exist yet.

    Returns:
        Remarks about the file.

    Raises:
        OSError: a file cannot be read or written.
        NotPlayable: the file is damaged, or contains no sample.
    """
    try:
        log = open_parts(path)
        try:
            with foreign(path, "it cannot be read as a file of `uwserver record`"):
                return _imported(log, target)
        finally:
            log.close()
    except LogError as error:
        target.unlink(missing_ok=True)
        raise NotPlayable(str(error)) from error


def _imported(log: Log, target: Path) -> tuple[str, ...]:
    head = head_record(log.path)
    try:
        description = msgspec.json.decode(head["describe"], type=_Description)
    except (msgspec.MsgspecError, KeyError) as error:
        raise LogError(f"{log.path}: the head of the recording is damaged: {error}") from error
    world, ports = description.world, _ports(log, description)
    if not any(log.topics[path].count != 0 for path in ports if path in log.topics):
        raise LogError(f"{log.path}: the file contains no sample, so there is nothing to play")
    tracks, remarks = _tracks(log, world.vehicles)
    resolved = scenario_of(world.scenario, world.epoch_utc, world.rate_hz, tracks)
    services = {record.path: record.service for record in description.services}
    damaged: Counter[str] = Counter()
    imported = ImportedWorld(resolved, world.seed, log.start_ns, ports, services)
    write_imported(target, imported, tracks, (log.start_ns, log.end_ns), _items(log, ports, damaged))
    where = (
        f"`uwserver record` took it from the server at {head[SERVED]}: its scenario is not in it, so bodies are boxes"
    )
    count = damaged.total()
    left_out = [f"{count} messages are left out: they are damaged, or do not fit their ports"] if count else []
    return (f"{where} and the sea is still", *left_out, *log.remarks, *remarks)


def _items(log: Log, ports: Mapping[str, Port], damaged: Counter[str]) -> Iterator[tuple[int, Sample | Event]]:
    """Yield samples and events with their times in the log; count messages that cannot be used by topic."""
    for t_ns, topic, value in log.read({EVENTS, *ports}):
        try:
            if topic != EVENTS:
                yield t_ns, _sample(ports[topic], value)
            elif (event := msgspec.convert(value, _BoundedEvent)).event != "reset":  # at a reset such a file ends
                yield t_ns, event
        except ValueError:  # msgspec's errors are ValueErrors
            damaged[topic] += 1


def _sample(port: Port, value: object) -> Sample:
    """Return the sample of a message. Raises ValueError when it is not a message of this port."""
    message = msgspec.convert(value, SampleMessage)
    entry = tuple(_entry(field, message.value.get(field.name)) for field in port.fields)
    given = [(field, value) for field, value in zip(port.fields, entry, strict=True) if value is not None]
    check_values([field for field, _ in given], [value for _, value in given])
    return Sample(port.path, message.seq, message.t_ns, message.t_sent_ns, message.valid, entry)


def _entry(field: Field, value: Any) -> Any:
    if field.is_packed and isinstance(value, Mapping):
        return unpacked(value)
    return tuple(value) if isinstance(value, list) else value


def _ports(log: Log, description: _Description) -> dict[str, Port]:
    """Return the ports that the server described at the start, and later sensors as their channels describe them."""
    ports = {port.path: port for port in description.ports}
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
    return Port(topic.name, "sensor", "log", tuple(fields), "A sensor that was added during the recording.", 1.0)


def _tracks(log: Log, vehicles: tuple[str, ...]) -> tuple[dict[str, PoseTrack], list[str]]:
    """Return the tracks of the vehicles, from their truth if it was served, else from their navigation; and remarks about them."""
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
