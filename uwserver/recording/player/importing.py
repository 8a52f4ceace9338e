"""Converts a log of another origin into a recording that can be played, with the ports and bodies that a mapping defines.

The log is read once and written in our own format, so that seeking, looping and the web view work as for our recordings. Bodies are boxes, because
a log does not contain their shape. Each body has a port ``<body>/pose`` besides the ports of the mapping.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from heapq import merge
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET

from uwserver.logfiles import Log, LogError
from uwserver.logfiles.log import Datum
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.mapping import PortMapping, read_mapping, value_of
from uwserver.logfiles.ports import port_samples
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.readers.opening import open_parts
from uwserver.logfiles.rules import mapping_of
from uwserver.ports import EntityList, Event, Field, Port, Present, Sample, SceneState, Service
from uwserver.recording.channels import message_of
from uwserver.recording.format import metadata
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.scene.scenery import still_water_view
from uwserver.scenario.world.sea import water_of
from uwserver.simulation.clock import Timing
from uwserver.units import NANOSECONDS
from uwserver.world.external.track import MAX_GAP_S, PoseTrack

RATE_HZ = 120.0
"""Ticks per second with which a foreign log is played."""
MOST_STATES = 30 * 3600 * 24
"""Largest number of states of a log: a day at `STATES_HZ`. A longer log gets fewer states per second."""
_BOX = {"kind": "box", "size_m": [0.6, 0.4, 0.3], "mass_kg": 10.0}
_SI = {
    "m": ("km", "dm", "cm", "mm", "ft", "fathom", "nmi"),
    "rad": ("mrad", "deg", "cdeg", "degE7", "degE5", "deglatitude", "deglongitude", "degheading"),
    "m/s": ("km/h", "kn", "knots", "km/s", "dm/s", "cm/s", "mm/s", "ft/s"), "rad/s": ("mrad/s", "deg/s", "cdeg/s", "rpm"),
    "m/s^2": ("m/s/s", "cm/s^2", "g", "mG"), "rad/s^2": ("deg/s^2",), "s": ("ms", "us", "ns", "min", "h"),
    "Pa": ("hPa", "mbar", "kPa", "dbar", "bar", "psi"), "degC": ("cdegC", "K", "degF"), "V": ("mV", "cV"), "A": ("mA", "cA"), "J": ("hJ",),
    "T": ("uT", "nT", "gauss", "mgauss"), "1": ("", "%", "d%", "c%"),
}  # fmt: skip
"""Names of units after conversion to SI; a unit that is not listed keeps its name."""
_NAMED = {other: unit for unit, others in _SI.items() for other in others}


@dataclass
class _PortData:
    """The samples of a port: the value of the first, their number, and their times."""

    first: Mapping[str, object]
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0


def import_log(path: Path, mapping_path: Path | None, target: Path) -> tuple[str, ...]:
    """Write a log of another origin as a recording.

    Args:
        path: path of the log.
        mapping_path: path of a mapping; None for the mapping that the rules find.
        target: a file that does not exist yet.

    Returns:
        Remarks about the log.

    Raises:
        OSError: a file cannot be read or written.
        NotPlayable: the format is unknown, the log is damaged, or the mapping finds nothing in it.
    """
    try:
        log = open_parts(path)
    except LogError as error:
        raise NotPlayable(str(error)) from error
    try:
        mapping = mapping_of(log) if mapping_path is None else read_mapping(mapping_path)
        found = pose_tracks(log, mapping)
        tracks = {body_name(name): each.track for name, each in found.items()}
        port_data = _first_pass(log, mapping)
        if not tracks and not port_data:
            hint = f"write a mapping: uwserver log {path} --mapping"
            raise NotPlayable(f"{path}: no mapping finds a pose or a port in this log of kind {log.kind}; {hint}")
        _write(log, mapping, tracks, port_data, target)
        return (*log.remarks, *(remark for each in found.values() for remark in each.remarks))
    except LogError as error:
        raise NotPlayable(str(error)) from error
    finally:
        log.close()


def _first_pass(log: Log, mapping: LogMapping) -> dict[str, _PortData]:
    found: dict[str, _PortData] = {}
    for t_ns, name, value in port_samples(log, mapping):
        port = found.setdefault(name, _PortData(value, first_ns=t_ns))
        port.count, port.last_ns = port.count + 1, t_ns
    return found


def _write(
    log: Log, mapping: LogMapping, tracks: Mapping[str, PoseTrack], data: Mapping[str, _PortData], target: Path
) -> None:
    names = {name: body_name(name, "/") for name in data}
    ports = {names[name]: _port(names[name], mapping.ports[name], each) for name, each in data.items()}
    poses = [_poses(f"{body}/pose", track) for body, track in tracks.items() if f"{body}/pose" not in ports]
    for body, track in tracks.items():
        ports.setdefault(f"{body}/pose", _pose_port(body, track))
    shift = min(0, log.start_ns, *(int(track.t_ns[0]) for track in tracks.values()))
    samples = (Datum(t_ns, names[name], value) for t_ns, name, value in port_samples(log, mapping) if name in names)
    merged = merge(samples, *poses, key=lambda datum: datum.t_ns)
    world = ImportedWorld(scenario_of(log.path.name, _epoch(log), RATE_HZ, tracks), 0, 0, ports, {})
    write_imported(target, world, tracks, (log.start_ns, log.end_ns), _samples(merged, ports, shift), shift)


def _samples(data: Iterable[Datum], ports: Mapping[str, Port], shift: int) -> Iterator[tuple[int, Sample]]:
    counts = dict.fromkeys(ports, 0)
    for t_ns, name, value in data:
        t = t_ns - shift
        entry = tuple(_fitting(field, value.get(field.name)) for field in ports[name].fields)
        yield t, Sample(name, counts[name], t, t, True, entry)
        counts[name] += 1


def _poses(path: str, track: PoseTrack) -> Iterator[Datum]:
    for t_ns, p, q in zip(track.t_ns.tolist(), track.p_NB.tolist(), track.q_NB.tolist(), strict=True):
        yield Datum(t_ns, path, {"p_NB": tuple(p), "q_NB": tuple(q)})


@dataclass(frozen=True)
class ImportedWorld:
    """The world of a recording that is made from a log: scenario, seed, the time at which it begins (ns), ports and services."""

    resolved: Resolved
    seed: int
    start_ns: int
    ports: Mapping[str, Port]
    services: Mapping[str, Service]


def write_imported(
    target: Path,
    world: ImportedWorld,
    tracks: Mapping[str, PoseTrack],
    span: tuple[int, int],
    items: Iterable[tuple[int, Sample | Event]],
    shift: int = 0,
) -> None:
    """Write a recording whose bodies follow tracks.

    Args:
        target: a file that does not exist yet.
        world: the world.
        tracks: by body.
        span: begin and end of the log, ns.
        items: samples and events with their times (ns), in the order of these times.
        shift: what is subtracted from the times of the tracks, ns.

    Raises:
        OSError: the file cannot be written.
    """
    entities, models = EntityList(1, (), tuple(Present(body, body) for body in tracks)), dict.fromkeys(tracks, "object")
    sea = water_of(world.resolved.scenario.environment, RATE_HZ, lambda path: np.random.default_rng(0))
    water = still_water_view(world.resolved, sea)
    states = ((seen.state.t_ns, seen) for seen in _states(span, tracks, entities, shift))
    with target.open("xb") as file:
        writer = RecordingWriter(file, metadata(world.resolved, world.seed, Timing()), world.ports)
        writer.presence(Presence(entities, 0, 0, world.start_ns, world.ports, world.services, models, water))
        for _, item in merge(states, items, key=lambda pair: pair[0]):
            if isinstance(item, Seen):
                writer.state(item)
            elif isinstance(item, Event):
                writer.event(item)
            else:
                writer.sample(item, world.ports)
        writer.finish()


def _states(span: tuple[int, int], tracks: Mapping[str, PoseTrack], entities: EntityList, shift: int) -> Iterator[Seen]:
    """Yield the poses of all bodies over the span of a log (ns), with `shift` subtracted from their times. A body without data keeps its pose."""
    first = min([span[0], *(int(track.t_ns[0]) for track in tracks.values())])
    last = max([span[1], *(int(track.t_ns[-1]) for track in tracks.values())])
    rows = np.zeros((len(tracks), 7))
    rows[:, 3] = 1.0
    for t_ns in _times(tracks, first, last):
        rows = rows.copy()
        for row, track in zip(rows, tracks.values(), strict=True):
            pose = track.at(t_ns, "hold")
            if pose is not None:
                row[:3], row[3:] = pose.p_NB, pose.q_NB
        yield Seen(0, SceneState(entities, t_ns - shift, rows, np.zeros(0, np.int8), (0.0, 0.0, 0.0)))


def _times(tracks: Mapping[str, PoseTrack], first: int, last: int) -> list[int]:
    """Return the times of states: the first, the last, and at `STATES_HZ` where a track has data, so that a jump of years costs nothing."""
    step = round(NANOSECONDS / STATES_HZ)
    while True:
        bridged = round(MAX_GAP_S * NANOSECONDS) // step + 1
        starts = [np.unique((track.t_ns - first) // step) for track in tracks.values()]
        counts = [np.append(np.minimum(np.diff(k), bridged), 2) for k in starts]
        total = sum(int(each.sum()) for each in counts)
        if total <= MOST_STATES:
            break
        step *= 1 + total // MOST_STATES
    found = {first, last}
    for start, count in zip(starts, counts, strict=True):
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        found.update((first + step * (np.repeat(start, count) + within)).tolist())
    return sorted(t_ns for t_ns in found if t_ns <= last)


def _epoch(log: Log) -> str:
    """Return the UTC of time 0 in the form of scenarios; "" when the log does not contain it."""
    if log.epoch_ns is None:
        return ""
    epoch = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(seconds=log.epoch_ns // NANOSECONDS)
    return epoch.strftime("%Y-%m-%dT%H:%M:%SZ")


def scenario_of(title: str, epoch_utc: str, rate_hz: float, tracks: Mapping[str, PoseTrack]) -> Resolved:
    """Return the scenario of a world with a box for each track; `epoch_utc` may be ""."""
    world: dict[str, Any] = {"rate_hz": rate_hz, **({"epoch_utc": epoch_utc} if epoch_utc else {})}
    objects = {body: {**_BOX, "position_ned_m": [0.0, 0.0, 1.0 + k]} for k, body in enumerate(tracks)}
    raw = {"schema": 1, "title": title, "world": world, "objects": objects}
    return load(msgspec.convert(raw, Scenario), adapters={})


def _port(path: str, source: PortMapping, data: _PortData) -> Port:
    fields = []
    for name, entries in source.fields.items():
        value, unit = data.first.get(name), value_of(entries[0] if isinstance(entries, list) else entries).unit or ""
        shape = (len(entries),) if isinstance(entries, list) else ()
        kind: Any = "str" if isinstance(value, str) else "bool" if isinstance(value, bool) else "float"
        fields.append(Field(name, _NAMED.get(unit, unit), f"from {source.topic}", shape=shape, type=kind))
    kind, doc = source.kind or "log", f"{source.topic} of the log."
    message = message_of({"kind": kind}) or UNSET
    return Port(path, "sensor", kind, tuple(fields), doc, _rate(data), message=message)


def _pose_port(body: str, track: PoseTrack) -> Port:
    fields = (
        Field("p_NB", "m", "position", "N", (3,)),
        Field("q_NB", "1", "attitude", "NB", (4,)),
    )
    data = _PortData({}, len(track.t_ns), int(track.t_ns[0]), int(track.t_ns[-1]))
    return Port(f"{body}/pose", "sensor", "pose", fields, "Pose of the body in the log.", _rate(data))


def _rate(data: _PortData) -> float:
    span = (data.last_ns - data.first_ns) / NANOSECONDS
    return round((data.count - 1) / span, 3) if span > 0.0 and data.count > 1 else 1.0


def _fitting(field: Field, value: Any) -> Any:
    """Return a value in the form of its field; None when the log has another type there."""
    if field.shape:
        entries = tuple(value) if isinstance(value, tuple) else ()
        numbers = tuple(entry if isinstance(entry, float) else None for entry in entries)
        return numbers if len(numbers) == field.shape[0] else None
    wanted = {"str": str, "bool": bool, "float": float}[field.type]
    return value if isinstance(value, wanted) else None


def body_name(text: str, more: str = "") -> str:
    """Return a name with the characters that are allowed in a path, and those in `more`."""
    return re.sub(rf"[^A-Za-z0-9_{more}-]", "_", text).strip("/") or "log"
