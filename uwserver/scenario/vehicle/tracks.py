"""Tracks of external vehicles: read from their logs, in simulation time, and as text for a recording."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zstandard

from uwserver.frames import rotate
from uwserver.scenario.files.errors import suggestion
from uwserver.scenario.vehicle.external import Following
from uwserver.scenario.world.epoch import instant, nanoseconds
from uwserver.units import NANOSECONDS
from uwserver.world.external.track import PoseTrack, cleaned

MOST_POSES = 4_000_000
"""Of one track: eleven hours at 100 Hz."""
LARGEST_BYTES = 1 << 30
"""No archive of tracks that is unpacked may be larger."""
_RECORD_BYTES = 1 << 28
_METADATA = "uwserver"
_POSITIONS, _ATTITUDES, _VELOCITIES = ("p_NB", "p_N"), ("q_NB",), ("v_N", "v_NB_B")


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
    logged = read_log(path, entry)
    try:
        return in_simulation_time(logged, entry), tuple(f"{path}: {remark}" for remark in logged.remarks)
    except ValueError as error:
        raise BadTrack(f"{path}: {error}") from None


def read_log(path: Path, entry: Following) -> Logged:
    """Poses of a log on its own clock; raises BadTrack."""
    topic = "" if entry.track is msgspec.UNSET else str(entry.track)
    if not topic:
        raise BadTrack(f'{path}: say which poses: track = "rov/truth/pose", the path of a port')
    return read_recording(path, topic)


def read_recording(path: Path, topic: str) -> Logged:
    """Poses of a port of a recording of ours, or of another MCAP file whose messages are JSON with the same fields.

    Raises:
        BadTrack: no such file or topic, damaged, or no poses in it.
    """
    # Imported here: it costs more than the rest of loading, and most scenarios read no log.
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, record_size_limit=_RECORD_BYTES)
            rows, topics = [], set[str]()
            for _, channel, message in reader.iter_messages(log_time_order=True):
                topics.add(channel.topic)
                if channel.topic == topic:
                    rows.append((message.publish_time, message.data))
                    if len(rows) > MOST_POSES:
                        raise BadTrack(f'{path}: more than {MOST_POSES} messages in "{topic}": cut the log into parts')
            epoch_ns = _epoch(reader)
    except OSError as error:
        raise BadTrack(f"{path}: {error.strerror or error}") from None
    except (McapError, zstandard.ZstdError, EOFError, MemoryError, KeyError) as error:
        raise BadTrack(f"{path}: damaged, or no MCAP file: {error or type(error).__name__}") from None
    if not rows:
        there = suggestion(topic, sorted(topics), "; there are: ")
        raise BadTrack(f'{path}: nothing in "{topic}"{there}')
    return _logged(path, topic, rows, epoch_ns)


def _logged(path: Path, topic: str, rows: Sequence[tuple[int, bytes]], epoch_ns: int | None) -> Logged:
    times, numbers, missing, speeds = list[int](), list[list[float]](), 0, True
    for t_ns, data in rows:
        pose = _pose(data)
        if pose is None:
            missing += 1
        else:
            times.append(t_ns)
            numbers.append(pose)
            speeds = speeds and len(pose) == 10
    remarks = (f'{missing} messages of "{topic}" hold no pose',) if missing else ()
    if not numbers:
        raise BadTrack(f'{path}: no message of "{topic}" holds a pose: it needs p_NB and q_NB, valid')
    table = np.array([row[:10] if speeds else row[:7] for row in numbers])
    try:
        track, left_out = cleaned(
            np.array(times, np.int64), table[:, :3], table[:, 3:7], table[:, 7:10] if speeds else None
        )
    except ValueError as error:
        raise BadTrack(f'{path}: "{topic}": {error}') from None
    return Logged(track, epoch_ns, (*remarks, *(f'"{topic}": {remark}' for remark in left_out)))


def _pose(data: bytes) -> list[float] | None:
    """Position, attitude and, where it is told, velocity in N of a message; None where it holds no pose."""
    try:
        message = msgspec.json.decode(data)
    except (msgspec.MsgspecError, RecursionError):
        return None
    if not isinstance(message, dict) or message.get("valid") is False:
        return None
    value = message.get("value", message)
    if not isinstance(value, dict):
        return None
    p, q = _vector(value, _POSITIONS, 3), _vector(value, _ATTITUDES, 4)
    if p is None or q is None:
        return None
    v, in_body = _vector(value, _VELOCITIES[:1], 3), _vector(value, _VELOCITIES[1:], 3)
    if v is None and in_body is not None:
        v = list(rotate(q, in_body))
    return [*p, *q, *(v or ())]


def _vector(value: Mapping[str, Any], names: Sequence[str], size: int) -> list[float] | None:
    found = next((value[name] for name in names if name in value), None)
    if not isinstance(found, list) or len(found) != size or not all(isinstance(c, float | int) for c in found):
        return None
    return [float(c) for c in found]


def _epoch(reader: Any) -> int | None:
    """UTC of the time 0 of a recording of ours: its scenario says it."""
    for metadata in reader.iter_metadata():
        if metadata.name == _METADATA:
            try:
                world = json.loads(metadata.metadata["scenario"])["scenario"]["world"]
                return nanoseconds(instant(world["epoch_utc"]))
            except (KeyError, TypeError, ValueError, RecursionError):
                return None
    return None


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
    return PoseTrack(t_ns[keep], track.p_NB[keep], track.q_NB[keep], v)


def pack(tracks: Mapping[str, PoseTrack]) -> str:
    """Tracks by name as one line of text; `unpack` gives the same bits.

    A recording holds them, so that it can be run again without the logs, which may be large, private, or gone.
    """
    plain = {
        name: [array.tobytes() if array is not None else None for array in (t.t_ns, t.p_NB, t.q_NB, t.v_N)]
        for name, t in tracks.items()
    }
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
        plain = msgspec.msgpack.decode(packed, type=dict[str, tuple[bytes, bytes, bytes, bytes | None]])
        return {name: _track_of(*arrays) for name, arrays in plain.items()}
    except (zstandard.ZstdError, ValueError) as error:  # msgspec's errors are ValueErrors
        raise ValueError(f"the tracks of external vehicles cannot be read: {error}") from error


def _track_of(t: bytes, p: bytes, q: bytes, v: bytes | None) -> PoseTrack:
    speeds = None if v is None else np.frombuffer(v).reshape(-1, 3)
    return PoseTrack(
        np.frombuffer(t, np.int64), np.frombuffer(p).reshape(-1, 3), np.frombuffer(q).reshape(-1, 4), speeds
    )
