"""Tracks of external vehicles: read from their logs, in simulation time, and as text for a recording."""

from __future__ import annotations

import base64
from collections.abc import Mapping as MappingOf
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zstandard
from msgspec import UnsetType

from uwserver.frames import rotate
from uwserver.logfiles import Log, LogError
from uwserver.logfiles.joined_log import open_parts
from uwserver.logfiles.mapping import Mapping, read_mapping
from uwserver.logfiles.poses import motion_of, pose_tracks
from uwserver.logfiles.rules import commanded, mapping_of
from uwserver.scenario.files.errors import closest
from uwserver.scenario.vehicle.external import Following
from uwserver.scenario.world.epoch import instant, nanoseconds
from uwserver.units import NANOSECONDS
from uwserver.world.external.motion import Kind, Motion
from uwserver.world.external.track import PoseTrack, cleaned

MOST_POSES = 4_000_000
"""Of one track: eleven hours at 100 Hz."""
LARGEST_BYTES = 1 << 30
"""No archive of tracks that is unpacked may be larger."""
_WITH_SPEED = 10
"""Numbers of a pose with its velocity."""
Fields = MappingOf[str, Any]


class BadTrack(ValueError):
    """A log that gives no track; the text names the file, says why, and what to do."""


class Logged(NamedTuple):
    """Poses of a log on its own clock.

    Attributes:
        track: whose times are those of the log.
        epoch_ns: UTC of the time 0 of that clock, ns since 1970; None where the log does not know it.
        remarks: sentences about what was left out.
    """

    track: PoseTrack
    epoch_ns: int | None
    remarks: tuple[str, ...]


def read_track(entry: Following, folder: Path) -> tuple[PoseTrack, tuple[str, ...]]:
    """The track of an external vehicle in simulation time, and sentences that warn.

    Args:
        entry: its table, with a log.
        folder: where relative names begin.

    Raises:
        BadTrack: the log cannot be read, has no such poses, or does not know its UTC where `start` needs it.
    """
    path = folder / str(entry.log)
    logged = read_log(path, entry, folder)
    try:
        return in_simulation_time(logged, entry), tuple(f"{path}: {remark}" for remark in logged.remarks)
    except ValueError as error:
        raise BadTrack(f"{path}: {error}") from None


def read_log(path: Path, entry: Following, folder: Path) -> Logged:
    """Poses of a log of any format on its own clock; raises BadTrack."""
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
    """A track by the name that the mapping gives it, or the only one."""
    names = list(mapping.tracks)
    if name is None and len(names) != 1:
        raise BadTrack(f'{log.path}: say which poses by track = "...": {_there(names)}')
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
    return f"there are {', '.join(names)}" if names else "there is none that is known by itself"


def _port(log: Log, topic: str) -> Logged | None:
    """Poses of a port with p_NB (or p_N) and q_NB, of a recording of ours or of messages alike; None where none holds a pose."""
    times, numbers, missing, speeds = list[int](), list[list[float]](), 0, True
    for datum in log.read({topic}):
        pose = _pose(datum.value)
        if pose is None:
            missing += 1
            continue
        true = datum.value.get("t_ns")  # a sample is sent when it is delivered, which may be later than it was true
        times.append(true if log.kind == "uwserver" and type(true) is int else datum.t_ns)
        numbers.append(pose)
        speeds = speeds and len(pose) == _WITH_SPEED
        if len(times) > MOST_POSES:
            raise BadTrack(f'{log.path}: more than {MOST_POSES} poses in "{topic}": cut the log into parts')
    if not numbers:
        return None
    told = (f'{missing} messages of "{topic}" hold no pose',) if missing else ()
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
    """Position, attitude and, where it is told, velocity in N of a message; None where it holds no pose."""
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
    """The poses as they happen in a run.

    Raises:
        ValueError: `start` needs a UTC that the log does not know; or all of it lies outside of any run.
    """
    track, start = logged.track, entry.start
    if start == "first":
        first = int(track.t_ns[0])
    elif isinstance(start, str):
        if logged.epoch_ns is None:
            raise ValueError(f'it does not know its UTC, so start = "{start}" means nothing: use "first", or seconds')
        first = nanoseconds(instant(start)) - logged.epoch_ns
    else:
        first = round(start * NANOSECONDS)
    # In exact integers as far as it goes: at speed 1 the times of a log are kept to the nanosecond.
    passed = track.t_ns - first
    scaled = passed if entry.speed == 1.0 else np.rint(passed / entry.speed).astype(np.int64)
    t_ns = scaled + round(entry.offset_s * NANOSECONDS)
    if int(t_ns[-1]) < 0:
        raise ValueError(
            f"its last pose lies {-int(t_ns[-1]) / NANOSECONDS:g} s before the start of the run: look at start and offset_s"
        )
    keep = np.append(np.diff(t_ns) > 0, True)  # at a high speed two poses may fall on one nanosecond
    v = None if track.v_N is None else track.v_N[keep] * entry.speed
    motion = None if track.motion is None else _in_simulation_time(track.motion, first, entry)
    return PoseTrack(t_ns[keep], track.p_NB[keep], track.q_NB[keep], v, motion)


def _in_simulation_time(motion: Motion, first_ns: int, entry: Following) -> Motion:
    t_ns = np.rint((motion.t_ns - first_ns) / entry.speed).astype(np.int64) + round(entry.offset_s * NANOSECONDS)
    keep = np.append(np.diff(t_ns) > 0, np.ones(min(len(t_ns), 1), np.bool_))
    return Motion(t_ns[keep], motion.names, motion.kinds, motion.values[keep])


class _PackedMotion(msgspec.Struct, array_like=True):
    t_ns: bytes
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]
    values: bytes


class _Packed(msgspec.Struct, array_like=True):
    """Bytes of a track's arrays; older ones have no motion."""

    t_ns: bytes
    p_NB: bytes
    q_NB: bytes
    v_N: bytes | None
    motion: _PackedMotion | None = None


def pack(tracks: MappingOf[str, PoseTrack]) -> str:
    """Tracks by name as one line of text; `unpack` gives the same bits.

    A recording holds them, so that it can be run again without the logs, which may be large, private, or gone.
    """
    plain = {name: _packed(track) for name, track in tracks.items()}
    return base64.b85encode(zstandard.ZstdCompressor().compress(msgspec.msgpack.encode(plain))).decode()


def unpack(text: str) -> dict[str, PoseTrack]:
    """The tracks of `pack`.

    Raises:
        ValueError: the text is none of `pack`'s.
    """
    try:
        data = base64.b85decode(text)
        if zstandard.frame_content_size(data) > LARGEST_BYTES:
            raise ValueError(f"they have more than {LARGEST_BYTES} bytes")
        packed = zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_BYTES)
        plain = msgspec.msgpack.decode(packed, type=dict[str, _Packed])
        return {name: _track_of(packed) for name, packed in plain.items()}
    except (zstandard.ZstdError, ValueError) as error:  # msgspec's errors are ValueErrors
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
            raise ValueError("what the actuators of a track give does not fit together")
        motion = Motion(t_ns, names, moved.kinds, values)
    places = np.frombuffer(packed.p_NB).reshape(-1, 3), np.frombuffer(packed.q_NB).reshape(-1, 4)
    return PoseTrack(np.frombuffer(packed.t_ns, np.int64), *places, speeds, motion)
