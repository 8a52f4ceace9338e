"""Writes a log as a MOOS log: tracks as NAV_X, NAV_Y, NAV_DEPTH, NAV_HEADING, and every number of a port as a variable of its own."""

from __future__ import annotations

import heapq
import math
import re
from collections.abc import Iterator
from pathlib import Path

from uwserver.frames import rpy_from_quat
from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import Mapping
from uwserver.logfiles.poses import FoundTrack
from uwserver.logfiles.samples import port_samples
from uwserver.logfiles.si import scale_of
from uwserver.units import NANOSECONDS

_Line = tuple[int, str, str]
"""Time (ns), variable, value."""


def write_alog(log: Log, mapping: Mapping, tracks: dict[str, FoundTrack], file: Path) -> None:
    """Write the file. The first track has the prefix NAV, the others have their names; headings are in degrees, as usual in MOOS.

    Raises:
        LogError: the log is damaged.
        OSError: the file exists already, or cannot be written.
    """
    poses = [_track("NAV" if k == 0 else _word(name), found) for k, (name, found) in enumerate(tracks.items())]
    began = (log.epoch_ns or 0) / NANOSECONDS
    with file.open("x", encoding="utf-8", newline="\n") as out:
        out.write(
            f"%% LOG FILE:       {file.name}\n%% FILE OPENED ON  {log.path.name}\n%% LOGSTART           {began:.6f}\n"
        )
        for t_ns, name, text in heapq.merge(*poses, _ports(log, mapping), key=lambda line: line[0]):
            out.write(f"{t_ns / NANOSECONDS:<16.6f}{name:<24} uwserver  {text}\n")


def _track(prefix: str, found: FoundTrack) -> Iterator[_Line]:
    degree = scale_of("deg").factor
    track = found.track
    for t_ns, p, q in zip(track.t_ns.tolist(), track.p_NB.tolist(), track.q_NB.tolist(), strict=True):
        roll, pitch, yaw = rpy_from_quat(q)
        whole = (
            ("X", p[1]),
            ("Y", p[0]),
            ("DEPTH", p[2]),
            ("HEADING", yaw % math.tau / degree),
            ("PITCH", pitch),
            ("ROLL", roll),
        )
        for name, value in whole:
            yield t_ns, f"{prefix}_{name}", f"{value:.9g}"


def _ports(log: Log, mapping: Mapping) -> Iterator[_Line]:
    for datum in port_samples(log, mapping):
        for field, value in datum.value.items():
            for suffix, number in _parts(value):
                yield datum.t_ns, _word(f"{datum.topic}_{field}{suffix}"), number


def _parts(value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, tuple):
        for k, part in enumerate(value):
            if part is not None:
                yield f"_{k}", str(part)
    elif isinstance(value, str):
        yield "", " ".join(value.split())
    elif value is not None:
        yield "", str(value).lower() if isinstance(value, bool) else repr(value)


def _word(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").upper() or "TRACK"
