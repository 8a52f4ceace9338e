"""Reads the tracks of external vehicles from logs, shifts them to simulation time, and packs them as text for a recording."""

from __future__ import annotations

from collections.abc import Mapping as MappingOf
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import UnsetType
from numpy.typing import NDArray

from uwserver.frames import rotate
from uwserver.logfiles import Log, LogError
from uwserver.logfiles.mapping import Mapping, read_mapping
from uwserver.logfiles.poses import motion_of, pose_tracks
from uwserver.logfiles.readers.opening import open_parts
from uwserver.logfiles.rules import commanded, mapping_of
from uwserver.physics.kernel.arrays import IntArray
from uwserver.scenario.files.errors import closest
from uwserver.scenario.solids.archive import compressed, decompressed
from uwserver.scenario.vehicle.entry import Following
from uwserver.scenario.world.earth import instant, nanoseconds
from uwserver.units import NANOSECONDS
from uwserver.world.external.motion import Kind, Motion
from uwserver.world.external.track import PoseTrack, cleaned

MOST_POSES = 4_000_000
"""Most poses of one track: eleven hours at 100 Hz."""
_WITH_VELOCITY = 10
"""Number of values of a pose with its velocity."""
Fields = MappingOf[str, Any]


class BadTrack(ValueError):
    """Raised if a log gives no track; the text names the file, the reason, and what to do."""


class Logged(NamedTuple):
    """Poses of a log on the clock of the log.

    Attributes:
        track: poses, with times of the log.
        epoch_ns: UTC of time 0 of that clock, ns since 1970; None if the log does not know it.
        remarks: sentences about messages that were left out.
    """

    track: PoseTrack
    epoch_ns: int | None
    remarks: tuple[str, ...]


def read_track(entry: Following, folder: Path) -> tuple[PoseTrack, tuple[str, ...]]:
    """Return the track of an external vehicle in simulation time, and warnings.

    Args:
        entry: table of the vehicle, with a log.
        folder: where relative file names start.

    Raises:
        BadTrack: the log cannot be read, has no such poses, or does not know its UTC although `start` needs it.
    """
    path = folder / str(entry.log)
    logged = read_log(path, entry, folder)
    try:
        return in_simulation_time(logged, entry), tuple(f"{path}: {remark}" for remark in logged.remarks)
    except ValueError as error:
        raise BadTrack(f"{path}: {error}") from None


def read_log(path: Path, entry: Following, folder: Path) -> Logged:
    """Return the poses of a log of any format, on its own clock; raises BadTrack."""
    name = None if isinstance(entry.track, UnsetType) else entry.track
    try:
        log = open_parts(path)
        try:
            if not isinstance(entry.mapping, UnsetType):
                mapping = read_mapping(folder / entry.mapping)
            elif name is not None and name in log.topics and (found := _port(log, name)) is not None:
                return found
            else:
                mapping = mapping_of(log)
            return _mapped(log, mapping, name)
        finally:
            log.close()
    except LogError as error:
        raise BadTrack(str(error)) from None


def _mapped(log: Log, mapping: Mapping, name: str | None) -> Logged:
    """Return the track that the mapping names so; without a name the only one."""
    names = list(mapping.tracks)
    if name is None and len(names) != 1:
        raise BadTrack(f'{log.path}: name the poses to follow by track = "...": {_there(names)}')
    if name is not None and name not in names:
        topics = [topic for topic in log.topics if closest(name, [topic])]
        text = f'{log.path}: no track "{name}": {_there(names + topics)}'
        raise BadTrack(f"{text}; `uwserver log {log.path.name} --mapping` writes a mapping that you can change")
    wanted = names[0] if name is None else name
    track, remarks = pose_tracks(log, mapping, [wanted])[wanted]
    if len(track) > MOST_POSES:
        raise BadTrack(f'{log.path}: more than {MOST_POSES} poses in "{wanted}": cut the log into parts')
    return Logged(track, log.epoch_ns, remarks)


def _there(names: Sequence[str]) -> str:
    return f"there are {', '.join(names)}" if names else "no topic of it is known to hold poses"


def _port(log: Log, topic: str) -> Logged | None:
    """Return the poses of a topic with p_NB (or p_N) and q_NB, of our recordings or of similar messages; None if no message holds a pose."""
    times, numbers, missing, speeds = list[int](), list[list[float]](), 0, True
    for datum in log.read({topic}):
        pose = _pose(datum.value)
        if pose is None:
            missing += 1
            continue
        true = datum.value.get("t_ns")  # the time of measurement, which may be earlier than that of delivery
        times.append(true if log.kind == "uwserver" and type(true) is int else datum.t_ns)
        numbers.append(pose)
        speeds = speeds and len(pose) == _WITH_VELOCITY
        if len(times) > MOST_POSES:
            raise BadTrack(f'{log.path}: more than {MOST_POSES} poses in "{topic}": cut the log into parts')
    if not numbers:
        return None
    told = (f'{missing} messages of "{topic}" hold no pose and were left out',) if missing else ()
    table = np.array([row if speeds else row[:7] for row in numbers])
    try:
        clean, left_out = cleaned(
            np.array(times, np.int64), table[:, :3], table[:, 3:7], table[:, 7:] if speeds else None
        )
    except (ValueError, OverflowError) as error:
        raise BadTrack(f'{log.path}: "{topic}": {error}') from None
    outputs = commanded(log, f"{topic.partition('/')[0]}/thrusters") if log.kind == "uwserver" else None
    if outputs is not None:
        clean = replace(clean, motion=motion_of(log, outputs))
    return Logged(clean, log.epoch_ns, (*told, *(f'"{topic}": {remark}' for remark in left_out)))


def _pose(message: Fields) -> list[float] | None:
    """Return position, attitude and, if given, velocity in N of a message; None if it holds no pose."""
    value = message.get("value", message)
    if message.get("valid") is False or not isinstance(value, MappingOf):
        return None
    p, q = _vector(value, ("p_NB", "p_N"), 3), _vector(value, ("q_NB",), 4)
    if p is None or q is None or value.get("position_valid") is False:
        return None
    v, in_body = _vector(value, ("v_N",), 3), _vector(value, ("v_NB_B",), 3)
    if v is None and in_body is not None:
        v = list(rotate(q, in_body))
    return [*p, *q, *(v or ())]


def _vector(value: Fields, names: Sequence[str], size: int) -> list[float] | None:
    found = next((value[name] for name in names if name in value), None)
    if not isinstance(found, list) or len(found) != size or not all(isinstance(c, float | int) for c in found):
        return None
    return [float(c) for c in found]


def in_simulation_time(logged: Logged, entry: Following) -> PoseTrack:
    """Return the poses with times of the simulation.

    Raises:
        ValueError: `start` needs a UTC that the log does not know, or all poses lie before the start of the run.
    """
    track, start = logged.track, entry.start
    if start == "first":
        first = int(track.t_ns[0])
    elif isinstance(start, str):
        if logged.epoch_ns is None:
            raise ValueError(
                f'the log does not know its UTC, so start = "{start}" cannot be found in it: use "first", or seconds'
            )
        first = nanoseconds(instant(start)) - logged.epoch_ns
    else:
        first = round(start * NANOSECONDS)
    t_ns, keep = _shifted(track.t_ns, first, entry)
    if int(t_ns[-1]) < 0:
        early = -int(t_ns[-1]) / NANOSECONDS
        raise ValueError(f"its last pose lies {early:g} s before the start of the run: check start and offset_s")
    v = None if track.v_N is None else track.v_N[keep] * entry.speed
    motion = track.motion
    if motion is not None:
        times, moved = _shifted(motion.t_ns, first, entry)
        motion = Motion(times[moved], motion.names, motion.kinds, motion.values[moved])
    return PoseTrack(t_ns[keep], track.p_NB[keep], track.q_NB[keep], v, motion)


def _shifted(t_ns: IntArray, first_ns: int, entry: Following) -> tuple[IntArray, NDArray[np.bool_]]:
    """Return times of a log as simulation times, and which of them are left: at a high speed two may fall on the same nanosecond."""
    passed = t_ns - first_ns
    # Division would round: at speed 1 the times of a log are kept to the nanosecond.
    scaled = passed if entry.speed == 1.0 else np.rint(passed / entry.speed).astype(np.int64)
    times = scaled + round(entry.offset_s * NANOSECONDS)
    return times, np.append(np.diff(times) > 0, np.ones(min(len(times), 1), np.bool_))


class _PackedMotion(msgspec.Struct, array_like=True):
    t_ns: bytes
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]
    values: bytes


class _Packed(msgspec.Struct, array_like=True):
    """The arrays of a track as bytes. Older recordings have no motion."""

    t_ns: bytes
    p_NB: bytes
    q_NB: bytes
    v_N: bytes | None
    motion: _PackedMotion | None = None


def pack(tracks: MappingOf[str, PoseTrack]) -> str:
    """Pack tracks by name into one line of text; `unpack` returns them bit for bit.

    A recording holds this text, so that it can be run again without the logs, which may be large, private, or lost.
    """
    return compressed({name: _packed(track) for name, track in tracks.items()})


def unpack(text: str) -> dict[str, PoseTrack]:
    """Return the tracks that `pack` packed.

    Raises:
        ValueError: the text does not come from `pack`.
    """
    try:
        plain = msgspec.msgpack.decode(decompressed(text), type=dict[str, _Packed])
        return {name: _track_of(packed) for name, packed in plain.items()}
    except ValueError as error:  # msgspec's errors are ValueErrors
        raise ValueError(f"the tracks of external vehicles cannot be read: {error}") from error


def _packed(track: PoseTrack) -> _Packed:
    moved, v = track.motion, track.v_N
    motion = (
        None if moved is None else _PackedMotion(moved.t_ns.tobytes(), moved.names, moved.kinds, moved.values.tobytes())
    )
    arrays = track.t_ns.tobytes(), track.p_NB.tobytes(), track.q_NB.tobytes(), None if v is None else v.tobytes()
    return _Packed(*arrays, motion)


def _track_of(packed: _Packed) -> PoseTrack:
    speeds, moved = None if packed.v_N is None else np.frombuffer(packed.v_N).reshape(-1, 3), packed.motion
    motion = None
    if moved is not None:
        t_ns, names = np.frombuffer(moved.t_ns, np.int64), moved.names
        values = np.frombuffer(moved.values).reshape(len(t_ns), len(names))
        if len(moved.kinds) != len(names) or (np.diff(t_ns) <= 0).any():
            raise ValueError("the actuator values of a track do not fit their names and times")
        motion = Motion(t_ns, names, moved.kinds, values)
    places = np.frombuffer(packed.p_NB).reshape(-1, 3), np.frombuffer(packed.q_NB).reshape(-1, 4)
    return PoseTrack(np.frombuffer(packed.t_ns, np.int64), *places, speeds, motion)
