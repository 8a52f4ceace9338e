"""Reads the tracks (poses and velocities of bodies) of a log and converts them to NED, FRD and SI."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.earth import north_east
from uwserver.frames import attitude_enu_flu, quat_from_rpy, rotate
from uwserver.logfiles.log import Log, LogError, matches, member
from uwserver.logfiles.mapping import (
    ACTUATOR_UNITS,
    Actuators,
    Attitude,
    Mapping,
    Match,
    Position,
    Track,
    Value,
    Velocity,
    one_of,
)
from uwserver.logfiles.ports import number
from uwserver.logfiles.si import scale_of
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.units import NANOSECONDS
from uwserver.world.external.motion import Motion
from uwserver.world.external.track import PoseTrack, cleaned

_HELD_NS = NANOSECONDS
"""An attitude or velocity holds for this long before its first and after its last datum; beyond that there is no pose."""


class FoundTrack(NamedTuple):
    """A track on the time base of its log, and sentences about what was left out or computed."""

    track: PoseTrack
    remarks: tuple[str, ...]


@dataclass
class _Series:
    """One value of a track over time.

    Attributes:
        value: its place in the log.
        where: the filter of its section.
        times: ns, rising.
        numbers: in the unit of the log.
    """

    value: Value
    where: Match
    times: list[int] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)

    @cached_property
    def t_ns(self) -> IntArray:
        """Return the times (n), after all are read."""
        return np.array(self.times, np.int64)

    @cached_property
    def x(self) -> FloatArray:
        """Return the numbers (n) in SI, after all are read."""
        scale = scale_of(self.value.unit or "")
        return (np.array(self.numbers, np.float64) * scale.factor + scale.offset) * self.value.scale


_TrackSeries = dict[tuple[str, str], _Series]
"""The series of a track by section and key."""


def pose_tracks(log: Log, mapping: Mapping, names: Collection[str] | None = None) -> dict[str, FoundTrack]:
    """Read tracks of a log that a mapping defines.

    Args:
        log: to be read.
        mapping: defines the tracks.
        names: the tracks that are read; None for all.

    Raises:
        LogError: a track has no pose or is not in the mapping, or the log is damaged.
    """
    wanted = list(mapping.tracks) if names is None else list(names)
    if missing := [name for name in wanted if name not in mapping.tracks]:
        raise LogError(
            f'{log.path}: no track "{missing[0]}" in the mapping; there are: {", ".join(mapping.tracks) or "none"}'
        )
    read = _read(log, {name: mapping.tracks[name] for name in wanted})
    return {name: _track(log, name, mapping, read[name]) for name in wanted}


def _read(log: Log, tracks: dict[str, Track]) -> dict[str, _TrackSeries]:
    """Read all values of these tracks in one pass through the log."""
    found: dict[str, _TrackSeries] = {name: {} for name in tracks}
    by_topic: dict[str, list[_Series]] = {}
    for name, track in tracks.items():
        for key, section in track.sections():
            for part, value in section.values():
                series = found[name][key, part] = _Series(value, section.where)
                by_topic.setdefault(value.topic, []).append(series)
    for t_ns, topic, datum in log.read(set(by_topic)):
        for series in by_topic[topic]:
            if matches(datum, series.where):
                series.times.append(t_ns)
                series.numbers.append(number(member(datum, series.value.field)))
    return found


def _track(log: Log, name: str, mapping: Mapping, series: _TrackSeries) -> FoundTrack:
    track = mapping.tracks[name]
    remarks: list[str] = []
    first, value = next(track.position.values())
    times = series["position", first].t_ns
    if not len(times):
        raise LogError(f'{log.path}: track "{name}": the log has no data of {value.topic}')
    p = _position(track.position, mapping, series, times, remarks)
    known = np.ones(len(times), np.bool_)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
    if track.attitude is not None:
        q, there = _attitude(track.attitude, series, times)
        known &= there
    else:
        remarks.append("no attitude: the body is shown level and heading north")
    v = None
    if track.velocity is not None:
        v, there = _velocity(track.velocity, series, times, q)
        if there.mean() < 0.5:
            v = None
            remarks.append("most poses have no velocity near them in time: only positions are used")
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
    """Read the outputs of the actuators of one body; None when the log has none. Raises LogError."""
    return _motion(section, _read(log, {"": Track(Position(), actuators=section)})[""])


def _motion(section: Actuators, series: _TrackSeries) -> Motion | None:
    """Return the outputs at the times of the first actuator; for the others their newest output until then."""
    names = [name for name, _ in section.values() if len(series["actuators", name].t_ns)]
    if not names:
        return None
    t_ns = np.unique(series["actuators", names[0]].t_ns)
    columns = []
    for name in names:
        one = series["actuators", name]
        place = np.searchsorted(one.t_ns, t_ns, side="right") - 1
        columns.append(np.where(place >= 0, one.x[np.maximum(place, 0)], np.nan))
    kinds = tuple(ACTUATOR_UNITS[series["actuators", name].value.unit or ""] for name in names)
    return Motion(t_ns, tuple(names), kinds, np.ascontiguousarray(np.column_stack(columns)))


def _position(
    section: Position, mapping: Mapping, series: _TrackSeries, times: IntArray, remarks: list[str]
) -> FloatArray:
    """Return p_NB (n, 3) at these times; NaN where it is unknown."""

    def at(part: str) -> FloatArray:
        return _sampled_series(series["position", part], times)[0]

    if section.latitude is not None:
        latitude, longitude = at("latitude"), at("longitude")
        # Receivers without a fix report 0, 0.
        fixed = np.isfinite(latitude) & np.isfinite(longitude) & ((latitude != 0.0) | (longitude != 0.0))
        latitude, longitude = np.where(fixed, latitude, np.nan), np.where(fixed, longitude, np.nan)
        if mapping.origin is not None:
            degree = scale_of("deg").factor
            origin = mapping.origin.latitude_deg * degree, mapping.origin.longitude_deg * degree
        else:
            k = int(np.argmax(fixed))
            origin = float(latitude[k]), float(longitude[k])
            remarks.append("north and east are measured from its first fix")
        north, east = north_east(latitude, longitude, *origin) if fixed.any() else (latitude, longitude)
    else:
        north, east = at("north"), at("east")
    vertical = one_of(section, "down", "depth", "up", "altitude")
    down = np.zeros(len(times)) if not vertical else at(vertical) if vertical in ("down", "depth") else -at(vertical)
    return np.column_stack([north, east, down])


def _attitude(section: Attitude, series: _TrackSeries, times: IntArray) -> tuple[FloatArray, Any]:
    """Return q_NB (n, 4) at these times, and where it is known (n)."""
    if section.w is not None:
        base = series["attitude", "w"].t_ns
        q = np.column_stack([_sampled_series(series["attitude", part], base)[0] for part in "wxyz"])
    else:
        base = series["attitude", "yaw"].t_ns
        angles = [
            _sampled_series(series["attitude", part], base, angle=True)[0]
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
        # q and -q are the same attitude; neighbours get the same sign, so that interpolation takes the shorter way.
        signs = np.cumprod(np.append(1.0, np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)))
        q = q * signs[:, None]
    columns = [_sampled(base, q[:, k], times) for k in range(4)]
    return np.column_stack([x for x, _ in columns]), columns[0][1]


def _velocity(section: Velocity, series: _TrackSeries, times: IntArray, q: FloatArray) -> tuple[FloatArray, Any]:
    """Return v_N (n, 3) at these times, and where it is known (n)."""

    def at(part: str) -> tuple[FloatArray, Any]:
        return _sampled_series(series["velocity", part], times)

    down, known = at("down") if section.down is not None else at("up")
    down = down if section.down is not None else -down
    if section.forward is None:
        return np.column_stack([at("north")[0], at("east")[0], down]), known & np.isfinite(down)
    right = at("right")[0] if section.right is not None else -at("left")[0]
    body = np.column_stack([at("forward")[0], right, down])
    turned = np.array([rotate(a, b) for a, b in zip(q.tolist(), body.tolist(), strict=True)]).reshape(-1, 3)
    return turned, known & np.isfinite(turned).all(axis=1)


def _sampled_series(series: _Series, times: IntArray, angle: bool = False) -> tuple[FloatArray, Any]:
    return _sampled(series.t_ns, series.x, times, angle)


def _sampled(t_ns: IntArray, x: FloatArray, times: IntArray, angle: bool = False) -> tuple[FloatArray, Any]:
    """Return a value at other times (n), linear between its data, and where it is known (n). It is NaN if it has no finite datum."""
    finite = np.isfinite(x)
    if np.array_equal(t_ns, times):
        return x, finite
    t, x = t_ns[finite], x[finite]
    if not len(t):
        return np.full(len(times), np.nan), np.zeros(len(times), np.bool_)
    x = np.unwrap(x) if angle else x
    # Differences to the first time are exact in float64; the times themselves may not be.
    sampled = np.interp((times - t[0]).astype(np.float64), (t - t[0]).astype(np.float64), x)
    return sampled, (times >= t[0] - _HELD_NS) & (times <= t[-1] + _HELD_NS)
