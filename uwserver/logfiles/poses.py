"""Tracks of a log: NED, FRD and SI from here on."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.geodesy import north_east
from uwserver.frames import attitude_enu_flu, quat_from_rpy, rotate
from uwserver.logfiles.log import Log, LogError, member
from uwserver.logfiles.mapping import (
    ACTUATOR_UNITS,
    SECTIONS,
    Actuators,
    Attitude,
    Mapping,
    Position,
    Section,
    Track,
    Value,
    Velocity,
    one_of,
)
from uwserver.logfiles.si import scale_of
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.units import NANOSECONDS
from uwserver.world.external.motion import Motion
from uwserver.world.external.track import PoseTrack, cleaned

_HELD_NS = NANOSECONDS
"""An attitude or velocity counts so long before its first and after its last datum; beyond, there is no pose."""


class FoundTrack(NamedTuple):
    """A track on the time base of its log, and sentences that tell what was left out or reckoned."""

    track: PoseTrack
    remarks: tuple[str, ...]


class _Series(NamedTuple):
    """One value over time: times (ns, rising) and numbers in SI."""

    t_ns: IntArray
    x: FloatArray


_Series_of = dict[tuple[str, str], _Series]
"""By section and key."""


def pose_tracks(log: Log, mapping: Mapping, names: Collection[str] | None = None) -> dict[str, FoundTrack]:
    """The tracks of a log that a mapping names; all of them, or some.

    Raises:
        LogError: a track has not one pose, is not in the mapping, or the log is damaged.
    """
    wanted = list(mapping.tracks) if names is None else list(names)
    if missing := [name for name in wanted if name not in mapping.tracks]:
        raise LogError(
            f'{log.path}: no track "{missing[0]}" in the mapping; there are: {", ".join(mapping.tracks) or "none"}'
        )
    read = _read(log, {name: mapping.tracks[name] for name in wanted})
    return {name: _track(log, name, mapping, read[name]) for name in wanted}


def _read(log: Log, tracks: dict[str, Track]) -> dict[str, _Series_of]:
    """All values of these tracks, in one pass through the log."""
    takers: dict[str, list[tuple[list[tuple[str, Any]], Value, list[int], list[float]]]] = {}
    rows: dict[tuple[str, str, str], tuple[Value, list[int], list[float]]] = {}
    for name, track in tracks.items():
        for key in SECTIONS:
            section: Section | None = getattr(track, key)
            for part, value in section.values() if section is not None else ():
                times: list[int] = []
                numbers: list[float] = []
                rows[name, key, part] = value, times, numbers
                where = list(section.where.items()) if section is not None else []
                takers.setdefault(value.topic, []).append((where, value, times, numbers))
    for t_ns, topic, datum in log.read(set(takers)):
        for where, value, times, numbers in takers[topic]:
            if where and any(member(datum, field) != wanted for field, wanted in where):
                continue
            times.append(t_ns)
            numbers.append(number(member(datum, value.field)))
    found: dict[str, _Series_of] = {name: {} for name in tracks}
    for (name, key, part), (value, times, numbers) in rows.items():
        scale = scale_of(value.unit or "")
        x = (np.array(numbers, np.float64) * scale.factor + scale.offset) * value.scale
        found[name][key, part] = _Series(np.array(times, np.int64), x)
    return found


def number(value: object) -> float:
    """A number of a log; NaN for everything else."""
    if isinstance(value, int | float | np.number):
        try:
            return float(value)
        except OverflowError:
            return math.nan
    return math.nan


def _track(log: Log, name: str, mapping: Mapping, series: _Series_of) -> FoundTrack:
    track = mapping.tracks[name]
    remarks: list[str] = []
    first = next(part for part, _ in track.position.values())
    times = series["position", first].t_ns
    if not len(times):
        topic = dict(track.position.values())[first].topic
        raise LogError(f'{log.path}: track "{name}": no data of {topic}')
    p = _position(track.position, mapping, series, times, remarks)
    known = np.ones(len(times), np.bool_)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
    if track.attitude is not None:
        q, there = _attitude(track.attitude, series, times)
        known &= there
    else:
        remarks.append("no attitude: it heads north, level")
    v = None
    if track.velocity is not None:
        v, there = _velocity(track.velocity, series, times, q)
        if there.mean() < 0.5:
            v = None
            remarks.append("most poses have no velocity near them in time: positions alone count")
        else:
            known &= there
    if lost := int((~known).sum()):
        remarks.append(f"{lost} positions without attitude or velocity near them in time were left out")
    try:
        found, told = cleaned(times[known], p[known], q[known], None if v is None else v[known])
    except ValueError as error:
        raise LogError(f'{log.path}: track "{name}": {error}{"; " if remarks else ""}{"; ".join(remarks)}') from error
    if track.actuators is not None:
        found = replace(found, motion=_motion(track.actuators, series))
    return FoundTrack(found, (*remarks, *told))


def motion_of(log: Log, section: Actuators) -> Motion | None:
    """What the actuators of one body give; None where the log says nothing of them. Raises LogError."""
    return _motion(section, _read(log, {"": Track(Position(), actuators=section)})[""])


def _motion(section: Actuators, series: _Series_of) -> Motion | None:
    """What actuators give, at the times of the first of them; of the others what was told last until then."""
    names = [name for name, _ in section.values() if len(series["actuators", name].t_ns)]
    if not names:
        return None
    t_ns = np.unique(series["actuators", names[0]].t_ns)
    columns = []
    for name in names:
        times, x = series["actuators", name]
        place = np.searchsorted(times, t_ns, side="right") - 1
        columns.append(np.where(place >= 0, x[np.maximum(place, 0)], np.nan))
    units = {name: value.unit or "" for name, value in section.values()}
    kinds = tuple(ACTUATOR_UNITS[units[name]] for name in names)
    return Motion(t_ns, tuple(names), kinds, np.ascontiguousarray(np.column_stack(columns)))


def _position(
    section: Position, mapping: Mapping, series: _Series_of, times: IntArray, remarks: list[str]
) -> FloatArray:
    def at(part: str) -> FloatArray:
        return _sampled(series["position", part], times)[0]

    if section.latitude is not None:
        latitude, longitude = at("latitude"), at("longitude")
        # Receivers without a fix say 0, 0.
        fixed = np.isfinite(latitude) & np.isfinite(longitude) & ((latitude != 0.0) | (longitude != 0.0))
        latitude, longitude = np.where(fixed, latitude, np.nan), np.where(fixed, longitude, np.nan)
        if mapping.origin is not None:
            degree = scale_of("deg").factor
            origin = mapping.origin.latitude_deg * degree, mapping.origin.longitude_deg * degree
        else:
            k = int(np.argmax(fixed))
            origin = float(latitude[k]), float(longitude[k])
            remarks.append("north and east are counted from its first fix")
        north, east = north_east(latitude, longitude, *origin) if fixed.any() else (latitude, longitude)
    else:
        north, east = at("north"), at("east")
    vertical = one_of(section, "down", "depth", "up", "altitude")
    down = np.zeros(len(times)) if not vertical else at(vertical) if vertical in ("down", "depth") else -at(vertical)
    return np.column_stack([north, east, down])


def _attitude(section: Attitude, series: _Series_of, times: IntArray) -> tuple[FloatArray, Any]:
    """(n, 4) q_NB at these times, and whether it is known there."""
    if section.w is not None:
        base = series["attitude", "w"].t_ns
        q = np.column_stack([_sampled(series["attitude", part], base)[0] for part in "wxyz"])
    else:
        base = series["attitude", "yaw"].t_ns
        angles = [
            _sampled(series["attitude", part], base, angle=True)[0]
            if getattr(section, part) is not None
            else np.zeros(len(base))
            for part in ("roll", "pitch", "yaw")
        ]
        q = np.array([quat_from_rpy(*row) for row in np.column_stack(angles).tolist()]).reshape(-1, 4)
    norms = np.linalg.norm(np.where(np.isfinite(q), q, 0.0), axis=1)
    good = np.isfinite(q).all(axis=1) & (norms > 1e-6)
    base, q = base[good], q[good] / norms[good, None]
    if section.axes == "ENU/FLU":
        q = np.array([attitude_enu_flu(row) for row in q.tolist()]).reshape(-1, 4)
    if len(q):
        # Neighbours on the same side, so that what lies between them is the shorter way.
        signs = np.cumprod(np.append(1.0, np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)))
        q = q * signs[:, None]
    columns = [_sampled(_Series(base, q[:, k]), times) for k in range(4)]
    return np.column_stack([x for x, _ in columns]), columns[0][1]


def _velocity(section: Velocity, series: _Series_of, times: IntArray, q: FloatArray) -> tuple[FloatArray, Any]:
    """(n, 3) v_N at these times, and whether it is known there."""

    def at(part: str) -> tuple[FloatArray, Any]:
        return _sampled(series["velocity", part], times)

    down, known = at("down") if section.down is not None else at("up")
    down = down if section.down is not None else -down
    if section.forward is None:
        return np.column_stack([at("north")[0], at("east")[0], down]), known & np.isfinite(down)
    right = at("right")[0] if section.right is not None else -at("left")[0]
    body = np.column_stack([at("forward")[0], right, down])
    turned = np.array([rotate(a, b) for a, b in zip(q.tolist(), body.tolist(), strict=True)]).reshape(-1, 3)
    return turned, known & np.isfinite(turned).all(axis=1)


def _sampled(series: _Series, times: IntArray, angle: bool = False) -> tuple[FloatArray, Any]:
    """A value at other times, linear between its data; and where it is known. NaN where it never is."""
    if len(series.t_ns) == len(times) and (series.t_ns is times or np.array_equal(series.t_ns, times)):
        return series.x, np.isfinite(series.x)
    finite = np.isfinite(series.x)
    t, x = series.t_ns[finite], series.x[finite]
    if not len(t):
        return np.full(len(times), np.nan), np.zeros(len(times), np.bool_)
    x = np.unwrap(x) if angle else x
    # Differences to the first time are exact in float64; times themselves may not be.
    sampled = np.interp((times - t[0]).astype(np.float64), (t - t[0]).astype(np.float64), x)
    return sampled, (times >= t[0] - _HELD_NS) & (times <= t[-1] + _HELD_NS)
