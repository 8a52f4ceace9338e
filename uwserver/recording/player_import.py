"""A log of another origin as a recording that can be played: its ports and bodies, as a mapping says, and nothing else.

A foreign log is read once and written in our own format, so that seeking, looping and the web view need no second way. Bodies are boxes, as a log
says nothing of their shape; each has a port ``<body>/pose`` besides the ports of the mapping.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from uwserver.logfiles import Log, LogError
from uwserver.logfiles.joined_log import open_parts
from uwserver.logfiles.log import Datum
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.mapping import PortSource, Value, read_mapping
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of
from uwserver.logfiles.samples import port_samples
from uwserver.ports import Cast, Field, Port, Present, Sample, SceneState, WaterView
from uwserver.recording.format import metadata
from uwserver.recording.player_file import NotPlayable
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.scene.scenery import still_water_view
from uwserver.scenario.water.sea import water_of
from uwserver.simulation.clock import Timing
from uwserver.units import NANOSECONDS
from uwserver.world.external.track import MAX_GAP_S, PoseTrack

RATE_HZ = 120.0
"""Ticks a second on which a foreign log is played."""
MOST_STATES = 30 * 3600 * 24
"""Of a log: a day at `STATES_HZ`; one that tells more gets fewer a second."""
_BOX = {"kind": "box", "size_m": [0.6, 0.4, 0.3], "mass_kg": 10.0}
_SI = {
    "m": ("km", "dm", "cm", "mm", "ft", "fathom", "nmi"),
    "rad": ("mrad", "deg", "cdeg", "degE7", "degE5", "deglatitude", "deglongitude", "degheading"),
    "m/s": ("km/h", "kn", "knots", "km/s", "dm/s", "cm/s", "mm/s", "ft/s"), "rad/s": ("mrad/s", "deg/s", "cdeg/s", "rpm"),
    "m/s^2": ("m/s/s", "cm/s^2", "g", "mG"), "rad/s^2": ("deg/s^2",), "s": ("ms", "us", "ns", "min", "h"),
    "Pa": ("hPa", "mbar", "kPa", "dbar", "bar", "psi"), "degC": ("cdegC", "K", "degF"), "V": ("mV", "cV"), "A": ("mA", "cA"), "J": ("hJ",),
    "T": ("uT", "nT", "gauss", "mgauss"), "1": ("", "%", "d%", "c%"),
}  # fmt: skip
"""What units of logs are called once they are SI; any other keeps its name."""
_NAMED = {other: unit for unit, others in _SI.items() for other in others}


@dataclass
class _Seen:
    """What a first pass found of a port."""

    first: Mapping[str, object]
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0


def import_log(path: Path, mapping_path: Path | None, target: Path) -> tuple[str, ...]:
    """Write a log of another origin as a recording.

    Args:
        path: of the log.
        mapping_path: of a mapping; None for the one that rules find.
        target: a file that does not exist yet.

    Returns what is to be told of the log.

    Raises:
        OSError: a file cannot be read or written.
        NotPlayable: it is no log that is known, damaged, or the mapping finds nothing in it.
    """
    try:
        log = open_parts(path)
    except LogError as error:
        raise NotPlayable(str(error)) from error
    try:
        mapping = mapping_of(log) if mapping_path is None else read_mapping(mapping_path)
        found = pose_tracks(log, mapping)
        tracks = {body_name(name): each.track for name, each in found.items()}
        seen = _first_pass(log, mapping)
        if not tracks and not seen:
            hint = f"write one: uwserver log {path} --mapping"
            raise NotPlayable(f"{path}: no mapping finds a pose or a port in this log of kind {log.kind}; {hint}")
        _write(log, mapping, tracks, seen, target)
        return (*log.remarks, *(remark for each in found.values() for remark in each.remarks))
    except LogError as error:
        raise NotPlayable(str(error)) from error
    finally:
        log.close()


def _first_pass(log: Log, mapping: LogMapping) -> dict[str, _Seen]:
    seen: dict[str, _Seen] = {}
    for t_ns, name, value in port_samples(log, mapping):
        port = seen.get(name)
        if port is None:
            port = seen[name] = _Seen(value, first_ns=t_ns)
        port.count, port.last_ns = port.count + 1, t_ns
    return seen


def _write(
    log: Log, mapping: LogMapping, tracks: Mapping[str, PoseTrack], seen: Mapping[str, _Seen], target: Path
) -> None:
    resolved = scenario_of(log.path.name, _epoch(log), RATE_HZ, tracks)
    names = {name: body_name(name, "/") for name in seen}
    ports = {names[name]: _port(names[name], mapping.ports[name], each) for name, each in seen.items()}
    for body, track in tracks.items():
        ports.setdefault(f"{body}/pose", _pose_port(body, track))
    cast = Cast(1, (), tuple(Present(body, body) for body in tracks))
    shift = min(0, log.start_ns, *(int(track.t_ns[0]) for track in tracks.values()))
    with target.open("xb") as file:
        writer = RecordingWriter(file, metadata(resolved, 0, Timing()), ports)
        models = dict.fromkeys(tracks, "object")
        writer.presence(Presence(cast, 0, 0, 0, ports, {}, models, water_of_still(resolved)))
        counts = dict.fromkeys(ports, 0)
        states = states_of((log.start_ns, log.end_ns), tracks, cast, shift)
        state = next(states, None)
        for t_ns, name, value in _merged(log, mapping, tracks, names):
            while state is not None and state.state.t_ns <= t_ns - shift:
                writer.state(state)
                state = next(states, None)
            t = t_ns - shift
            fields = ports[name].fields
            entry = tuple(_fitting(field, value.get(field.name)) for field in fields)
            writer.sample(Sample(name, counts[name], t, t, True, entry), ports)
            counts[name] += 1
        while state is not None:
            writer.state(state)
            state = next(states, None)
        writer.finish()


def _merged(
    log: Log, mapping: LogMapping, tracks: Mapping[str, PoseTrack], names: Mapping[str, str]
) -> Iterator[Datum]:
    """Samples of ports and of poses, in the order of their times."""
    from heapq import merge

    poses = [_poses(f"{body}/pose", track) for body, track in tracks.items() if f"{body}/pose" not in names.values()]
    samples = (Datum(t_ns, names[name], value) for t_ns, name, value in port_samples(log, mapping) if name in names)
    return merge(samples, *poses, key=lambda datum: datum.t_ns)


def _poses(path: str, track: PoseTrack) -> Iterator[Datum]:
    for t_ns, p, q in zip(track.t_ns.tolist(), track.p_NB.tolist(), track.q_NB.tolist(), strict=True):
        yield Datum(t_ns, path, {"p_NB": tuple(p), "q_NB": tuple(q)})


def states_of(span: tuple[int, int], tracks: Mapping[str, PoseTrack], cast: Cast, shift: int) -> Iterator[Seen]:
    """Where all bodies are, from the begin of a log to its end (ns), `shift` later; one that is not told of stands where it was last."""
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
        yield Seen(0, SceneState(cast, t_ns - shift, rows, np.zeros(0, np.int8), (0.0, 0.0, 0.0)))


def _times(tracks: Mapping[str, PoseTrack], first: int, last: int) -> list[int]:
    """Times of states: at `STATES_HZ` wherever a track tells something, so that a leap in time, of years maybe, costs nothing; first and last."""
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
    """UTC of time 0 as scenarios say it; "" where the log does not know it."""
    if log.epoch_ns is None:
        return ""
    epoch = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(seconds=log.epoch_ns // NANOSECONDS)
    return epoch.strftime("%Y-%m-%dT%H:%M:%SZ")


def scenario_of(title: str, epoch_utc: str, rate_hz: float, tracks: Mapping[str, PoseTrack]) -> Resolved:
    """A world of boxes, in which what is known of a log can be shown; `epoch_utc` may be ""."""
    world: dict[str, Any] = {"rate_hz": rate_hz, **({"epoch_utc": epoch_utc} if epoch_utc else {})}
    objects = {body: {**_BOX, "position_ned_m": [0.0, 0.0, 1.0 + k]} for k, body in enumerate(tracks)}
    raw = {"schema": 1, "title": title, "world": world, "objects": objects}
    return load(msgspec.convert(raw, Scenario), adapters={})


def water_of_still(resolved: Resolved) -> WaterView:
    """The sea of such a world."""
    water = water_of(resolved.scenario.environment, RATE_HZ, lambda path: np.random.default_rng(0))
    return still_water_view(resolved, water)


def _port(path: str, source: PortSource, seen: _Seen) -> Port:
    fields = []
    for name, entries in source.fields.items():
        value, entry = seen.first.get(name), entries[0] if isinstance(entries, list) else entries
        unit = entry.unit or "" if isinstance(entry, Value) else ""
        is_text, is_flag = isinstance(value, str), isinstance(value, bool)
        shape = (len(entries),) if isinstance(entries, list) else ()
        kind: Any = "str" if is_text else "bool" if is_flag else "float"
        fields.append(Field(name, _NAMED.get(unit, unit), f"of {source.topic}", shape=shape, type=kind))
    return Port(path, "sensor", source.kind or "log", tuple(fields), f"{source.topic} of the log.", _rate(seen))


def _pose_port(body: str, track: PoseTrack) -> Port:
    fields = (
        Field("p_NB", "m", "position", "N", (3,)),
        Field("q_NB", "1", "attitude", "NB", (4,)),
    )
    span = _Seen({}, len(track.t_ns), int(track.t_ns[0]), int(track.t_ns[-1]))
    return Port(f"{body}/pose", "sensor", "pose", fields, "Where the log says that it was.", _rate(span))


def _rate(seen: _Seen) -> float:
    span = (seen.last_ns - seen.first_ns) / NANOSECONDS
    return round((seen.count - 1) / span, 3) if span > 0.0 and seen.count > 1 else 1.0


def _fitting(field: Field, value: Any) -> Any:
    """A value as its field wants it; None where the log has another type there."""
    if field.shape:
        entries = tuple(value) if isinstance(value, tuple) else ()
        numbers = tuple(entry if isinstance(entry, float) else None for entry in entries)
        return numbers if len(numbers) == field.shape[0] else None
    wanted = {"str": str, "bool": bool, "float": float}[field.type]
    return value if isinstance(value, wanted) else None


def body_name(text: str, more: str = "") -> str:
    """A name as levels of paths may have."""
    return re.sub(rf"[^A-Za-z0-9_{more}-]", "_", text).strip("/") or "log"
